"""Settings of a simulated swing."""

from __future__ import annotations

import math
from dataclasses import dataclass

from sins_align.grades import ImuGrade, load_grade
from sins_align.simulate.scenarios import Scenario, Triple, find_scenario
from sins_align.types import ImuSampling

_FINITE = (
    "latitude_deg",
    "longitude_deg",
    "altitude_m",
    "heading_deg",
    "turn_deg",
    "heave_m",
    "sway_m",
    "sway_azimuth_deg",
    "drive_azimuth_deg",
)
_POSITIVE = (
    "rate_hz",
    "duration_s",
    "turn_duration_s",
    "heave_period_s",
    "sway_period_s",
    "drive_duration_s",
)
_LONGEST_DRIVE_M = 1000.0  # a flat Earth is wrong by half an arcminute there
_STRONGEST_SHAKE_M_S2 = 100.0


@dataclass(frozen=True, kw_only=True)
class SwingOptions:
    """What to simulate. Angles in degrees, as they come from a command line.

    scenario : a name of `SCENARIOS`, or a scenario with parameters of one's own
    grade : a name of imu_grades.yaml, or a grade of one's own
    seed : of everything random; the same seed with another option keeps all other numbers
    rate_hz, duration_s : the first sample is at 0 s, the last one at duration_s
    sampling : 'instantaneous' (value at the stamp) or 'mean' (over the interval ending there)
    lever_arm_m : swing centre to IMU, FLU; None: the paper's
    heading_deg : turns the whole scenario about up, clockwise from above
    turn_deg : the base is turned once about up through the centre, clockwise from above
    turn_start_s, turn_duration_s : when; a start of None puts the turn in the middle
    heave_m, heave_period_s : amplitude and period of the vertical motion of the swing centre
    sway_m, sway_period_s, sway_azimuth_deg : likewise horizontally, clockwise from north
    drive_m : the swing centre drives so far once, straight and level; the swing goes on
    drive_start_s, drive_duration_s : when; a start of None puts the drive in the middle
    drive_azimuth_deg : where to, clockwise from north; the attitude does not follow it
    drive_shake_m_s2 : 1 sigma of the acceleration of the centre by the road, vertically and
        across, in the middle half of the drive; 1 to 12 Hz, nothing without a drive
    lost_fraction : of the samples, at random; the first and the last one are never lost
    stamp_jitter_s : 1 sigma, cut at 0.45 sampling intervals; the value is that of the true time
    start_stamp_ns : stamp of the first sample, before jitter

    The Earth is flat: n stays that of the place before the drive, and gravity is the same all
    along (the centrifugal part changes, 0.01 arcsec for 100 m). On the round Earth of radius R
    the plumb line turns by drive_m / R, 3.2 arcsec for 100 m, and north by that times the sine
    of the azimuth and the tangent of the latitude; at the speed v the vehicle weighs less by
    v^2 / R, 2 ug at 10 m/s. All of that is left out, so that the attitude in the truth is that
    against the level and the north of wherever the base is.

    Raises
    ------
    ValueError : a value that cannot be simulated; names the field
    """

    scenario: str | Scenario = "pitch"
    grade: str | ImuGrade = "paper_swing"
    seed: int = 0
    rate_hz: float = 200.0
    duration_s: float = 420.0
    latitude_deg: float = 40.0
    longitude_deg: float = 116.0
    altitude_m: float = 50.0
    sampling: str | ImuSampling = "instantaneous"
    lever_arm_m: Triple | None = None
    heading_deg: float = 0.0
    turn_deg: float = 0.0
    turn_start_s: float | None = None
    turn_duration_s: float = 20.0
    heave_m: float = 0.0
    heave_period_s: float = 6.0
    sway_m: float = 0.0
    sway_period_s: float = 9.0
    sway_azimuth_deg: float = 90.0
    drive_m: float = 0.0
    drive_start_s: float | None = None
    drive_duration_s: float = 30.0
    drive_azimuth_deg: float = 0.0
    drive_shake_m_s2: float = 0.0
    lost_fraction: float = 0.0
    stamp_jitter_s: float = 0.0
    start_stamp_ns: int = 1_700_000_000_000_000_000

    def __post_init__(self) -> None:
        self._check_numbers()
        self._check_ranges()
        # These two raise for a name that is not known.
        _ = self.motion, self.imu_grade
        known = [kind.value for kind in ImuSampling]
        if not isinstance(self.sampling, ImuSampling) and self.sampling not in known:
            raise ValueError(f"sampling: {self.sampling!r} is not one of {', '.join(known)}")

    @property
    def motion(self) -> Scenario:
        """The scenario itself."""
        return find_scenario(self.scenario)

    @property
    def imu_grade(self) -> ImuGrade:
        """The grade itself."""
        return self.grade if isinstance(self.grade, ImuGrade) else load_grade(self.grade)

    @property
    def imu_sampling(self) -> ImuSampling:
        """`sampling` as the enumeration."""
        return ImuSampling(self.sampling)

    @property
    def turn_begin_s(self) -> float:
        """When the turn begins [s]."""
        if self.turn_start_s is None:
            return 0.5 * (self.duration_s - self.turn_duration_s)
        return self.turn_start_s

    @property
    def drive_begin_s(self) -> float:
        """When the drive begins [s]."""
        if self.drive_start_s is None:
            return 0.5 * (self.duration_s - self.drive_duration_s)
        return self.drive_start_s

    def _check_numbers(self) -> None:
        for name in _FINITE + _POSITIVE:
            if not math.isfinite(getattr(self, name)):
                raise ValueError(f"{name}: {getattr(self, name)} is not finite")
        for name in _POSITIVE:
            if getattr(self, name) <= 0.0:
                raise ValueError(f"{name}: {getattr(self, name)} is not positive")
        lever_arm = self.lever_arm_m
        if lever_arm is not None and not (
            len(lever_arm) == 3 and all(math.isfinite(x) for x in lever_arm)
        ):
            raise ValueError(f"lever_arm_m: {lever_arm} is not three finite numbers")

    def _check_ranges(self) -> None:
        if abs(self.latitude_deg) > 90.0:
            raise ValueError(f"latitude_deg: {self.latitude_deg} is not within -90..90")
        if self.seed < 0:
            raise ValueError(f"seed: {self.seed} is negative")
        if self.start_stamp_ns < 0:
            raise ValueError(f"start_stamp_ns: {self.start_stamp_ns} is negative")
        if not 0.0 <= self.lost_fraction < 1.0:
            raise ValueError(f"lost_fraction: {self.lost_fraction} is not within 0..1")
        if not 0.0 <= self.stamp_jitter_s <= 0.25 / self.rate_hz:
            raise ValueError(
                f"stamp_jitter_s: {self.stamp_jitter_s} is not within 0..{0.25 / self.rate_hz}, "
                "a quarter of the sampling interval"
            )
        if self.duration_s * self.rate_hz < 1.0:
            raise ValueError(f"duration_s: {self.duration_s} is less than a sampling interval")
        if self.turn_deg != 0.0:
            self._check_begin("turn", self.turn_begin_s)
        for name, limit in (
            ("drive_m", _LONGEST_DRIVE_M),
            ("drive_shake_m_s2", _STRONGEST_SHAKE_M_S2),
        ):
            if not 0.0 <= getattr(self, name) <= limit:
                raise ValueError(f"{name}: {getattr(self, name)} is not within 0..{limit:g}")
        if self.drive_m != 0.0:
            self._check_begin("drive", self.drive_begin_s)

    def _check_begin(self, what: str, begin_s: float) -> None:
        if not 0.0 <= begin_s < self.duration_s:
            raise ValueError(
                f"{what}_start_s: the {what} would begin at {begin_s} s, "
                f"outside the run of {self.duration_s} s"
            )
