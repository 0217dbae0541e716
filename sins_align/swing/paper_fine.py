"""Fine alignment of Mu and Fang: velocity navigated at the swing centre, and its filter."""

from __future__ import annotations

import math

import numpy as np

from sins_align.grades import ImuGrade
from sins_align.rotation import skew
from sins_align.swing.paper_error_model import A, Earth, G
from sins_align.swing.paper_filter import QuaternionFilter
from sins_align.swing.paper_navigation import Grid, Motion, centre_specific_force, integrate
from sins_align.types import Array, IntArray, LeverArm

# Where the filter begins, and begins anew at every switch.
_TILT_SIGMA = np.radians([10.0, 10.0, 30.0])
# A switch that feeds back a poorer heading than the start's would do harm.
_HEADING_TO_SWITCH = math.radians(10.0)
# Innovations ten times too large in the square are no noise: the model does not hold.
_LOST = 10.0
_VELOCITY_SIGMA = 1e-3  # [m/s]
# Floor of the measurement noise [m/s].
_VELOCITY_NOISE = 1e-5


class FineAlignment:
    """The velocity at the swing centre, which ought to be zero, tells the attitude.

    The attitude itself is the caller's; the filter holds what it is wrong by.

    Parameters
    ----------
    gravity : [m/s^2]
    interval_s : of the samples [s]
    lag_s : of the angular acceleration [s]
    """

    def __init__(
        self, earth: Earth, gravity: float, grade: ImuGrade, interval_s: float, lag_s: float
    ) -> None:
        self._earth = earth
        self._gravity = gravity
        self._noise = np.diag(np.repeat([grade.gyro_arw**2, grade.accel_vrw**2], 3))
        self._rate_variance = grade.gyro_arw**2 / interval_s
        self._lag_s = lag_s
        # Constants: gyro bias, accelerometer bias, error of the lever arm, the lag (as 1).
        gyro = grade.gyro_bias**2 + grade.gyro_bias_instability**2
        self._constants = np.diag(np.repeat([gyro, grade.accel_bias**2, 0.0, 1.0], [3, 3, 3, 1]))
        self._filter = QuaternionFilter(_TILT_SIGMA, 10)
        self.V = np.zeros(2)

    def start(self, Q: Array, motion: Motion, lever: LeverArm) -> None:
        """Begin at the attitude Q (4,), its error unknown, at the end of `motion`.

        The velocity is zero but for what the lever arm's error has to do with it.
        """
        C_w = motion.C_nb[:2, :, -1] @ skew(motion.w_ib_b[:, -1])
        velocity = _VELOCITY_SIGMA**2 * np.eye(2) + C_w @ lever.covariance @ C_w.T
        self._filter.reset(Q, velocity)

    def knows_heading(self, Q: Array) -> bool:
        """Whether feeding back the state to the navigated Q (4,) does good, not harm."""
        covariance = self._filter.tilt_covariance(Q, self._constants)
        return float(covariance[2, 2]) < _HEADING_TO_SWITCH**2

    def corrected(self, Q: Array) -> Array:
        """The navigated attitude Q (4,) without the error found: a unit quaternion."""
        corrected = Q - self._filter.x[:4]
        return np.asarray(corrected / np.linalg.norm(corrected))

    def switch(self, Q: Array, motion: Motion, lever: LeverArm) -> None:
        """The caller has corrected its attitude to Q (4,): correct the velocity, begin anew."""
        self.V = self.V - self._filter.x[4:]
        self.start(Q, motion, lever)

    def change_lever_arm(self, motion: Motion, step_b: Array) -> None:
        """The lever arm changes by `step_b` (3,) [m] at the end of `motion`.

        The velocity navigated so far has -C (w x r) in it.
        """
        step = -(motion.C_nb[:2, :, -1] @ np.cross(motion.w_ib_b[:, -1], step_b))
        self.V = self.V + step
        self._filter.move_velocity(step)

    def run(self, motion: Motion, grid: Grid, lever: LeverArm) -> None:
        """Navigate the velocity over a stretch of motion, correct at every filter step."""
        nodes = grid.navigation
        ends = nodes[grid.filter]
        f_b = centre_specific_force(motion.w_ib_b, motion.dw_ib_b, motion.f_ib_b, lever.r_b)
        dV = integrate(motion.t, np.einsum("ijn,jn->in", motion.C_nb[:2], f_b), ends)
        transitions = self._transitions(motion, nodes)
        for k, end in enumerate(ends[1:]):
            transition = np.eye(6)
            for step in transitions[grid.filter[k] : grid.filter[k + 1]]:
                transition = step @ transition
            duration = float(motion.t[end] - motion.t[ends[k]])
            inputs = G(motion.Q[:, end], motion.C_nb[:, :, end]) * duration
            noise = inputs @ self._noise @ inputs.T / duration
            C_w, C_r, late, later = self._lever_effects(motion, end, lever.r_b)
            driven = np.zeros((6, 10))
            driven[:, :6] = inputs
            driven[4:, 9] = -later * duration
            self._filter.predict(transition, noise, driven)
            self.V = self.V + dV[:, k] + self._earth.coriolis(self.V) * duration
            R = C_w @ lever.covariance @ C_w.T + self._rate_variance * C_r @ C_r.T
            R += (_VELOCITY_NOISE**2 + 0.5 * float(late @ late)) * np.eye(2)
            seen = np.zeros((2, 10))
            seen[:, 6:9] = -C_w
            seen[:, 9] = late
            self._filter.correct(self.V, R, seen)
        self._constants[6:9, 6:9] = lever.covariance

    def _transitions(self, motion: Motion, nodes: IntArray) -> Array:
        """I + A dt + (A dt)^2 / 2 of every navigation step, A the mean of its ends: (M, 6, 6).

        The paper puts the measured specific force into A. It is replaced by what it ought to
        be at the swing centre, -C_bn g_n: a heading error multiplies the noise of A, which
        comes back as false knowledge of the heading.
        """
        A_nodes = A(
            motion.Q[:, nodes].T,
            self.V,
            motion.w_ib_b[:, nodes].T,
            self._gravity * motion.C_nb[2][:, nodes].T,
            self._earth,
        )
        dt = np.diff(motion.t[nodes])[:, np.newaxis, np.newaxis]
        A_dt = 0.5 * dt * (A_nodes[1:] + A_nodes[:-1])
        transitions: Array = np.eye(6) + A_dt + 0.5 * A_dt @ A_dt
        return transitions

    def _lever_effects(
        self, motion: Motion, end: int, r_b: Array
    ) -> tuple[Array, Array, Array, Array]:
        """What the lever arm does to the navigated velocity at the index `end`, east and north.

        The accelerometers' velocity is freed of C (w x r). An error of r leaves -C_w dr with
        C_w = C [w x], noise of w leaves C_r dw with C_r = C [r x]. A derivative late by tau
        adds the specific force tau ddw x r, whose integral in n is

        tau C (dw x r) - tau int C (w x (dw x r)) dt.

        Returns
        -------
        C_w, C_r : (2, 3)
        late, later : (2,) tau C (dw x r) [m/s], tau C (w x (dw x r)) [m/s^2]
        """
        C = motion.C_nb[:2, :, end]
        w = motion.w_ib_b[:, end]
        late_b = self._lag_s * np.cross(motion.dw_ib_b[:, end], r_b)
        return C @ skew(w), C @ skew(r_b), C @ late_b, C @ np.cross(w, late_b)

    def tilt_covariance(self, Q: Array) -> Array:
        """(3, 3) of the misalignment, east, north, up [rad^2], for the navigated Q (4,).

        That of the start where the innovations say that the filter has lost its way.
        """
        if self.consistency > _LOST:
            return np.diag(_TILT_SIGMA**2)
        return self._filter.tilt_covariance(Q, self._constants)

    @property
    def consistency(self) -> float:
        """Mean normalised innovation squared over 2, since the filter began anew."""
        return self._filter.consistency
