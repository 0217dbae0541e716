"""When an alignment will be complete."""

from __future__ import annotations

import math

import numpy as np

from sins_align.config import Completion
from sins_align.protocols import Aligner
from sins_align.reasons import HEADING_SIGMA, HOLDING, LEVEL_LIMIT, Kind
from sins_align.types import State, Status


def predict_completion(
    aligner: Aligner, status: Status, completion: Completion, held_s: float
) -> float:
    """Predicted time until aligned, as far as heading goes [s]; inf: not within an hour.

    That is until sigma of heading is below its threshold, if the motion goes on as it was,
    and hold_s after that. 0 when aligned, NaN where it cannot be said: nobody knows when a
    doubt will go, or when the rest will come where heading is there.

    Parameters
    ----------
    aligner, status : after the last step
    completion : thresholds and time to hold
    held_s : for how long everything has been as it should be [s]
    """
    if status.state is State.ALIGNED:
        return 0.0
    if status.state is State.FAILED:
        return math.nan
    reasons = [finding.reason for finding in status.findings]
    if LEVEL_LIMIT in reasons or any(reason.kind is Kind.DOUBT for reason in reasons):
        return math.nan
    try:
        ahead = aligner.foresee(completion.heading_threshold)
    except np.linalg.LinAlgError:  # nothing to break a node for
        return math.nan
    if not math.isfinite(ahead):
        return ahead
    if ahead == 0.0:
        if HEADING_SIGMA not in reasons and HOLDING not in reasons:
            return math.nan
        return aligner.next_step(max(completion.hold_s - held_s, 0.0))
    return aligner.next_step(aligner.next_step(ahead) + completion.hold_s)
