"""Whether the vehicle drives off under a swing alignment, and when it is still again.

The place of the swing centre is integrated from the specific force, a second at a time, in axes
carried by the gyros and turned back with the Earth, the lever arm's part taken off:

    p(t) = int int C f dt - C r = p0 + v0 t - g t^2/2 + what the centre has moved

Over the last half minute of rest a parabola is fitted to it; what comes later is held against its
continuation. Its second derivative is gravity as these sensors see it, bias and tilt included, so
that nothing else has to be known. A base that sways by decimetres stays with it; a vehicle that
drives off leaves it by metres within seconds. Before the Earth's axis is known gravity turns, by
g W t: a shorter time of rest is looked at, the lever arm is found with it, and the bound is wider.
"""

from __future__ import annotations

import math
from collections import deque
from typing import NamedTuple

import numpy as np

from sins_align.earth import EARTH_RATE, GRAVITY_EQUATOR
from sins_align.rotation import dcm_from_quaternion, rotations_about
from sins_align.types import Array, Estimate, ImuBlock, ImuSampling
from sins_align.windows import integrate_windows

# Blocks of a second: so many tell the curve at the most and the least, and so many of them are
# held against it.
REFERENCE, LEAST_REFERENCE, RECENT = 30, 12, 5
# The most that tell it before the Earth's axis is known.
BLIND_REFERENCE = 20
# The centre has left when it is so far from the curve [m], or so many times what the reference
# itself scatters about it; and with the axes unknown.
MOVED_M, MOVED_RATIO = 0.5, 8.0
MOVED_BLIND_M = 1.5
# What is known of a lever arm that nobody has told, over what a place is uncertain by.
LEVER_RATIO = 100.0
# How fast gravity turns in inertial space at most [m/s^3].
GRAVITY_TURN = GRAVITY_EQUATOR * EARTH_RATE
# A base that has turned by more than this [rad] in its place moves an IMU on a lever arm, which
# may be unknown, but no longer than this [m].
TURNED, REACH_M = 0.35, 15.0
# Still again: for so many blocks within so much of a parabola [m], which has no more force than
# this [m/s^2],
STILL, STILL_M, STILL_FORCE = 12, 0.1, 0.05
# and no speed, which is known ever less well [m/s], [m/s^2].
STILL_SPEED, SPEED_DRIFT = 0.3, 0.005
# A vehicle that is as quiet for so many blocks stands, whatever its speed and force seem to be:
# what was known of gravity may have been wrong. (Or it goes straight on at one speed: that no IMU
# can tell.)
QUIET = 60
# Looked at every so many blocks while it is at rest.
LOOK = 2


class Node(NamedTuple):
    """A block and its end: stamp [ns], time [s], int C f, int int C f, attitude b -> b0."""

    stamp_ns: int
    time_s: float
    u: Array
    s: Array
    C: Array


class Curve(NamedTuple):
    """A polynomial in t - t0, (degree + 1, 3), and the root mean square of what it leaves [m]."""

    t0: float
    coefficients: Array
    scatter: float

    def at(self, time_s: Array) -> Array:
        """(N, 3) its values."""
        degree = self.coefficients.shape[0]
        return np.vander(time_s - self.t0, degree, increasing=True) @ self.coefficients


class Track(NamedTuple):
    """Times (N,), places (N, 3) of the centre; velocity and place (3,) of the IMU at the end."""

    time_s: Array
    places: Array
    velocity: Array
    place: Array


