"""The truth file beside a simulated bag, and the error of an estimate against it."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import NamedTuple

import numpy as np

from sins_align.grades import ConfigError
from sins_align.types import Array

# Keys of what may be known, and how many numbers each of them has.
_KNOWN = {
    "lever_arm_m": 3,
    "gyro_bias_rad_s": 3,
    "accel_bias_m_s2": 3,
    "odometer_scale_error": 1,
    "odometer_latency_s": 1,
    "odometer_lever_arm_m": 3,
    "mounting_rpy_deg": 3,
}
_SAME_TIME_NS = 1_000  # what a swing turns in a microsecond is below all that is printed


class Truth(NamedTuple):
    """Attitude (4,) at a time [ns] and what else is known; None where it is not.

    lever_arm [m], gyro_bias [rad/s], accel_bias [m/s^2] : (3,) in body axes
    odometer_scale_error, odometer_latency [s] : (1,)
    odometer_lever_arm [m], mounting_rpy_deg : (3,) in body axes
    """

    stamp_ns: int
    q_nb: Array
    lever_arm: Array | None = None
    gyro_bias: Array | None = None
    accel_bias: Array | None = None
    odometer_scale_error: Array | None = None
    odometer_latency: Array | None = None
    odometer_lever_arm: Array | None = None
    mounting_rpy_deg: Array | None = None

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
        given = [document.get(key) for key in _KNOWN]
        vectors = [None if value is None else np.array(value, float, ndmin=1) for value in given]
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read: {error.strerror}") from None
    except (ValueError, KeyError, TypeError, AttributeError):
        raise ConfigError(f"{path}: not a truth file (truth.json of align_simulate)") from None
    if q_nb.shape != (4,) or not math.isclose(float(q_nb @ q_nb), 1.0, abs_tol=1e-6):
        raise ConfigError(f"{path}: not a truth file (q_nb_wxyz is no unit quaternion)")
    for (key, size), vector in zip(_KNOWN.items(), vectors, strict=True):
        if vector is not None and (vector.shape != (size,) or not np.isfinite(vector).all()):
            what = "a number" if size == 1 else "three numbers"
            raise ConfigError(f"{path}: not a truth file ({key} is not {what})")
    return Truth(stamp_ns, q_nb, *vectors)
