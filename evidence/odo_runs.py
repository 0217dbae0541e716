"""Drives of the simulator through the session of `odo_align`, second by second."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple
from unittest.mock import patch

import numpy as np

from evidence.checks import Check, upper
from evidence.monte_carlo import misalignment, rms
from sins_align import session
from sins_align.config import OdoConfig, odo_config
from sins_align.odo import filter as odo_filter
from sins_align.odo.aligner import OdoAligner
from sins_align.odo.coarse import CoarseAttitude
from sins_align.odo.epoch import AidedEpoch
from sins_align.odo.filter import AidedFilter
from sins_align.odo.knowledge import knowledge_of
from sins_align.odo.pairing import Paired
from sins_align.odo.start import Starter
from sins_align.odo.wander import WanderFilter
from sins_align.rotation import exp_rotation, heading_from_yaw, rpy_from_dcm
from sins_align.session import Session, Update
from sins_align.simulate import VehicleOptions, VehicleRun, simulate_vehicle
from sins_align.types import Advance, Array, Position, Status
from sins_align.units import ARCMIN, DEG

TIMES_S = (30, 60, 120, 150, 300, 600, 870)


class Start(NamedTuple):
    """The heading that the filter begins with.

    error_deg : of it, clockwise
    sigma_deg : the paper's extended Kalman filter, with so much uncertainty, and without what
        takes its large innovations for outliers: soft weighting, and a new beginning; None: the
        linear filter, for which the heading at the start is a mere choice of axes
    """

    error_deg: float
    sigma_deg: float | None = None


class Moment(NamedTuple):
    """What the filter knows at the end of an epoch, whether it is published or not."""

    stamp_ns: int
    C_nb: Array
    covariance: Array
    scale: tuple[float, float]  # error and its 1 sigma
    consistency: float
    published: bool


class TurnedStarter(Starter):
    """Starts with the heading that it is told; heading : the true one [rad]."""

    def __init__(self, config: OdoConfig, position: Position, start: Start, heading: float) -> None:
        super().__init__(config, position, None)
        self._start, self._heading = start, heading + start.error_deg * DEG

    def _start_at_begin(self, coarse: CoarseAttitude, first: AidedEpoch) -> WanderFilter:
        found = heading_from_yaw(rpy_from_dcm(coarse.C_n0b0)[2])
        turn = np.array([0.0, 0.0, found - self._heading])  # headings are clockwise
        coarse = coarse._replace(C_n0b0=exp_rotation(turn) @ coarse.C_n0b0)
        if self._start.sigma_deg is None:
            return super()._start_at_begin(coarse, first)
        speed = 0.0 if first.travel is None else first.travel.speed_start
        variance = (self._start.sigma_deg * DEG) ** 2
        filter_ = self._make_filter(coarse.C_n0b0, coarse, speed, variance)
        filter_.navigation.e_a[1] = math.cos(self._position.latitude)
        return filter_


class RecordedAligner(OdoAligner):
    """Keeps a `Moment` for each epoch."""

    def __init__(
        self, config: OdoConfig, position: Position, start: Start | None, heading: float
    ) -> None:
        super().__init__(config, position)
        self.moments: list[Moment] = []
        self._plain = start is not None and start.sigma_deg is not None
        if start is not None:
            self._starter = TurnedStarter(config, position, start, heading)

    def _is_stillborn(self, filter_: AidedFilter) -> bool:
        return not self._plain and super()._is_stillborn(filter_)

    def _take_in(self, paired: Paired, delay: float) -> Advance:
        step = super()._take_in(paired, delay)
        filter_ = self._filter
        if filter_ is not None:
            known = knowledge_of(filter_)
            self.moments.append(
                Moment(
                    step.stamp_ns,
                    known.C_nb,
                    known.covariance,
                    (known.odometer.scale_error, known.odometer.scale_sigma),
                    filter_.consistency,
                    step.estimate is not None,
                )
            )
        return step


class RecordedSession(Session):
    """A session whose aligner keeps its moments; `start` and `heading` are for that."""

    def __init__(
        self, config: OdoConfig, start: Start | None = None, heading: float = math.nan
    ) -> None:
        self._begin_with = start, heading
        super().__init__(config)

    def _make_aligner(self, *arguments: Any) -> None:
        with patch.object(session, "make_odo_aligner", self._make_recorded):
            super()._make_aligner(*arguments)

    def _make_recorded(self, config: OdoConfig, position: Position) -> RecordedAligner:
        return RecordedAligner(config, position, *self._begin_with)

    @property
    def moments(self) -> list[Moment]:
        """Of the alignment that runs."""
        assert isinstance(self._aligner, RecordedAligner)
        return self._aligner.moments


@dataclass(frozen=True)
class Drive:
    """One run, a row for every second; NaN where there is nothing yet.

    phi, sigma : (T, 3) misalignment and claimed 1 sigma, east, north, up [rad]
    level_nees : (T,) normalised square of the first two
    scale_error, scale_sigma : (T,) measured over true distance minus 1: estimate minus truth
    published : (T,) whether there was an estimate for the user
    consistency : (T,)
    status : at the end; false_claims: updates that claimed more than their sigma says
    """

    seed: int
    phi: Array
    sigma: Array
    level_nees: Array
    scale_error: Array
    scale_sigma: Array
    published: Array
    consistency: Array
    status: Status
    false_claims: int


def make_config(options: VehicleOptions, parameters: Mapping[str, Any]) -> OdoConfig:
    """Settings that fit the drive."""
    place = {
        "latitude_deg": options.latitude_deg,
        "longitude_deg": options.longitude_deg,
        "altitude_m": options.altitude_m,
    }
    imu = {"imu_grade": options.grade, "imu_sampling": options.imu_sampling.value}
    return odo_config({**place, **imu, **parameters})


def false_claims(updates: Sequence[Update], config: OdoConfig) -> int:
    """How many updates say aligned with a sigma above a threshold."""
    count = 0
    for update in updates:
        if update.status.state.value != "aligned":
            continue
        assert update.estimate is not None
        east, north, heading = update.estimate.sigma
        level = config.completion.level_threshold
        count += not (
            heading < config.completion.heading_threshold and east < level and north < level
        )
    return count


def drive(
    options: VehicleOptions, parameters: Mapping[str, Any] | None = None, start: Start | None = None
) -> Drive:
    """One simulated alignment."""
    simulated = simulate_vehicle(options)
    config = make_config(options, parameters or {})
    heading = float(simulated.truth.heading_at(int(simulated.imu.stamp_ns[0])))
    recorded = RecordedSession(config, start, heading)
    plain = start is not None and start.sigma_deg is not None
    limit = math.inf if plain else odo_filter.SOFT_LIMIT
    with patch.object(odo_filter, "SOFT_LIMIT", limit):
        if not config.stationary:
            recorded.add_odometer(simulated.odometer)
        updates = recorded.add_imu(simulated.imu)
    return _tabulate(simulated, recorded, false_claims(updates, config))


def _tabulate(simulated: VehicleRun, recorded: RecordedSession, wrong: int) -> Drive:
    options, moments = simulated.options, recorded.moments
    length = round(options.duration_s) + 1
    table = np.full((length, 12), np.nan)
    if moments:
        stamps = np.array([m.stamp_ns for m in moments])
        time_s = (stamps - options.start_stamp_ns) * 1e-9
        truth = simulated.truth.C_nb_at(stamps)
        scale = np.full(stamps.size, 1.0 + simulated.truth.odometer_scale_error)
        if options.scale_step is not None:
            at_s, change = options.scale_step
            scale[time_s > at_s] *= 1.0 + change
        rows = np.rint(time_s).astype(int)
        for k, m in enumerate(moments):
            phi = misalignment(m.C_nb, truth[:, :, k])
            level = phi[:2] @ np.linalg.solve(m.covariance[:2, :2], phi[:2])
            table[rows[k] :] = (
                *phi, *np.sqrt(m.covariance.diagonal()), level, m.scale[0] + 1.0 - scale[k],
                m.scale[1], m.published, m.consistency, m.stamp_ns * 1e-9,
            )  # fmt: skip
    return Drive(
        options.seed, table[:, :3], table[:, 3:6], *table[:, 6:11].T, recorded.status, wrong
    )


def heading_errors(drives: Sequence[Drive]) -> Array:
    """(runs, T) heading error [arcmin]."""
    return np.array([d.phi[:, 2] for d in drives]) / ARCMIN


def ratios(drives: Sequence[Drive]) -> Array:
    """(runs, T) heading error over its sigma."""
    return np.array([d.phi[:, 2] / d.sigma[:, 2] for d in drives])


def nees(drives: Sequence[Drive], at_s: int) -> float:
    """Mean normalised square of the heading error."""
    return float(rms(ratios(drives)[:, at_s]) ** 2)


def shown_nees(drives: Sequence[Drive]) -> float:
    """As `nees`, of every heading that was shown, at whatever time."""
    shown = np.array([d.published for d in drives]) == 1.0
    return float(rms(ratios(drives)[shown]) ** 2)


def below_since(curve: Array, bound: float) -> float:
    """The second from which on `curve` (T,) stays below; infinity where it does not."""
    above = np.flatnonzero(~(curve < bound))
    since = 0 if above.size == 0 else int(above[-1]) + 1
    return float(since) if since < curve.size else math.inf


def rows(drives: Sequence[Drive], times_s: Sequence[int] = TIMES_S) -> list[str]:
    """Heading and levels at some times: the statistics of all runs, published or not."""
    error, length = heading_errors(drives), drives[0].phi.shape[0]
    sigma = np.array([d.sigma for d in drives]) / ARCMIN
    level = np.array([d.phi[:, :2] for d in drives]) / ARCMIN
    level_nees = np.array([d.level_nees for d in drives])
    scale = 100.0 * np.array([d.scale_error for d in drives])
    published = np.array([d.published for d in drives])
    heading = "heading ': mean     RMS     max   sigma  NEES  shown"
    text = [f"      t [s]  {heading}  level ':  RMS   sigma  NEES/2  scale %:  RMS     max"]
    for t in times_s:
        if t >= length:
            continue
        text.append(
            f"      {t:5d}  {error[:, t].mean():15.3f} {rms(error[:, t]):7.3f}"
            f" {np.abs(error[:, t]).max():7.3f} {rms(sigma[:, t, 2]):7.3f}"
            f" {nees(drives, t):5.2f} {int(published[:, t].sum()):6d}"
            f" {rms(level[:, t]):14.4f} {rms(sigma[:, t, :2]):7.4f}"
            f" {level_nees[:, t].mean() / 2.0:7.2f}"
            f" {rms(scale[:, t]):14.5f} {np.abs(scale[:, t]).max():7.5f}"
        )
    worst = int(np.abs(error[:, -1]).argmax())
    text.append(f"      worst seed {drives[worst].seed}: {error[worst, -1]:.2f}' at the end")
    return text


def divergence(drives: Sequence[Drive]) -> list[Check]:
    """No run diverges: each has an estimate at the end, none was ever shown with a sigma
    that has nothing to do with its error, and none is called aligned that is not.
    """  # fmt: skip
    shown = np.array([d.published for d in drives]) == 1.0
    worst = np.abs(ratios(drives))[shown].max(initial=0.0)
    return [
        upper("runs without an estimate at the end", float((~shown[:, -1]).sum()), 0.0),
        upper("largest heading error / sigma ever shown", float(worst), 6.0),
        upper("claims of alignment above the threshold", sum(d.false_claims for d in drives), 0.0),
    ]
