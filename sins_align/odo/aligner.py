"""The aligner of `odo_align`: pairs IMU and odometer, starts the filters, gives the estimate."""

from __future__ import annotations

import math

import numpy as np

from sins_align.config import OdoConfig
from sins_align.increments import integrate_rotation
from sins_align.limits import heading_limit
from sins_align.odo.doubts import Doubts
from sins_align.odo.epoch import AidedEpoch, as_measured, integrate_epoch
from sins_align.odo.filter import AidedFilter
from sins_align.odo.foresight import Foresight
from sins_align.odo.knowledge import Knowledge, carry_attitude, compare_attitudes, knowledge_of
from sins_align.odo.large_azimuth import LargeAzimuthFilter
from sins_align.odo.methods import (
    can_follow,
    coarse_sigma,
    has_large_azimuth,
    has_witness,
    make_large_azimuth_filter,
)
from sins_align.odo.odometer_model import LATENCY
from sins_align.odo.pairing import EPOCH_S, Paired, Pairing
from sins_align.odo.publication import (
    is_polar,
    is_published,
    published_latitude,
    why_not_here,
    why_not_published,
)
from sins_align.odo.standing import StandingDetector
from sins_align.odo.start import Starter
from sins_align.odo.wander import WanderFilter
from sins_align.reasons import AZIMUTH_LOST, LEVELLING, NO_ODOMETER, Finding
from sins_align.rotation import dcm_from_quaternion, multiply_quaternions, quaternion_from_dcm
from sins_align.types import (
    Advance,
    Array,
    Estimate,
    ImuBlock,
    LatitudeEstimate,
    OdometerSamples,
    Position,
    Witness,
)

