"""When heading will be known: the filter's covariance, propagated ahead under the motion so far.

The covariance does not depend on what is measured, only on the motion; epochs of the last minute
stand for what is to come. In inertial space the base turns with the Earth meanwhile.
"""

from __future__ import annotations

import math
from collections.abc import Callable

from sins_align.earth import earth_rate_n
from sins_align.swing.epochs import Epochs
from sins_align.swing.two_stage import GravityModel, Linearisation, NoiseModel, build_steps
from sins_align.swing.two_stage_filter import TwoStageFilter

HORIZON_S = 3600.0
# Heading is looked at so many epochs ahead, and then as much later every time.
FIRST_LOOK, LATER = 20, 1.2


def time_to(
    threshold: float,
    filter_: TwoStageFilter,
    epochs: Epochs,
    about: Linearisation,
    gravity: GravityModel,
    noise: NoiseModel,
    heading_sigma: Callable[[TwoStageFilter], float],
) -> float:
    """Time from the last epoch until heading is below a threshold [s]; inf: not in an hour.

    Parameters
    ----------
    threshold : 1 sigma [rad]
    filter_ : at the last epoch; not changed
    about : what it is linearised about
    heading_sigma : of a filter [rad]
    """
    w_ie_b0 = about.R @ earth_rate_n(gravity.latitude)
    ahead, passed, look = filter_.copy(), 0, FIRST_LOOK
    now_s = float(epochs.time_s[-1])
    before = (0.0, heading_sigma(ahead))
    while before[0] < HORIZON_S:
        future = epochs.continued(passed + look, w_ie_b0)
        steps = build_steps(future, len(epochs) + passed, about, gravity, noise)
        ahead.run(steps, None)
        passed += look
        after = (float(future.time_s[-1]) - now_s, heading_sigma(ahead))
        if after[1] < threshold:
            return _crossing(before, after, threshold, now_s)
        before, look = after, math.ceil((LATER - 1.0) * (len(epochs) + passed))
    return math.inf


def _crossing(
    before: tuple[float, float], after: tuple[float, float], threshold: float, now_s: float
) -> float:
    """Between two (time ahead, sigma): sigma is about a power of the whole time."""
    (t0, s0), (t1, s1) = before, after
    if not s0 > s1:
        return t1
    share = math.log(s0 / threshold) / math.log(s0 / s1)
    return (now_s + t0) * ((now_s + t1) / (now_s + t0)) ** share - now_s
