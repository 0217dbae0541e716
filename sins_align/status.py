"""When the alignment is complete, and why it is not yet."""

from __future__ import annotations

import math
from typing import NamedTuple

from sins_align.config import Completion
from sins_align.rotation import dcm_from_quaternion
from sins_align.types import Advance, Estimate, State, Status
from sins_align.units import ARCMIN, ARCSEC

# From here on the levels and heading are small-angle quantities.
FINE_HEADING_SIGMA = 0.035  # [rad], 2 deg
POLE_REMEDY = "there is no heading at the pole: check latitude_deg"


# Mean normalised innovation squared over its expectation: beyond this a sigma is not believed.
MAX_CONSISTENCY = 2.0
# Two estimates from the same data may differ by less than independent ones would: normalised square
# of the difference over its expectation for such.
MAX_DISAGREEMENT = 1.0
# A bias so many sigma beyond the declared one is no bias: the vehicle moves, or the grade lies.
MAX_BIAS_RATIO = 5.0


class Declared(NamedTuple):
    """What is declared of the sensors, 1 sigma; 0: not estimated, or not declared.

    gyro_bias [rad/s], drift included; accel_bias [m/s^2], with the scale errors that gravity
    turns into one; odometer_scale [1]
    """

    gyro_bias: float = 0.0
    accel_bias: float = 0.0
    odometer_scale: float = 0.0


class Completer:
    """Watches sigma against the thresholds; aligned when below for hold_s.

    Parameters
    ----------
    completion : thresholds and time to hold
    level_limit : what the declared accelerometers allow for the levels [rad]
    declared : estimates far beyond it are not believed
    remedy : what helps where the data are not what the settings say
    """

    def __init__(
        self,
        completion: Completion,
        level_limit: float = 0.0,
        declared: Declared = Declared(),  # noqa: B008 - immutable
        remedy: str = "",
    ) -> None:
        self._completion = completion
        self._level_limit = level_limit
        self._remedy = remedy
        self._declared = declared
        self._below_since_s: float | None = None
        self._aligned_at_s: float | None = None

    def update(self, step: Advance, elapsed_s: float, limit: float, begin_reason: str) -> Status:
        """Status after a step of the aligner.

        Parameters
        ----------
        step : what the aligner says
        elapsed_s : time from the first sample [s]
        limit : what the declared gyro and the latitude allow for heading [rad]
        begin_reason : why the alignment began anew, empty at the first start
        """
        estimate = step.estimate
        if estimate is None:
            self._below_since_s = self._aligned_at_s = None
            reason = step.reason or f"collecting data for the coarse attitude ({elapsed_s:.0f} s)"
            if begin_reason:
                reason += f"; began anew: {begin_reason}"
            remedy = step.remedy or self._heading_remedy(limit)
            return Status(State.COARSE, reason, remedy, elapsed_s, None, limit)
        missing, remedy = self._missing(estimate, limit)
        if missing:
            self._below_since_s = self._aligned_at_s = None
        elif self._below_since_s is None:
            self._below_since_s = elapsed_s
        held = 0.0 if self._below_since_s is None else elapsed_s - self._below_since_s
        if not missing and held >= self._completion.hold_s:
            if self._aligned_at_s is None:
                self._aligned_at_s = elapsed_s
            return Status(State.ALIGNED, "", "", elapsed_s, self._aligned_at_s, limit)
        fine = estimate.misalignment_covariance[2, 2] < FINE_HEADING_SIGMA**2
        state = State.FINE if fine else State.COARSE
        if not missing:
            missing = f"below the thresholds for {held:.0f} of {self._completion.hold_s:g} s"
        missing = "; ".join(filter(None, (missing, step.reason)))
        remedy = "; ".join(filter(None, (remedy, step.remedy)))
        return Status(state, missing, remedy, elapsed_s, None, limit)

    def _missing(self, estimate: Estimate, limit: float) -> tuple[str, str]:
        """What is not below its threshold, and what helps; written so that NaN is not."""
        east, north, heading = estimate.sigma.tolist()
        missing, remedies = [], []
        if not heading < self._completion.heading_threshold:
            threshold = self._completion.heading_threshold / ARCMIN
            missing.append(f"heading sigma {heading / ARCMIN:.2f}' not below {threshold:g}'")
            remedies.append(self._heading_remedy(limit))
        level_threshold = self._completion.level_threshold
        if not (east < level_threshold and north < level_threshold):
            level, threshold = max(east, north) / ARCSEC, level_threshold / ARCSEC
            missing.append(f'level sigma {level:.1f}" not below {threshold:g}"')
            remedies.append(self._level_remedy())
        doubts = self._doubts(estimate)
        if doubts:
            missing += doubts
            remedies.append(self._remedy)
        return "; ".join(missing), "; ".join(dict.fromkeys(filter(None, remedies)))

    def _doubts(self, estimate: Estimate) -> list[str]:
        """Why sigma is not to be believed."""
        doubts = []
        if estimate.consistency > MAX_CONSISTENCY:
            doubts.append(
                f"the innovations are {estimate.consistency:.1f} times what they should be"
            )
        witness = estimate.witness
        if witness is not None and not witness.square <= MAX_DISAGREEMENT:
            heading, ratio = abs(float(witness.phi[2])) / ARCMIN, math.sqrt(witness.square)
            doubts.append(
                f"{witness.name} beside it differs by {heading:.1f}' in heading, in all by"
                f" {ratio:.1f} of the sigma of both"
            )
        for what, found, declared in self._beyond(estimate):
            if declared > 0.0 and found > MAX_BIAS_RATIO * declared:
                ratio = found / declared
                doubts.append(f"the estimated {what} is {ratio:.1f} times what is declared")
        return doubts

    def _beyond(self, estimate: Estimate) -> list[tuple[str, float, float]]:
        """Estimates and what is declared of them, 1 sigma."""
        declared = self._declared
        found = [("gyro bias", max(map(abs, estimate.gyro_bias.tolist())), declared.gyro_bias)]
        if declared.accel_bias > 0.0:
            # Along up, it also stands for a height that is wrong.
            up = dcm_from_quaternion(estimate.q_nb)[2]
            level = estimate.accel_bias - (estimate.accel_bias @ up) * up
            found.append(("accelerometer bias", math.hypot(*level), declared.accel_bias))
        if estimate.odometer is not None:
            scale = abs(estimate.odometer.scale_error)
            found.append(("odometer scale error", scale, declared.odometer_scale))
        return found

    def _heading_remedy(self, limit: float) -> str:
        if math.isnan(limit):
            return POLE_REMEDY
        if limit < self._completion.heading_threshold:
            return ""
        return (
            f"the declared gyro bias allows {limit / ARCMIN:.2f}' at this latitude: raise"
            " heading_threshold_arcmin, turn by 90 deg, or use a better gyro"
        )

    def _level_remedy(self) -> str:
        if self._level_limit < self._completion.level_threshold:
            return ""
        return (
            f'the declared accelerometer bias allows {self._level_limit / ARCSEC:.1f}" on a'
            " base that does not tilt: raise level_threshold_arcsec, or use better accelerometers"
        )
