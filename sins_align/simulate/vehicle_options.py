"""Settings of a simulated drive."""

from __future__ import annotations

import math
from dataclasses import dataclass

from sins_align.grades import ImuGrade, load_grade
from sins_align.simulate.vehicle_route import VEHICLE_SCENARIOS
from sins_align.types import ImuSampling

Triple = tuple[float, float, float]
Spans = tuple[tuple[float, float], ...]

_FINITE = ("latitude_deg", "longitude_deg", "altitude_m", "odometer_latency_s")
_MAYBE_FINITE = ("heading_deg", "ground_roll_deg", "ground_pitch_deg", "odometer_scale_error")
_GRADIENTS = (
    "sideslip_deg_per_m_s2",
    "suspension_roll_deg_per_m_s2",
    "suspension_pitch_deg_per_m_s2",
)
_NOT_NEGATIVE = (
    "road_motion_deg",
    "direction_noise_deg",
    "standing_motion_arcsec",
    "odometer_scale_sigma",
    "odometer_quantum_m",
    "odometer_noise_m_s",
    "odometer_jitter_s",
    "slip_duration_s",
    "seed",
    "slip_count",
    "start_stamp_ns",
)
_POSITIVE = ("rate_hz", "duration_s", "odometer_rate_hz")
_VECTORS = ("odometer_lever_arm_m", "mounting_rpy_deg")
_SPANS = ("dropouts", "stuck")
_FRACTIONS = ("lost_fraction", "outlier_fraction")
# Nearer to a pole ENU turns too fast to be an axis system for a vehicle.
_MOST_LATITUDE_DEG = 89.95


