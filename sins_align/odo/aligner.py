"""The aligner of `odo_align`: pairs IMU and odometer, starts the filter, gives its estimate."""

from __future__ import annotations

import math

import numpy as np

from sins_align.config import OdoConfig
from sins_align.increments import integrate_rotation
from sins_align.limits import heading_limit
from sins_align.odo.epoch import integrate_epoch
from sins_align.odo.knowledge import carry_attitude, knowledge_of
from sins_align.odo.odometer_model import LATENCY
from sins_align.odo.pairing import EPOCH_S, Paired, Pairing
from sins_align.odo.standing import StandingDetector
from sins_align.odo.start import Starter
from sins_align.odo.wander import WanderFilter
from sins_align.rotation import (
    dcm_from_quaternion,
    multiply_quaternions,
    quaternion_from_dcm,
)
from sins_align.types import Advance, Array, Estimate, ImuBlock, OdometerSamples, Position

# A heading less certain than this is not published.
PUBLISH_SIGMA = math.radians(3.0)
# Nor is a first one whose innovations say that sigma is not true.
PUBLISH_CONSISTENCY = 2.0
# A filter begins anew when it is no older than so many epochs and one of them contradicts it by
# so large a normalised square; or than so many, and they do on the whole.
INFANT_EPOCHS, CONTRADICTION = 8, 100.0
YOUNG_EPOCHS, DISBELIEF = 60, 6.0
MOST_BEGINNINGS = 3
# Once the azimuth is known, nothing is gained by epochs as short as before.
LONG_EPOCH_S = 2.0

SILENT = "no odometer"
SILENT_REMEDY = "publish topic odom, or set aiding to stationary if the vehicle stands"
POLE = "there is no heading at the pole"
CHECK_REMEDY = "check the odometer, imu_grade, imu_sampling and aiding"
TURN_REMEDY = "drive turns: standing, the declared gyro bias does not allow it"
# Nearer to a pole the Earth's rate is vertical, and no gyro of a vehicle finds north.
LEAST_COS_LATITUDE = 0.02
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
        self._starter = Starter(config, position)
        self._begun_anew = 0
        self._filter: WanderFilter | None = None
        self._estimate: Estimate | None = None
        self._turned: Array | None = None  # by the IMU samples since the last epoch
        self._limit = heading_limit(config.grade, position.latitude)
        self._is_polar = math.cos(position.latitude) < LEAST_COS_LATITUDE

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
        return LONG_EPOCH_S if self._filter is not None and self._filter.is_fine else EPOCH_S

    def _take_in(self, paired: Paired) -> Advance:
        stamp_ns = int(paired.block.stamp_ns[-1])
        if self._filter is not None:
            self._process(self._filter, paired)
        else:
            started = self._starter.add(paired, self._pairing.quantum)
            if started is not None:
                self._filter, waiting = started
                for early in waiting:
                    self._process(self._filter, early)
        if self._filter is not None and self._is_stillborn(self._filter):
            self._filter, self._starter = None, Starter(self._config, self._position)
            self._begun_anew += 1
        self._estimate = self._estimate_at(stamp_ns)
        if self._estimate is None:
            return Advance(stamp_ns, None, *self._why_not())
        return Advance(stamp_ns, self._estimate)

    def _is_stillborn(self, filter_: WanderFilter) -> bool:
        """Whether the first epochs contradict each other: one of them was an outlier.

        A young filter believes the first ones, whichever it was.
        """
        if self._begun_anew == MOST_BEGINNINGS:
            return False
        infant = filter_.epochs <= INFANT_EPOCHS and filter_.nis > CONTRADICTION
        return infant or (filter_.epochs <= YOUNG_EPOCHS and filter_.consistency > DISBELIEF)

    def _process(self, filter_: WanderFilter, paired: Paired) -> None:
        filter_.odometer.quantum = self._pairing.quantum
        epoch = integrate_epoch(paired, self._config.sampling, filter_.bias(paired.block.w_ib_b))
        self._detector.note(epoch, filter_.process(epoch, self._detector.judge(epoch)))

    def _why_not(self) -> tuple[str, str]:
        """Why there is no estimate yet, and what helps."""
        if math.isnan(self._limit):
            return POLE, ""
        if self._is_polar:
            limit = f"the declared gyro bias allows {math.degrees(self._limit):.0f} deg"
            return f"heading is unobservable at this latitude: {limit}", UNOBSERVABLE_REMEDY
        if self._filter is None:
            # The first epoch is never whole: that alone means nothing.
            silent = self._starter.silent > 2
            return (SILENT, SILENT_REMEDY) if silent else ("", "")
        sigma = math.degrees(self._filter.azimuth().sigma)
        reason = f"heading sigma {sigma:.0f} deg, not below {math.degrees(PUBLISH_SIGMA):.0f}"
        if self._filter.consistency > PUBLISH_CONSISTENCY:
            ratio = self._filter.consistency
            return (
                f"{reason}; the innovations are {ratio:.1f} times what they should be",
                CHECK_REMEDY,
            )
        return reason, "" if self._limit < PUBLISH_SIGMA else TURN_REMEDY

    @property
    def estimate(self) -> Estimate | None:
        """At the end of the last epoch; None before heading deserves the name."""
        return self._estimate

    def propagate(self, block: ImuBlock) -> Estimate | None:
        """`estimate` carried to the end of `block` by the gyros; changes nothing seen outside."""
        return None if self._estimate is None else self._estimate_at(int(block.stamp_ns[-1]), block)

    def conclude(self, block: ImuBlock) -> Estimate | None:
        """As `propagate`: all that has come is in the estimate already."""
        return self.propagate(block)

    def _estimate_at(self, stamp_ns: int, block: ImuBlock | None = None) -> Estimate | None:
        filter_ = self._filter
        if filter_ is None or self._is_polar:
            return None
        knowledge = knowledge_of(filter_)
        C_nb, covariance = knowledge.C_nb, knowledge.covariance
        if not covariance[2, 2] < PUBLISH_SIGMA**2:
            return None
        if self._estimate is None and filter_.consistency > PUBLISH_CONSISTENCY:
            return None
        if block is not None:
            C_nb, ahead_s = self._carry(filter_, C_nb, block)
            covariance = covariance + self._config.grade.gyro_arw**2 * ahead_s * np.eye(3)
        return Estimate(
            stamp_ns=stamp_ns,
            q_nb=quaternion_from_dcm(C_nb),
            misalignment_covariance=covariance,
            gyro_bias=knowledge.gyro_bias,
            gyro_bias_sigma=knowledge.gyro_bias_sigma,
            accel_bias=knowledge.accel_bias,
            accel_bias_sigma=knowledge.accel_bias_sigma,
            odometer=None if self._config.stationary else knowledge.odometer,
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
        turned = dcm_from_quaternion(q / np.linalg.norm(q))
        return carry_attitude(filter_, C_nb, turned, ahead_s), ahead_s