class MotionWatch:
    """Follows the swing centre.

    moved_m : how far it is from where it should be [m]
    knows_axes : whether the Earth's axis is known
    """

    def __init__(self, sampling: ImuSampling) -> None:
        self._sampling = sampling
        self._nodes: deque[Node] = deque(maxlen=REFERENCE + RECENT + 1)
        self._count = 0
        self._w_ie_b0, self._r_b = np.zeros(3), np.zeros(3)
        self._rest: Curve | None = None  # before the motion
        self._velocity, self._place = np.zeros(3), np.zeros(3)
        self._path: deque[Array] = deque(maxlen=QUIET)  # off the rest: time, place
        self.moved_m = 0.0
        self.knows_axes = False

    def update(self, block: ImuBlock) -> None:
        """Take in a block."""
        self._count += 1
        windows = integrate_windows(block, self._sampling, 1)
        time_s, C = float(windows.duration_s[0]), np.eye(3)
        if self._nodes:
            time_s, C = time_s + self._nodes[-1].time_s, self._nodes[-1].C
        u, s, C_end = C @ windows.u[0], C @ windows.s[0], C @ windows.C_end[0]
        self._nodes.append(Node(int(block.stamp_ns[-1]), time_s, u, s, C_end))
        if self._rest is not None:
            self._follow(self._track(1, self._velocity, self._place))

    def take_axes(self, estimate: Estimate, w_ie_n: Array) -> None:
        """Take what the alignment knows: the Earth's axis in b0, and the lever arm.

        w_ie_n : (3,) rate of the Earth [rad/s]
        """
        for node in self._nodes:
            if node.stamp_ns == estimate.stamp_ns:
                self._w_ie_b0 = node.C @ dcm_from_quaternion(estimate.q_nb).T @ w_ie_n
                self.knows_axes = True
                if estimate.lever_arm is not None:
                    self._r_b = estimate.lever_arm.r_b

    def has_left(self) -> bool:
        """Whether the centre has left its place now."""
        if len(self._nodes) <= LEAST_REFERENCE + RECENT or self._count % LOOK:
            return False
        count = (REFERENCE if self.knows_axes else BLIND_REFERENCE) + RECENT
        if not self.knows_axes:
            self._r_b = self._lever_arm_of_rest(count)
        track = self._track(count, np.zeros(3), np.zeros(3))
        reference = slice(None, -RECENT)
        rest = _fit(track.time_s[reference], track.places[reference], 2)
        off = np.linalg.norm(track.places[-2:] - rest.at(track.time_s[-2:]), axis=1)
        self.moved_m = float(off[-1])
        # One place alone may be a jolt.
        bound = MOVED_M if self.knows_axes else MOVED_BLIND_M
        bound = max(bound, MOVED_RATIO * rest.scatter)
        if not off.min() > bound or self._has_turned_in_place(track, bound):
            return False
        self._rest = rest
        self._follow(track)
        return True

    def _lever_arm_of_rest(self, count: int) -> Array:
        """(3,) r of p = a + b t + c t^2 + C r over `count` blocks but the last ones."""
        self._r_b = np.zeros(3)
        track = self._track(count, np.zeros(3), np.zeros(3))
        places = track.places[:-RECENT]
        A = self._columns(track.time_s)[: places.size]
        prior = np.zeros((3, A.shape[1]))
        prior[:, 9:] = np.eye(3) / LEVER_RATIO
        b = np.concatenate((places.ravel(), np.zeros(3)))
        x, _, _, _ = np.linalg.lstsq(np.concatenate((A, prior)), b, rcond=None)
        r_b: Array = x[9:]
        return r_b

    def _columns(self, time_s: Array) -> Array:
        """(3 N, 12) of a, b, c and r in p = a + b t + c t^2 + C r, at the last N nodes."""
        C = np.array([node.C for node in list(self._nodes)[-time_s.shape[0] :]])
        if self.knows_axes:
            C = rotations_about(-self._w_ie_b0, time_s) @ C
        powers = np.vander(time_s - time_s[0], 3, increasing=True)
        return np.concatenate((np.kron(powers, np.eye(3)), C.reshape(-1, 3)), axis=1)

    def _has_turned_in_place(self, track: Track, bound: float) -> bool:
        """Whether another lever arm explains where the IMU went: p = a + b t + c t^2 + C dr."""
        nodes = list(self._nodes)[-track.time_s.shape[0] :]
        turn = nodes[0].C.T @ nodes[-1].C
        if float(np.trace(turn)) > 1.0 + 2.0 * math.cos(TURNED):
            return False
        A = self._columns(track.time_s)
        x, _, _, _ = np.linalg.lstsq(A, track.places.ravel(), rcond=1e-6)
        left = np.linalg.norm((track.places.ravel() - A @ x).reshape(-1, 3), axis=1)
        return bool(left.max() < bound and float(np.linalg.norm(x[9:])) < REACH_M)

    def _follow(self, track: Track) -> None:
        assert self._rest is not None
        self._velocity, self._place = track.velocity, track.place
        off = track.places[-1] - self._rest.at(track.time_s[-1:])[0]
        self._path.append(np.array([track.time_s[-1], *off]))
        self.moved_m = float(np.linalg.norm(off))

    def has_stopped(self) -> bool:
        """Whether a centre that has left is still again."""
        assert self._rest is not None
        path = np.array(self._path)
        since = float(path[-1, 0]) - self._rest.t0
        if path.shape[0] < STILL:
            return False
        # A cubic: gravity may turn.
        if path.shape[0] == QUIET and _fit(path[:, 0], path[:, 1:], 3).scatter < STILL_M:
            return True
        last = path[-STILL:]
        fit = _fit(last[:, 0], last[:, 1:], 2)
        force = 2.0 * float(np.linalg.norm(fit.coefficients[2]))
        turned = 0.0 if self.knows_axes else GRAVITY_TURN * since
        if not (fit.scatter < STILL_M and force < STILL_FORCE + turned):
            return False
        line = _fit(last[:, 0], last[:, 1:], 1)
        speed = float(np.linalg.norm(line.coefficients[1]))
        return speed < STILL_SPEED + (SPEED_DRIFT + 0.5 * turned) * since

    def _track(self, count: int, velocity: Array, place: Array) -> Track:
        """The last nodes, in axes of the Earth: their increments are turned back with it.

        velocity, place : (3,) of the IMU at the node before
        """
        first, *nodes = list(self._nodes)[-count - 1 :]
        time_s = np.array([first.time_s, *(node.time_s for node in nodes)])
        T, middle = np.diff(time_s), 0.5 * (time_s[1:] + time_s[:-1])
        u, s = np.array([node.u for node in nodes]), np.array([node.s for node in nodes])
        arms = np.array([node.C for node in nodes]) @ self._r_b
        if self.knows_axes:
            times = np.concatenate((middle, middle, time_s[1:]))
            back = rotations_about(-self._w_ie_b0, times)
            vectors = np.concatenate((u, s, arms))[:, :, None]
            u, s, arms = (back @ vectors)[:, :, 0].reshape(3, -1, 3)
        after = velocity + np.cumsum(u, axis=0)
        places = place + np.cumsum((after - u) * T[:, None] + s, axis=0)
        return Track(time_s[1:], places - arms, after[-1], places[-1])


def _fit(time_s: Array, p: Array, degree: int) -> Curve:
    """Least squares through places (N, 3) at times (N,)."""
    t0 = float(time_s[0])
    A = np.vander(time_s - t0, degree + 1, increasing=True)
    coefficients, _, _, _ = np.linalg.lstsq(A, p, rcond=None)
    left = p - A @ coefficients
    return Curve(t0, coefficients, math.sqrt(float((left**2).sum(axis=1).mean())))
