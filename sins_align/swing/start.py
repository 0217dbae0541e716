"""The attitude that Gauss-Newton starts from."""

from __future__ import annotations

import numpy as np

from sins_align.swing.information import invert_information
from sins_align.swing.solution import X_R, Prior
from sins_align.swing.two_stage import DATA, LEVER, R_EAST, R_UP, V0
from sins_align.types import Array


def start_attitude(normal: Array, prior: Prior) -> Array | None:
    """Closed-form attitude from the sums, from no knowledge at all: R (3, 3).

    Free vectors R_u and R_e, start velocity and lever arm; biases zero, and R_n, whose share
    of gravity is of second order in time, left out. TRIAD then makes them a rotation. None
    where the sums do not determine them.

    normal : (p + 1, p + 1) sums of the filter
    """
    free = np.r_[R_EAST, R_UP, V0, LEVER]
    N = normal[np.ix_(free, free)].copy()
    b = -normal[free, DATA]
    # An exact prior is as good as one of a nanometre here.
    lever = slice(9, 12)
    weight = 1.0 / np.maximum(prior.variance[X_R], 1e-18)
    N[lever, lever] += np.diag(weight)
    b[lever] += weight * prior.mean[X_R]
    try:
        solution = invert_information(N) @ b
    except np.linalg.LinAlgError:
        return None
    east, up = solution[0:3], solution[3:6]
    up = up / np.linalg.norm(up)
    east = east - up * (up @ east)
    east = east / np.linalg.norm(east)
    return np.column_stack((east, np.cross(up, east), up))