@dataclass(frozen=True, kw_only=True)
class VehicleOptions:
    """What to simulate. Angles in degrees, as they come from a command line.

    scenario : a name of `VEHICLE_SCENARIOS`
    grade : a name of imu_grades.yaml, or a grade of one's own
    seed : of everything random; the same seed with another option keeps all other numbers
    rate_hz, duration_s : of the IMU; the first sample is at 0 s, the last one at duration_s
    latitude_deg, longitude_deg, altitude_m : of the IMU at 0 s
    sampling : 'instantaneous' (value at the stamp) or 'mean' (over the interval ending there)
    heading_deg : course at 0 s, clockwise from north; None: uniformly random
    ground_roll_deg, ground_pitch_deg : tilt of the ground at the start, REP-103 (right side
        down, nose down), left behind over the first metres; None: random within 2 deg
    odometer_lever_arm_m : IMU to the odometer's reference point, in b (FLU)
    mounting_rpy_deg : roll, pitch, yaw of C_bm = Rz Ry Rx, which maps vehicle axes to b
    sideslip_deg_per_m_s2 : heading beyond the course (inwards) per lateral acceleration
    suspension_roll_deg_per_m_s2 : outwards per lateral acceleration
    suspension_pitch_deg_per_m_s2 : nose up per forward acceleration
    road_motion_deg : rms of roll and of pitch, 0.5 to 2.5 Hz, when driving
    direction_noise_deg : rms of the vehicle's direction of travel in its own axes, sideways
        and up, correlated over 2 and 1 s, when driving
    standing_motion_arcsec : rms about each axis, when standing
    lost_fraction : of the IMU samples; the first and the last one are never lost
    stamp_jitter_s : 1 sigma, cut at 0.45 sampling intervals; the value is that of the true time
    start_stamp_ns : stamp of the first IMU sample, before jitter
    odometer_rate_hz : the first sample comes within the second interval
    odometer_scale_error : measured over true distance, minus 1; None: random, 1 sigma is
        odometer_scale_sigma
    scale_step : (at_s, change): from then on the odometer counts by that part of the
        distance more; None: never
    odometer_quantum_m : distance of one count; 0: not quantised
    odometer_noise_m_s : white noise of the speed, 1 sigma
    odometer_latency_s : by how much the stamps are late
    odometer_clock_drift : of the stamps, seconds per second
    odometer_jitter_s : of the stamps, 1 sigma, cut at 0.45 intervals
    odometer_report_variance : fill in the variance; otherwise it is 0, not known
    unsigned_wheel : the wheel counts up in reverse too
    slip_count, slip_duration_s, slip_fraction : the wheel turns too far by that fraction, at
        random times
    dropouts, stuck : (begin_s, duration_s) without samples; with a speed of 0
    outlier_fraction : of the samples, replaced by a speed anywhere in -20..40 m/s

    Raises
    ------
    ValueError : a value that cannot be simulated; names the field
    """

    scenario: str = "urban"
    grade: str | ImuGrade = "fog"
    seed: int = 0
    rate_hz: float = 200.0
    duration_s: float = 600.0
    latitude_deg: float = 40.0
    longitude_deg: float = 116.0
    altitude_m: float = 50.0
    sampling: str | ImuSampling = "instantaneous"
    heading_deg: float | None = None
    ground_roll_deg: float | None = None
    ground_pitch_deg: float | None = None
    odometer_lever_arm_m: Triple = (0.0, 0.0, 0.0)
    mounting_rpy_deg: Triple = (0.0, 0.0, 0.0)
    sideslip_deg_per_m_s2: float = 0.15
    suspension_roll_deg_per_m_s2: float = 0.3
    suspension_pitch_deg_per_m_s2: float = 0.2
    road_motion_deg: float = 0.1
    direction_noise_deg: float = 0.05
    standing_motion_arcsec: float = 5.0
    lost_fraction: float = 0.0
    stamp_jitter_s: float = 0.0
    start_stamp_ns: int = 1_700_000_000_000_000_000
    odometer_rate_hz: float = 20.0
    odometer_scale_error: float | None = None
    odometer_scale_sigma: float = 0.01
    scale_step: tuple[float, float] | None = None
    odometer_quantum_m: float = 0.01
    odometer_noise_m_s: float = 0.0
    odometer_latency_s: float = 0.0
    odometer_clock_drift: float = 0.0
    odometer_jitter_s: float = 0.0
    odometer_report_variance: bool = False
    unsigned_wheel: bool = False
    slip_count: int = 0
    slip_duration_s: float = 2.0
    slip_fraction: float = 0.5
    dropouts: Spans = ()
    stuck: Spans = ()
    outlier_fraction: float = 0.0

    def __post_init__(self) -> None:
        if self.scenario not in VEHICLE_SCENARIOS:
            raise ValueError(
                f"scenario: no {self.scenario!r}; known are {', '.join(VEHICLE_SCENARIOS)}"
            )
        _ = self.imu_grade  # raises for a name that is not known
        known = [kind.value for kind in ImuSampling]
        if not isinstance(self.sampling, ImuSampling) and self.sampling not in known:
            raise ValueError(f"sampling: {self.sampling!r} is not one of {', '.join(known)}")
        self._check_numbers()
        self._check_compounds()
        self._check_ranges()

    @property
    def imu_grade(self) -> ImuGrade:
        """The grade itself."""
        return self.grade if isinstance(self.grade, ImuGrade) else load_grade(self.grade)

    @property
    def imu_sampling(self) -> ImuSampling:
        """`sampling` as the enumeration."""
        return ImuSampling(self.sampling)

    def _check_numbers(self) -> None:
        maybe = tuple(name for name in _MAYBE_FINITE if getattr(self, name) is not None)
        names = (*_FINITE, *maybe, *_GRADIENTS, *_NOT_NEGATIVE, *_POSITIVE, *_FRACTIONS)
        for name in (*names, "slip_fraction", "odometer_clock_drift"):
            value = getattr(self, name)
            if not math.isfinite(value):
                raise ValueError(f"{name}: {value} is not finite")
            if name in _NOT_NEGATIVE and value < 0:
                raise ValueError(f"{name}: {value} is negative")
            if name in _POSITIVE and value <= 0.0:
                raise ValueError(f"{name}: {value} is not positive")
            if name in _FRACTIONS and not 0.0 <= value < 1.0:
                raise ValueError(f"{name}: {value} is not within 0..1")

    def _check_compounds(self) -> None:
        for name in _VECTORS:
            vector = getattr(self, name)
            if not (len(vector) == 3 and all(math.isfinite(x) for x in vector)):
                raise ValueError(f"{name}: {vector} is not three finite numbers")
        for name in _SPANS:
            for span in getattr(self, name):
                if not (len(span) == 2 and math.isfinite(span[0]) and 0.0 < span[1] < math.inf):
                    raise ValueError(f"{name}: {span} is not a begin and a duration in seconds")
        step = self.scale_step
        if step is not None and not (
            len(step) == 2 and math.isfinite(step[0]) and -1.0 < step[1] < math.inf
        ):
            raise ValueError(f"scale_step: {step} is not a time in seconds and a relative change")

    def _check_ranges(self) -> None:
        if abs(self.latitude_deg) > _MOST_LATITUDE_DEG:
            raise ValueError(
                f"latitude_deg: {self.latitude_deg} is not within "
                f"-{_MOST_LATITUDE_DEG}..{_MOST_LATITUDE_DEG}"
            )
        if not 0.0 <= self.stamp_jitter_s <= 0.25 / self.rate_hz:
            raise ValueError(
                f"stamp_jitter_s: {self.stamp_jitter_s} is not within 0..{0.25 / self.rate_hz}, "
                "a quarter of the sampling interval"
            )
        if self.duration_s * self.rate_hz < 1.0:
            raise ValueError(f"duration_s: {self.duration_s} is less than a sampling interval")
        if abs(self.odometer_clock_drift) > 0.1:
            raise ValueError(
                f"odometer_clock_drift: {self.odometer_clock_drift} is not within -0.1..0.1"
            )
