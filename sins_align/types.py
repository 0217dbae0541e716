"""The values that pass between the layers: samples in, estimates out.

All of them are immutable. Shapes, units and frames are those of the package's page.
"""

from __future__ import annotations

import enum
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sins_align.reasons import Finding, texts

Array = NDArray[np.float64]
IntArray = NDArray[np.int64]


class ImuSamples(NamedTuple):
    """Consecutive IMU samples, in the order in which they arrived.

    stamp_ns : (N,) int64 time of the sample [ns]
    w_ib_b : (3, N) angular rate [rad/s]
    f_ib_b : (3, N) specific force [m/s^2]

    What a value stands for (the mean over the interval that ends at the stamp, or the
    instantaneous value) is a matter of the configuration, `ImuSampling`.
    """

    stamp_ns: IntArray
    w_ib_b: Array
    f_ib_b: Array

    def __len__(self) -> int:  # number of samples, not of fields
        return int(self.stamp_ns.shape[0])

    def select(self, index: slice | IntArray | NDArray[np.bool_]) -> ImuSamples:
        """The samples that `index` picks, in its order."""
        return ImuSamples(self.stamp_ns[index], self.w_ib_b[:, index], self.f_ib_b[:, index])


class OdometerSamples(NamedTuple):
    """Consecutive odometer samples, in the order in which they arrived.

    stamp_ns : (N,) int64 end of the interval that the value stands for [ns]
    speed : (N,) forward speed of the vehicle, its mean over that interval [m/s]; negative
        in reverse
    variance : (N,) of the speed [m^2/s^2], 0 where it is not known
    """

    stamp_ns: IntArray
    speed: Array
    variance: Array

    def __len__(self) -> int:  # number of samples, not of fields
        return int(self.stamp_ns.shape[0])

    def select(self, index: slice | IntArray | NDArray[np.bool_]) -> OdometerSamples:
        """The samples that `index` picks, in its order."""
        return OdometerSamples(self.stamp_ns[index], self.speed[index], self.variance[index])


class ImuSampling(enum.Enum):
    """What the value of an IMU sample stands for."""

    MEAN = "mean"  # mean over the interval that ends at the stamp
    INSTANTANEOUS = "instantaneous"


class State(enum.Enum):
    """Where the alignment stands; the words are those of the diagnostics."""

    WAITING = "waiting"
    COARSE = "coarse"
    FINE = "fine"
    ALIGNED = "aligned"
    FAILED = "failed"


@dataclass(frozen=True)
class Position:
    """Geodetic position on WGS-84 [rad, rad, m]."""

    latitude: float
    longitude: float = 0.0
    altitude: float = 0.0


@dataclass(frozen=True)
class LeverArm:
    """Lever arm from the swing centre to the IMU.

    r_b : (3,) in b [m]
    covariance : (3, 3) [m^2]
    observable : three booleans, one a body axis. False: the motion does not tell, and the
        value is near the prior's.
    """

    r_b: Array
    covariance: Array
    observable: tuple[bool, bool, bool]


@dataclass(frozen=True)
class OdometerEstimate:
    """What was found out about the odometer.

    scale_error, scale_sigma : measured distance over true distance, minus 1
    latency_s, latency_sigma_s : by how much the stamps are late
    mounting_rpy : (3,) rotation of the vehicle's axes in b, C_bm = Rz Ry Rx [rad]: the
        vehicle travels along C_bm @ (1, 0, 0). mounting_covariance : (3, 3) of small
        rotations about x, y, z of b [rad^2]
    lever_arm_b, lever_arm_covariance : (3,), (3, 3) from the IMU to the odometer's reference
        point, in b [m], [m^2]
    """

    scale_error: float
    scale_sigma: float
    latency_s: float
    latency_sigma_s: float
    mounting_rpy: Array
    mounting_covariance: Array
    lever_arm_b: Array
    lever_arm_covariance: Array


class LatitudeEstimate(NamedTuple):
    """The latitude that the data tell, with its 1 sigma [rad]."""

    latitude: float
    sigma: float


class Witness(NamedTuple):
    """Another estimate of the same attitude, from the same data.

    name : of the method
    phi : (3,) misalignment of the estimate against it, axes east, north, up [rad]
    square : normalised square of phi, by the covariances of both, over its expectation for
        two that are independent
    """

    name: str
    phi: Array
    square: float


