"""How the filter of the coarse alignment goes from one epoch to the next."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from sins_align.types import Array

UNIT = np.eye(3)


@lru_cache(maxsize=16)
def transition(T: float, accel: float, tilt: float) -> tuple[Array, Array]:
    """Transition of position, velocity, acceleration over T, and what is added: (9, 9) each.

    accel, tilt : densities of white noise of the acceleration [m/s/sqrt(s)] and of its rate
        [m/s^2/sqrt(s)]
    """
    F = np.array([[1.0, T, T**2 / 2.0], [0.0, 1.0, T], [0.0, 0.0, 1.0]])
    of_accel = np.array([[T**3 / 3.0, T**2 / 2.0, 0.0], [T**2 / 2.0, T, 0.0], [0.0, 0.0, 0.0]])
    of_tilt = np.array(
        [
            [T**5 / 20.0, T**4 / 8.0, T**3 / 6.0],
            [T**4 / 8.0, T**3 / 3.0, T**2 / 2.0],
            [T**3 / 6.0, T**2 / 2.0, T],
        ]
    )
    Q = accel**2 * of_accel + tilt**2 * of_tilt
    return np.kron(F, UNIT).astype(np.float64), np.kron(Q, UNIT).astype(np.float64)
