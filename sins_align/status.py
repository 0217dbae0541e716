"""When the alignment is complete, and why it is not yet."""

from __future__ import annotations

from sins_align.config import Completion
from sins_align.types import Estimate, State, Status
from sins_align.units import ARCMIN, ARCSEC

# From here on the levels and heading are small-angle quantities.
FINE_HEADING_SIGMA = 0.035  # [rad], 2 deg


class Completer:
    """Watches sigma against the thresholds; aligned when below for hold_s."""

    def __init__(self, completion: Completion) -> None:
        self._completion = completion
        self._below_since_s: float | None = None
        self._aligned_at_s: float | None = None

    def update(
        self, estimate: Estimate | None, elapsed_s: float, limit: float, begin_reason: str
    ) -> Status:
        """Status after a block.

        Parameters
        ----------
        estimate : None before the coarse attitude exists
        elapsed_s : time from the first sample [s]
        limit : what the declared gyro and the latitude allow for heading [rad]
        begin_reason : why the alignment began anew, empty at the first start
        """
        if estimate is None:
            self._below_since_s = None
            reason = f"collecting data for the coarse attitude ({elapsed_s:.0f} s)"
            if begin_reason:
                reason += f"; began anew: {begin_reason}"
            return Status(State.COARSE, reason, "", elapsed_s, None, limit)
        missing, remedy = self._missing(estimate, limit)
        if missing:
            self._below_since_s = None
            self._aligned_at_s = None
        elif self._below_since_s is None:
            self._below_since_s = elapsed_s
        held = 0.0 if self._below_since_s is None else elapsed_s - self._below_since_s
        if not missing and held >= self._completion.hold_s:
            if self._aligned_at_s is None:
                self._aligned_at_s = elapsed_s
            return Status(State.ALIGNED, "", "", elapsed_s, self._aligned_at_s, limit)
        fine = float(estimate.sigma[2]) < FINE_HEADING_SIGMA
        state = State.FINE if fine else State.COARSE
        if not missing:
            missing = f"below the thresholds for {held:.0f} of {self._completion.hold_s:g} s"
        return Status(state, missing, remedy, elapsed_s, None, limit)

    def _missing(self, estimate: Estimate, limit: float) -> tuple[str, str]:
        east, north, heading = (float(s) for s in estimate.sigma)
        missing = []
        remedy = ""
        if heading >= self._completion.heading_threshold:
            threshold = self._completion.heading_threshold / ARCMIN
            missing.append(f"heading sigma {heading / ARCMIN:.2f}' above {threshold:g}'")
            if self._completion.heading_threshold <= limit:
                remedy = (
                    f"the declared gyro bias allows {limit / ARCMIN:.2f}' at this latitude: raise"
                    " heading_threshold_arcmin, turn the base by 90 deg, or use a better gyro"
                )
        level = max(east, north)
        if level >= self._completion.level_threshold:
            threshold = self._completion.level_threshold / ARCSEC
            missing.append(f'level sigma {level / ARCSEC:.1f}" above {threshold:g}"')
        return "; ".join(missing), remedy