@dataclass(frozen=True)
class Estimate:
    """An alignment at the time of one sample.

    stamp_ns : time of the last sample used [ns]
    q_nb : (4,) attitude, Hamilton, scalar first
    misalignment_covariance : (3, 3) of phi, axes east, north, up [rad^2]
    gyro_bias, gyro_bias_sigma : (3,) [rad/s]
    accel_bias, accel_bias_sigma : (3,) [m/s^2]
    lever_arm, odometer : None where the method has none
    consistency : mean normalised innovation squared over its expected value, of late: above 1
        the data are worse than declared, below 1 better; NaN before there is an innovation
    witness : another estimate from the same data, where there is one
    steadiness : largest square of a change of heading from an earlier solution to this one, over
        its variance; NaN before there are enough, None where the method has none
    latitude : as the data tell it, None where they do not
    """

    stamp_ns: int
    q_nb: Array
    misalignment_covariance: Array
    gyro_bias: Array
    gyro_bias_sigma: Array
    accel_bias: Array
    accel_bias_sigma: Array
    lever_arm: LeverArm | None = None
    odometer: OdometerEstimate | None = None
    consistency: float = float("nan")
    witness: Witness | None = None
    steadiness: float | None = None
    latitude: LatitudeEstimate | None = None

    @property
    def sigma(self) -> Array:
        """(3,) 1-sigma misalignment east, north, up [rad]."""
        return np.sqrt(self.misalignment_covariance.diagonal())


@dataclass(frozen=True)
class Status:
    """Where the alignment stands, and why not further.

    findings : why it is not aligned yet; of an aligned one what is to be said all the same
    aligned_at_s : time from the first sample to completion [s], None before
    heading_limit : what declared sensors, latitude and the time so far allow [rad], NaN when
        unknown
    """

    state: State
    findings: tuple[Finding, ...] = ()
    elapsed_s: float = 0.0
    aligned_at_s: float | None = None
    heading_limit: float = float("nan")

    @property
    def reason(self) -> str:
        """Why it is not aligned yet, in words; empty when there is nothing to say."""
        return texts(self.findings)[0]

    @property
    def remedy(self) -> str:
        """What the operator can do; empty when nothing needs doing."""
        return texts(self.findings)[1]

    @property
    def keys(self) -> tuple[str, ...]:
        """The findings' names in the table of reasons."""
        return tuple(dict.fromkeys(f.reason.key for f in self.findings))


@dataclass
class InputCounts:
    """What came in and what was refused. A rejected sample changes nothing else.

    imu_samples : accepted
    imu_gaps : places where samples are missing; imu_lost: how many samples that makes
    rejected : by reason: not_finite, out_of_range, repeated, backward
    """

    imu_samples: int = 0
    imu_gaps: int = 0
    imu_lost: int = 0
    imu_reordered: int = 0
    rejected: dict[str, int] = field(
        default_factory=lambda: {"not_finite": 0, "out_of_range": 0, "repeated": 0, "backward": 0}
    )
    odom_samples: int = 0
    odom_rejected: int = 0
    first_stamp_ns: int | None = None
    last_stamp_ns: int | None = None

    @property
    def imu_rejected(self) -> int:
        """Number of samples refused, for whatever reason."""
        return sum(self.rejected.values())

    @property
    def duration_s(self) -> float:
        """Time from the first to the last accepted sample [s]."""
        if self.first_stamp_ns is None or self.last_stamp_ns is None:
            return 0.0
        return (self.last_stamp_ns - self.first_stamp_ns) * 1e-9


class ImuBlock(NamedTuple):
    """Samples between two stamps of the processing grid, both ends included.

    stamp_ns : (n+1,) int64. The first one is the last one of the block before.
    w_ib_b, f_ib_b : (3, n+1). For `ImuSampling.MEAN` column k is the mean over
        (stamp k-1, stamp k], and column 0 belongs to the block before.
    """

    stamp_ns: IntArray
    w_ib_b: Array
    f_ib_b: Array


class Advance(NamedTuple):
    """How far an aligner has come.

    stamp_ns : of the last sample used [ns]
    estimate : None before the coarse attitude exists
    findings : why not, or what there is to be said of it
    """

    stamp_ns: int
    estimate: Estimate | None
    findings: tuple[Finding, ...] = ()


class Update(NamedTuple):
    """What one block of samples led to."""

    stamp_ns: int
    estimate: Estimate | None
    status: Status