# A filter begins anew when it is no older than so many epochs and one of them contradicts it by
# so large a normalised square; or than so many, and they do on the whole.
INFANT_EPOCHS, CONTRADICTION = 8, 100.0
YOUNG_EPOCHS, DISBELIEF = 60, 6.0
MOST_BEGINNINGS = 3
# Once the azimuth is known, nothing is gained by epochs as short as before.
LONG_EPOCH_S = 2.0


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
        self._doubts = Doubts(config, position.latitude)
        self._begun_anew = 0
        self._has_lost_azimuth = False
        self._begin()
        self._estimate: Estimate | None = None
        self._turned: Array | None = None  # by the IMU samples since the last epoch
        self._limit = heading_limit(config.grade, position.latitude)
        self._is_polar = is_polar(position.latitude)

    def _begin(self) -> None:
        self._starter = Starter(self._config, self._position, coarse_sigma(self._config))
        # The wander filter comes first; one with a large azimuth error follows, if asked for.
        self._wander: WanderFilter | None = None
        self._large: LargeAzimuthFilter | None = None
        self._foresight = Foresight()
        self._doubts.follow(None)
        self._known: Knowledge | None = None  # of the filter that is given out
        self._witness: Witness | None = None

    @property
    def _filter(self) -> AidedFilter | None:
        """The one that is given out."""
        return self._wander if self._large is None else self._large

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
        steps: list[Advance] = []
        while True:
            filter_ = self._filter
            delay = 0.0 if filter_ is None else float(filter_.odometer.x[LATENCY])
            paired = self._pairing.next(self._config.odometer.latency + delay, self._length())
            if paired is None:
                return steps
            steps.append(self._take_in(paired, delay))

    def _length(self) -> float:
        """How long the next epoch should be [s]."""
        filters = self._filters()
        return LONG_EPOCH_S if filters and all(f.is_fine for f in filters) else EPOCH_S

    def _filters(self) -> list[AidedFilter]:
        """All that run, the one that is given out first."""
        return [f for f in (self._large, self._wander) if f is not None]

    def _take_in(self, paired: Paired, delay: float) -> Advance:
        """Take in an epoch, paired with the odometer `delay` [s] later than is declared."""
        stamp_ns = int(paired.block.stamp_ns[-1])
        stands = self._config.stationary
        if self._filter is not None:
            stands, measured = self._process(paired, delay)
        else:
            measured = integrate_epoch(paired, self._config.sampling)
            started = self._starter.add(paired, self._pairing.quantum)
            if started is not None:
                self._wander, waiting = started
                for early in waiting:
                    self._process(early, 0.0)
        if any(map(self._is_stillborn, self._filters())):
            self._begin()
            self._begun_anew += 1
        if self._doubts.add(measured, stands):
            # What was learned of an odometer that was wrong is wrong.
            self._begin()
            self._begun_anew = 0
        self._give_up()
        self._follow()
        self._known = None if self._filter is None else knowledge_of(self._filter)
        if self._known is not None and self._large is not None and self._wander is not None:
            self._witness = compare_attitudes(self._known, knowledge_of(self._wander))
        self._estimate = self._estimate_at(stamp_ns)
        if self._estimate is None:
            return Advance(stamp_ns, None, (*self._doubts_now(), *self._why_not()))
        return Advance(stamp_ns, self._estimate, self._doubts_now())

    def _doubts_now(self) -> tuple[Finding, ...]:
        return self._doubts.findings(self._own_latitude(), self._estimate is not None)

    def _own_latitude(self) -> LatitudeEstimate | None:
        return self._doubts.latitude(None if self._wander is None else self._wander.latitude)

    def _is_stillborn(self, filter_: AidedFilter) -> bool:
        """Whether the first epochs contradict each other: one of them was an outlier.

        A young filter believes the first ones, whichever it was.
        """
        if self._begun_anew == MOST_BEGINNINGS:
            return False
        infant = filter_.epochs <= INFANT_EPOCHS and filter_.nis > CONTRADICTION
        return infant or (filter_.epochs <= YOUNG_EPOCHS and filter_.consistency > DISBELIEF)

    def _process(self, paired: Paired, delay: float) -> tuple[bool, AidedEpoch]:
        """Every filter integrates the epoch with its own biases.

        Returns whether the vehicle stands, and the epoch as it was measured: biases that a wrong
        odometer has taught are not taken off.
        """
        first, *others = self._filters()
        bias = first.bias(paired.block.w_ib_b)
        epoch = self._integrate(first, paired, delay, bias)
        standing = self._detector.judge(epoch)
        stands = first.process(epoch, standing)
        self._detector.note(epoch, stands)
        for other in others:
            own = other.bias(paired.block.w_ib_b)
            other.process(self._integrate(other, paired, delay, own), standing)
        if self._wander is not None:
            self._foresight.add(self._wander)
        self._doubts.follow(self._wander)
        return stands, as_measured(epoch, bias)

    def _integrate(
        self, filter_: AidedFilter, paired: Paired, delay: float, bias: Array
    ) -> AidedEpoch:
        filter_.odometer.quantum = self._pairing.quantum
        epoch = integrate_epoch(paired, self._config.sampling, bias)
        own = float(filter_.odometer.x[LATENCY])
        if epoch.travel is None or own == delay:
            return epoch
        return epoch._replace(travel=epoch.travel.later(own - delay))

    def _give_up(self) -> None:
        """Go back to the wander filter where a large azimuth error is too large."""
        if self._large is None or not self._large.is_lost:
            return
        if self._wander is None:
            self._has_lost_azimuth = True
            self._begin()
        else:
            self._large = self._witness = None

    def _follow(self) -> None:
        """Start the filter with a large azimuth error, once the azimuth is known well enough."""
        wander = self._wander
        if wander is None or self._large is not None or self._is_polar:
            return
        if not has_large_azimuth(self._config):
            return
        if not has_witness(self._config):
            self._large, self._wander = make_large_azimuth_filter(self._config, wander), None
            self._has_lost_azimuth = False
        elif can_follow(self._config, wander):
            self._large = make_large_azimuth_filter(self._config, wander)

    def _why_not(self) -> tuple[Finding, ...]:
        """Why there is no estimate yet."""
        if self._is_polar:
            return (why_not_here(self._limit),)
        if self._filter is None:
            if self._has_lost_azimuth:
                return (AZIMUTH_LOST(),)
            # The first epoch is never whole: that alone means nothing.
            if self._starter.silent > 2:
                return (NO_ODOMETER(),)
            return (LEVELLING(elapsed_s=self._starter.collected_s),)
        assert self._known is not None
        return why_not_published(self._known, self._filter.consistency, self._limit)

    @property
    def estimate(self) -> Estimate | None:
        """At the end of the last epoch; None before heading deserves the name."""
        return self._estimate

    def foresee(self, heading: float) -> float:
        """See `Aligner`; by the wander filter, and NaN where there is none."""
        if self._estimate is not None and self._estimate.sigma[2] < heading:
            return 0.0
        if self._wander is None or self._is_polar:
            return math.nan
        return self._foresight.time_until(self._wander, heading)

    def next_step(self, ahead_s: float) -> float:
        """See `Aligner`: steps are a second or two apart."""
        return ahead_s

    def propagate(self, block: ImuBlock) -> Estimate | None:
        """`estimate` carried to the end of `block` by the gyros; changes nothing seen outside."""
        return None if self._estimate is None else self._estimate_at(int(block.stamp_ns[-1]), block)

    def conclude(self, block: ImuBlock) -> Estimate | None:
        """As `propagate`: all that has come is in the estimate already."""
        return self.propagate(block)

    def _estimate_at(self, stamp_ns: int, block: ImuBlock | None = None) -> Estimate | None:
        filter_, knowledge = self._filter, self._known
        if filter_ is None or knowledge is None or self._is_polar:
            return None
        if not is_published(knowledge, filter_.consistency, is_first=self._estimate is None):
            return None
        C_nb, covariance = knowledge.C_nb, knowledge.covariance
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
            witness=self._witness,
            latitude=published_latitude(self._own_latitude()),
        )

    def _carry(self, filter_: AidedFilter, C_nb: Array, block: ImuBlock) -> tuple[Array, float]:
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
