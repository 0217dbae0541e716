"""What `odo_align` gives out of a filter's knowledge, and why not before."""

from __future__ import annotations

import math

from sins_align.odo.knowledge import Knowledge
from sins_align.reasons import (
    AT_POLE,
    HEADING_COARSE,
    HEADING_UNOBSERVABLE,
    INCONSISTENT,
    UNOBSERVABLE_HERE,
    Finding,
)
from sins_align.types import LatitudeEstimate

# A heading less certain than this is not published.
PUBLISH_SIGMA = math.radians(3.0)
# Nor is a first one whose innovations say that sigma is not true.
PUBLISH_CONSISTENCY = 2.0
# A latitude less certain than this is not given out [rad].
LATITUDE_SIGMA = math.radians(2.0)
# Nearer to a pole the Earth's rate is vertical, and no gyro of a vehicle finds north.
LEAST_COS_LATITUDE = 0.02

TURN_MOTION = "drive a circle, or turn by 90 deg or more"


def is_polar(latitude: float) -> bool:
    """Whether no heading is ever published at this latitude [rad]."""
    return math.cos(latitude) < LEAST_COS_LATITUDE


def why_not_here(limit: float) -> Finding:
    """Why not where it `is_polar`; limit : see `limits.heading_limit` [rad]."""
    if math.isnan(limit):
        return AT_POLE()
    return UNOBSERVABLE_HERE(limit_deg=math.degrees(limit))


def is_published(knowledge: Knowledge, consistency: float, is_first: bool) -> bool:
    """Whether heading deserves the name; is_first : none has been published yet."""
    if not knowledge.covariance[2, 2] < PUBLISH_SIGMA**2:
        return False
    return not is_first or consistency <= PUBLISH_CONSISTENCY


def published_latitude(own: LatitudeEstimate | None) -> LatitudeEstimate | None:
    """The latitude that the data tell, None where they do not tell it well enough."""
    return own if own is not None and own.sigma < LATITUDE_SIGMA else None


def why_not_published(
    knowledge: Knowledge, consistency: float, limit: float
) -> tuple[Finding, ...]:
    """Why the heading of a filter is not published yet; limit : as in `why_not_here`."""
    sigma = math.degrees(math.sqrt(max(float(knowledge.covariance[2, 2]), 0.0)))
    bound = math.degrees(PUBLISH_SIGMA)
    coarse = HEADING_COARSE(sigma=f"sigma {sigma:.0f} deg, not below {bound:.0f}")
    if consistency > PUBLISH_CONSISTENCY:
        return coarse, INCONSISTENT(ratio=consistency)
    if limit > PUBLISH_SIGMA:
        text = f"{math.degrees(limit):.1f} deg"
        return coarse, HEADING_UNOBSERVABLE(limit=text, motion=TURN_MOTION)
    return (coarse,)
