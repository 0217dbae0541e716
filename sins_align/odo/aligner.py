"""The aligner of `odo_align`: pairs IMU and odometer, starts the filter, gives its estimate."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from sins_align.config import OdoConfig
from sins_align.earth import earth_rate_n
from sins_align.increments import integrate_rotation
from sins_align.limits import heading_limit
from sins_align.odo.coarse import CoarseAligner, CoarseAttitude
from sins_align.odo.epoch import AidedEpoch, integrate_epoch
from sins_align.odo.imu_model import accel_variance
from sins_align.odo.layout import ACCEL_BIAS, GYRO_BIAS, ODOMETER
from sins_align.odo.navigation import WanderNavigation
from sins_align.odo.odometer_model import LATENCY, OdometerModel
from sins_align.odo.pairing import EPOCH_S, Paired, Pairing
from sins_align.odo.standing import StandingDetector
from sins_align.odo.wander import WanderFilter
from sins_align.rotation import (
    dcm_from_quaternion,
    exp_rotation,
    multiply_quaternions,
    quaternion_from_dcm,
)
from sins_align.types import Advance, Array, Estimate, ImuBlock, OdometerSamples, Position

# A heading less certain than this is not published.
PUBLISH_SIGMA = math.radians(3.0)
# The filter starts with so many epochs at hand, for its levels.
START_EPOCHS = 3
# `wander_ekf` starts with an azimuth known so well.
EKF_SIGMA = math.radians(10.0)
# Least sigma of the levels at the start [rad]: they come of epochs that the filter takes in
# again. Sigma of the velocity: absolute [m/s], and relative.
LEVEL_SIGMA = 0.01
VELOCITY_SIGMA = 0.2
VELOCITY_SHARE = 0.05

# Once the azimuth is known, nothing is gained by epochs as short as before.
LONG_EPOCH_S = 2.0

SILENT = "no odometer"
SILENT_REMEDY = "publish topic odom, or set aiding to stationary if the vehicle stands"
DRIVE_REMEDY = "drive turns and stops, or stand still"
UNOBSERVABLE_REMEDY = "this gyro cannot find north here: there is no remedy but a better one"


class OdoAligner:
    """Alignment of a moving vehicle; fulfils `AidedAligner`.

    Parameters
    ----------
    config : the settings
    position : latitude and altitude give Earth rate and gravity
    """

    def __init__(self, config: OdoConfig, position: Position) -> None:
        self._config = config
        self._position = position
        self._pairing = Pairing(None if config.stationary else config.odometer)
        self._detector = StandingDetector(config.grade, config.stationary)
        self._coarse = self._make_coarse()
        self._early: list[tuple[Paired, AidedEpoch]] = []  # before the start
        self._silent = 0  # epochs without an odometer before the start
        self._filter: WanderFilter | None = None
        self._estimate: Estimate | None = None
        self._turned: Array | None = None  # by the IMU samples since the last epoch
        self._accel_triad = np.zeros(3)  # of the accelerometers' biases, not in the filter's P
        self._limit = heading_limit(config.grade, position.latitude)

    def update(self, block: ImuBlock) -> list[Advance]:
        """Take in the next block of samples; a step for every epoch that is whole."""
        self._pairing.add_imu(block)
        return self._advance()

    def aid(self, samples: OdometerSamples) -> list[Advance]:
        """Take in samples of the odometer; a step for every epoch that waited for them."""
        self._pairing.add_odometer(samples)
        return self._advance()

    def _advance(self) -> list[Advance]:
        self._turned = None
        steps = []
        while (paired := self._pairing.next(self._delay(), self._length())) is not None:
            steps.append(self._take_in(paired))
        return steps

    def _delay(self) -> float:
        latency = self._config.odometer.latency
        return (
            latency if self._filter is None else latency + float(self._filter.odometer.x[LATENCY])
        )

    def _length(self) -> float:
        """How long the next epoch should be [s]."""
        return LONG_EPOCH_S if self._filter is not None and self._filter.one_azimuth else EPOCH_S

    def _take_in(self, paired: Paired) -> Advance:
        stamp_ns = int(paired.block.stamp_ns[-1])
        if self._filter is not None:
            self._process(self._filter, paired)
        elif not self._begin(paired):
            self._silent += 1  # the first epoch is never whole: that alone means nothing
            silent = self._silent >= START_EPOCHS
            return Advance(stamp_ns, None, *((SILENT, SILENT_REMEDY) if silent else ("", "")))
        self._estimate = self._estimate_at(stamp_ns)
        if self._estimate is None:
            return Advance(stamp_ns, None, *self._why_not())
        return Advance(stamp_ns, self._estimate)

    def _begin(self, paired: Paired) -> bool:
        """Start the filter where enough is known; False where the odometer is silent."""
        epoch = integrate_epoch(paired, self._config.sampling)
        standing = self._config.stationary
        if epoch.travel is None and not standing:
            self._coarse = self._make_coarse()
            self._early.clear()
            return False
        self._coarse.add(epoch, standing)
        self._early.append((paired, epoch))
        if len(self._early) < START_EPOCHS:
            return True
        coarse = self._coarse.attitude
        if coarse is None:
            return True
        if self._config.method == "wander_ekf":
            # One azimuth state is linearised about an azimuth that has to be found first.
            self._early = self._early[-START_EPOCHS:]
            if coarse.covariance[2, 2] < EKF_SIGMA**2:
                self._filter = self._start_at_end(coarse, epoch)
                self._early.clear()
            return True
        self._filter = self._start_at_begin(coarse, self._early[0][1])
        for early, _ in self._early:
            self._process(self._filter, early)
        self._early.clear()
        return True

    def _make_coarse(self) -> CoarseAligner:
        return CoarseAligner(self._position, self._config.grade, self._config.odometer)

    def _start_at_begin(self, coarse: CoarseAttitude, first: AidedEpoch) -> WanderFilter:
        """`wander_kf` at the begin of the first epoch: level, and of no azimuth."""
        speed = 0.0 if first.travel is None else first.travel.speed_start
        return self._make_filter(coarse.C_n0b0, coarse, speed)

    def _start_at_end(self, coarse: CoarseAttitude, last: AidedEpoch) -> WanderFilter:
        """`wander_ekf` at the end of the last epoch, in ENU for a: alpha is zero."""
        speed = 0.0 if last.travel is None else last.travel.speed_end
        filter_ = self._make_filter(coarse.C_nb, coarse, speed, float(coarse.covariance[2, 2]))
        filter_.navigation.e_a[1] = math.cos(self._position.latitude)
        return filter_

    def _make_filter(
        self, C_ab: Array, coarse: CoarseAttitude, speed: float, variance: float | None = None
    ) -> WanderFilter:
        """The filter at an attitude and a forward speed; variance : of the azimuth."""
        odometer = OdometerModel(self._config.odometer)
        v_a = speed * (C_ab @ odometer.C_bm[:, 0])
        navigation = WanderNavigation(C_ab, v_a, self._position)
        level = max(LEVEL_SIGMA, math.sqrt(float(coarse.covariance.diagonal()[:2].max())))
        velocity = math.hypot(VELOCITY_SIGMA, VELOCITY_SHARE * speed)
        azimuth = None if variance is None else math.sqrt(variance)
        # On a vehicle a scale error looks like a bias: the filter knows their sum.
        self._accel_triad = accel_variance(
            replace(self._config.grade, accel_bias=0.0), navigation.C_ab[2]
        )
        return WanderFilter(navigation, odometer, self._config.grade, level, velocity, azimuth)

    def _process(self, filter_: WanderFilter, paired: Paired) -> None:
        filter_.odometer.quantum = self._pairing.quantum
        epoch = integrate_epoch(paired, self._config.sampling, filter_.bias(paired.block.w_ib_b))
        self._detector.note(epoch, filter_.process(epoch, self._detector.judge(epoch)))

    def _why_not(self) -> tuple[str, str]:
        """Why there is no estimate yet, and what helps."""
        if not self._limit < PUBLISH_SIGMA:
            limit = f"the declared gyro bias allows {math.degrees(self._limit):.0f} deg"
            return f"heading is unobservable at this latitude: {limit}", UNOBSERVABLE_REMEDY
        if self._filter is None:
            return "", ""
        sigma = math.degrees(self._filter.azimuth().sigma)
        return f"heading sigma {sigma:.0f} deg, not below {math.degrees(PUBLISH_SIGMA):.0f}", ""

    @property
    def estimate(self) -> Estimate | None:
        """At the end of the last epoch; None before heading deserves the name."""
        return self._estimate

    def propagate(self, block: ImuBlock) -> Estimate | None:
        """`estimate` carried to the end of `block` by the gyros; changes nothing seen outside."""
        return None if self._filter is None else self._estimate_at(int(block.stamp_ns[-1]), block)

    def conclude(self, block: ImuBlock) -> Estimate | None:
        """As `propagate`: all that has come is in the estimate already."""
        return self.propagate(block)

    def _estimate_at(self, stamp_ns: int, block: ImuBlock | None = None) -> Estimate | None:
        filter_ = self._filter
        if filter_ is None:
            return None
        attitude = filter_.attitude()
        covariance, C_nb = attitude.covariance, attitude.C_nb
        if not covariance[2, 2] < PUBLISH_SIGMA**2:
            return None
        if block is not None:
            C_nb, ahead_s = self._carry(filter_, C_nb, block)
            covariance = covariance + self._config.grade.gyro_arw**2 * ahead_s * np.eye(3)
        variance = filter_.P.diagonal()
        odometer = filter_.odometer.estimate(filter_.P[ODOMETER, ODOMETER])
        return Estimate(
            stamp_ns=stamp_ns,
            q_nb=quaternion_from_dcm(C_nb),
            misalignment_covariance=covariance,
            gyro_bias=filter_.gyro_bias,
            gyro_bias_sigma=np.sqrt(variance[GYRO_BIAS]),
            accel_bias=filter_.accel_bias,
            accel_bias_sigma=np.sqrt(variance[ACCEL_BIAS] + self._accel_triad),
            odometer=None if self._config.stationary else odometer,
            consistency=filter_.consistency,
        )

    def _carry(self, filter_: WanderFilter, C_nb: Array, block: ImuBlock) -> tuple[Array, float]:
        """C_nb at the end of `block`, and how far that is from the last epoch's end [s]."""
        waiting = self._pairing.pending_block()
        sampling = self._config.sampling
        q, begin_ns = integrate_rotation(block, sampling), int(block.stamp_ns[0])
        if waiting is not None:
            if self._turned is None:
                self._turned = integrate_rotation(waiting, sampling)
            q, begin_ns = multiply_quaternions(self._turned, q), int(waiting.stamp_ns[0])
        ahead_s = int(block.stamp_ns[-1] - begin_ns) * 1e-9
        # The biases and the turning of n itself are small angles.
        C = dcm_from_quaternion(q / np.linalg.norm(q))
        C = C_nb @ C @ exp_rotation(-filter_.gyro_bias * ahead_s)
        w_ie_n = earth_rate_n(self._position.latitude)
        return exp_rotation(-w_ie_n * ahead_s) @ C, ahead_s
