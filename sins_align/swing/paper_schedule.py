"""When the closed loop of Mu and Fang, Fig. 2, acts."""

from __future__ import annotations

import enum
import math

from sins_align.config import PaperConfig

# Level corrections, in parts of the level phase: 10, 20, 40, 80 and 120 s of the paper's 120 s.
_LEVEL_PARTS = (1.0 / 12.0, 1.0 / 6.0, 1.0 / 3.0, 2.0 / 3.0, 1.0)
_LEVER_UPDATE_S = 30.0


class Event(enum.Enum):
    """What is fed back."""

    LEVEL = "level misalignment of the least squares into the attitude"
    FINE = "end of the level phase: the filter begins"
    LEVER = "lever arm of the least squares into the navigation"
    SWITCH = "the filter's state into attitude and velocity; the least squares begin anew"


def events(config: PaperConfig, begin_s: float, end_s: float) -> list[Event]:
    """What is due in (begin_s, end_s], in the order in which it is to be done.

    Times count from the first sample [s]. Several events of one kind in the interval are one.
    """

    def due(time_s: float) -> bool:
        return begin_s < time_s <= end_s

    level_s = config.level_phase_s
    found = []
    if any(due(part * level_s) for part in _LEVEL_PARTS):
        found.append(Event.LEVEL)
    if due(level_s):
        found.append(Event.FINE)
    updates = [math.floor((time_s - level_s) / _LEVER_UPDATE_S) for time_s in (begin_s, end_s)]
    if updates[1] > max(updates[0], 0):
        found.append(Event.LEVER)
    if any(due(level_s + switch_s) for switch_s in config.switch_times_s):
        found.append(Event.SWITCH)
    return found
