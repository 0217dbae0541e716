"""One run of a node's session with what it claims held against the truth: a `Record`."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from evidence.monte_carlo import misalignment_of
from sins_align.config import odo_config, swing_config
from sins_align.grades import load_grade
from sins_align.session import Session, Update
from sins_align.simulate import SwingOptions, VehicleOptions, simulate_swing, simulate_vehicle
from sins_align.types import Array, Estimate, ImuSamples, IntArray, OdometerSamples, State

# A heading further from the truth than so many claimed sigma is a false one.
FALSE_RATIO = 3.0
# When the time to go is asked for [s], and how far off it may be.
ETA_AT_S = 60.0
ETA_TOLERANCE = 0.3
LATITUDE_KEYS = {"latitude_differs", "latitude_wrong"}


class Impulse(NamedTuple):
    """Someone jumps on the base: for `length_s` it tilts and heaves, and comes back.

    axis_b : (3,) unit vector it tilts about; tilt : the most of it [rad]; heave : likewise [m]
    """

    begin_s: float
    length_s: float
    axis_b: tuple[float, float, float]
    tilt: float
    heave: float

    def shape(self, t: Array) -> tuple[Array, Array, Array]:
        """(N,) sin^4 over the length, its rate and acceleration at the times t (N,) [s]."""
        omega = math.pi / self.length_s
        s, c = np.sin(omega * (t - self.begin_s)), np.cos(omega * (t - self.begin_s))
        inside = (t >= self.begin_s) & (t <= self.begin_s + self.length_s)
        acceleration = omega**2 * (12.0 * s**2 * c**2 - 4.0 * s**4)
        return inside * s**4, inside * 4.0 * omega * s**3 * c, inside * acceleration

    def turned(self, t: Array) -> Array:
        """(3, 3, N) R: the attitude is C_nb R; Rodrigues."""
        x, y, z = self.axis_b
        K = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
        angle = self.tilt * self.shape(t)[0]
        R: Array = (
            np.eye(3)[:, :, None]
            + K[:, :, None] * np.sin(angle)
            + (K @ K)[:, :, None] * (1.0 - np.cos(angle))
        )
        return R


@dataclass(frozen=True)
class Plan:
    """What is simulated, and what is declared.

    grade : the declared one
    faults : what is wrong, 'kind: figures'; empty: a clean run
    gap : (begin, length) [s] without IMU samples
    is_opposite : the odometer counts backwards
    """

    number: int
    scenario: str
    grade: str
    options: SwingOptions | VehicleOptions
    parameters: Mapping[str, Any]
    faults: tuple[str, ...] = ()
    gap: tuple[float, float] | None = None
    impulse: Impulse | None = None
    is_opposite: bool = False

    @property
    def node(self) -> str:
        """'swing' or 'odo'."""
        return "swing" if isinstance(self.options, SwingOptions) else "odo"


class Moment(NamedTuple):
    """An estimate against the truth.

    heading_error, heading_sigma [rad]; level_square : normalised, 2 degrees of freedom
    """

    time_s: float
    heading_error: float
    heading_sigma: float
    level_square: float

    @property
    def ratio(self) -> float:
        """Heading error over its sigma, without a sign."""
        return abs(self.heading_error / self.heading_sigma)


@dataclass(frozen=True)
class Record:
    """What became of a run. Times are those of the data, from the first sample on [s].

    first : the first update that claims aligned; worst : the one of these with the largest
        ratio; last : the last with an estimate, claimed or not; None: there was none
    eta_s : as told at `ETA_AT_S`; alarm_s : when the latitude was first said to be wrong; inf:
        never
    end_s : of the data; keys : of the status at the end
    bias_square : of the accelerometers' biases across the vertical, normalised, 2 degrees of
        freedom: the level square of a base that does not tell them
    """

    node: str
    number: int
    scenario: str
    grade: str
    faults: tuple[str, ...]
    first: Moment | None
    worst: Moment | None
    last: Moment | None
    eta_s: float
    alarm_s: float
    end_s: float
    keys: tuple[str, ...] = ()
    bias_square: float = math.nan

    @property
    def aligned_s(self) -> float:
        """When aligned was claimed for the first time; infinity: never."""
        return math.inf if self.first is None else self.first.time_s

    @property
    def is_false(self) -> bool:
        """Whether at any time aligned was claimed with a heading that is not in its sigma."""
        return self.worst is not None and self.worst.ratio > FALSE_RATIO

    @property
    def is_false_at_first(self) -> bool:
        """As `is_false`, when aligned was claimed for the first time."""
        return self.first is not None and self.first.ratio > FALSE_RATIO

    @property
    def eta_hit(self) -> bool | None:
        """Whether the time to go was right; None where it does not count.

        It counts where aligned comes later than it was asked, and where it was to come within
        the run, and did not.
        """
        if self.aligned_s <= ETA_AT_S:
            return None
        if self.first is None:
            return False if ETA_AT_S + self.eta_s <= self.end_s else None
        left = self.aligned_s - ETA_AT_S
        return abs(self.eta_s - left) <= ETA_TOLERANCE * left

    @property
    def caught(self) -> bool:
        """Whether the latitude was said to be wrong before aligned was claimed."""
        return self.alarm_s < self.aligned_s


class Samples(NamedTuple):
    """What the session gets, and the truth.

    C_nb_at : stamps (N,) to C_nb (3, 3, N); accel_bias : (3,) [m/s^2]
    """

    imu: ImuSamples
    odometer: OdometerSamples | None
    C_nb_at: Callable[[IntArray], Array]
    accel_bias: Array


def simulate(plan: Plan) -> Samples:
    """The samples of a plan, with its faults."""
    if isinstance(plan.options, SwingOptions):
        swing = simulate_swing(plan.options)
        truth = swing.truth
        samples = Samples(swing.imu, None, truth.C_nb_at, truth.accel_bias_m_s2)
        if plan.impulse is not None:
            samples = _jump(samples, plan.impulse, plan.options, truth.lever_arm_m)
    else:
        vehicle = simulate_vehicle(plan.options)
        odometer = vehicle.odometer
        if plan.is_opposite:
            odometer = OdometerSamples(odometer.stamp_ns, -odometer.speed, odometer.variance)
        samples = Samples(
            vehicle.imu, odometer, vehicle.truth.C_nb_at, vehicle.truth.accel_bias_m_s2
        )
    if plan.gap is not None:
        begin_s, length_s = plan.gap
        time_s = (samples.imu.stamp_ns - plan.options.start_stamp_ns) * 1e-9
        kept = (time_s < begin_s) | (time_s >= begin_s + length_s)
        samples = samples._replace(imu=samples.imu.select(kept))
    return samples


def _jump(samples: Samples, impulse: Impulse, options: SwingOptions, r_b: Array) -> Samples:
    """The base is turned by R more: w' = R^T w + u, f' = R^T f + du x r + C_bn a."""
    start_ns = options.start_stamp_ns
    imu, axis = samples.imu, np.array(impulse.axis_b)

    def C_nb_at(stamp_ns: IntArray) -> Array:
        R = impulse.turned((stamp_ns - start_ns) * 1e-9)
        return np.einsum("ijn,jkn->ikn", samples.C_nb_at(stamp_ns), R)

    t = (imu.stamp_ns - start_ns) * 1e-9
    _, rate, acceleration = impulse.shape(t)
    R = impulse.turned(t)
    w = np.einsum("jin,jn->in", R, imu.w_ib_b) + impulse.tilt * np.outer(axis, rate)
    f = np.einsum("jin,jn->in", R, imu.f_ib_b)
    f += impulse.tilt * np.outer(np.cross(axis, r_b), acceleration)
    f += impulse.heave * acceleration * C_nb_at(imu.stamp_ns)[2]
    return samples._replace(imu=ImuSamples(imu.stamp_ns, w, f), C_nb_at=C_nb_at)


def run(plan: Plan) -> Record:
    """The session of a plan from its first sample to the last."""
    samples = simulate(plan)
    make_config = swing_config if plan.node == "swing" else odo_config
    session = Session(make_config(plan.parameters))
    start_ns = plan.options.start_stamp_ns
    split_ns = start_ns + round(ETA_AT_S * 1e9)
    updates = _feed(session, samples, np.iinfo(np.int64).min, split_ns)
    eta_s = session.eta_s
    updates += _feed(session, samples, split_ns, np.iinfo(np.int64).max)
    shown = [(u, u.estimate) for u in updates if u.estimate is not None]
    moments = _moments([e for _, e in shown], samples, start_ns)
    claims = [
        m
        for (u, _), m in zip(shown, moments, strict=True)
        if u.status.state is State.ALIGNED
    ]  # fmt: skip
    alarms = [u.stamp_ns for u in updates if LATITUDE_KEYS & set(u.status.keys)]
    return Record(
        node=plan.node,
        number=plan.number,
        scenario=plan.scenario,
        grade=plan.grade,
        faults=plan.faults,
        first=claims[0] if claims else None,
        worst=max(claims, key=lambda m: m.ratio) if claims else None,
        last=moments[-1] if moments else None,
        eta_s=eta_s,
        alarm_s=(alarms[0] - start_ns) * 1e-9 if alarms else math.inf,
        end_s=plan.options.duration_s,
        keys=session.status.keys,
        bias_square=_bias_square(samples, load_grade(plan.grade).accel_bias),
    )


def _bias_square(samples: Samples, sigma: float) -> float:
    """Of the accelerometers' biases across the vertical; sigma : as declared [m/s^2]."""
    C_nb = samples.C_nb_at(samples.imu.stamp_ns[-1:])[:, :, 0]
    level = C_nb[:2] @ samples.accel_bias / sigma
    return float(level @ level)


def _feed(session: Session, samples: Samples, after_ns: int, until_ns: int) -> list[Update]:
    """The samples of a span, both sensors' at once."""

    def of_span(stamp_ns: IntArray) -> Any:
        return (stamp_ns > after_ns) & (stamp_ns <= until_ns)

    updates: list[Update] = []
    odometer = samples.odometer
    if odometer is not None:
        updates += session.add_odometer(odometer.select(of_span(odometer.stamp_ns)))
    return updates + session.add_imu(samples.imu.select(of_span(samples.imu.stamp_ns)))


def _moments(estimates: Sequence[Estimate], samples: Samples, start_ns: int) -> list[Moment]:
    if not estimates:
        return []
    C_nb = samples.C_nb_at(np.array([e.stamp_ns for e in estimates]))
    moments = []
    for k, estimate in enumerate(estimates):
        phi, P = misalignment_of(estimate, C_nb[:, :, k]), estimate.misalignment_covariance
        square = phi[:2] @ np.linalg.solve(P[:2, :2], phi[:2])
        time_s = (estimate.stamp_ns - start_ns) * 1e-9
        moments.append(Moment(time_s, float(phi[2]), math.sqrt(P[2, 2]), float(square)))
    return moments
