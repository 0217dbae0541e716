"""When the alignment is complete, and why it is not yet."""

from __future__ import annotations

import math

from sins_align.config import Completion
from sins_align.types import Advance, Estimate, State, Status
from sins_align.units import ARCMIN, ARCSEC

# From here on the levels and heading are small-angle quantities.
FINE_HEADING_SIGMA = 0.035  # [rad], 2 deg
POLE_REMEDY = "there is no heading at the pole: check latitude_deg"


# Mean normalised innovation squared over its expectation: beyond this a sigma is not believed.
MAX_CONSISTENCY = 2.0
# A bias so many sigma beyond the declared one is no bias: the vehicle moves, or the grade lies.
MAX_BIAS_RATIO = 5.0


class Completer:
    """Watches sigma against the thresholds; aligned when below for hold_s.

    Parameters
    ----------
    completion : thresholds and time to hold
    level_limit : what the declared accelerometers allow for the levels [rad]
    gyro_bias_sigma : declared, drift included [rad/s]; 0 where none is estimated
    remedy : what helps where the data are not what the settings say
    """

    def __init__(
        self,
        completion: Completion,
        level_limit: float = 0.0,
        gyro_bias_sigma: float = 0.0,
        remedy: str = "",
    ) -> None:
        self._completion = completion
        self._level_limit = level_limit
        self._remedy = remedy
        self._gyro_bias_sigma = gyro_bias_sigma
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
        if estimate.consistency > MAX_CONSISTENCY:
            missing.append(
                f"the innovations are {estimate.consistency:.1f} times what they should be"
            )
            remedies.append(self._remedy)
        bias = max(map(abs, estimate.gyro_bias.tolist()))
        if self._gyro_bias_sigma > 0.0 and bias > MAX_BIAS_RATIO * self._gyro_bias_sigma:
            ratio = bias / self._gyro_bias_sigma
            missing.append(f"the estimated gyro bias is {ratio:.1f} times what is declared")
            remedies.append(self._remedy)
        return "; ".join(missing), "; ".join(dict.fromkeys(filter(None, remedies)))

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
