"""The truth file beside a simulated bag, and the error of an estimate against it."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import NamedTuple

import numpy as np

from sins_align.grades import ConfigError
from sins_align.types import Array

_SAME_TIME_NS = 1_000  # what a swing turns in a microsecond is below all that is printed


class Truth(NamedTuple):
    """Attitude (4,) at a time [ns], and the lever arm (3,) [m] where there is one."""

    stamp_ns: int
    q_nb: Array
    lever_arm: Array | None

    def is_at(self, stamp_ns: int) -> bool:
        """True where the attitude is that of `stamp_ns`."""
        return abs(self.stamp_ns - stamp_ns) <= _SAME_TIME_NS


def read_truth(path: Path) -> Truth:
    """The content of a truth.json.

    Raises
    ------
    ConfigError : no such file, or not a truth file; names the file
    """
    try:
        document = json.loads(path.read_text(encoding="utf-8"))
        q_nb = np.array(document["q_nb_wxyz"], dtype=float)
        stamp_ns = int(document["stamp_ns"])
        given = document.get("lever_arm_m")
        lever_arm = None if given is None else np.array(given, dtype=float)
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read: {error.strerror}") from None
    except (ValueError, KeyError, TypeError, AttributeError):
        raise ConfigError(f"{path}: not a truth file (truth.json of align_simulate)") from None
    right = q_nb.shape == (4,) and (lever_arm is None or lever_arm.shape == (3,))
    if not right or not math.isclose(float(q_nb @ q_nb), 1.0, abs_tol=1e-6):
        raise ConfigError(f"{path}: not a truth file (q_nb_wxyz is no unit quaternion)")
    return Truth(stamp_ns, q_nb, lever_arm)
