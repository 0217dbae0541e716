"""From an information matrix to the covariance."""

from __future__ import annotations

import numpy as np
from scipy.linalg.lapack import dpotrf, dpotri

from sins_align.types import Array


def invert_information(N: Array) -> Array:
    """Inverse of a positive definite matrix (m, m), by Cholesky after scaling to a unit diagonal.

    Scaled, because angles, biases and metres differ by ten orders of magnitude.

    Raises
    ------
    numpy.linalg.LinAlgError : not positive definite
    """
    scale = 1.0 / np.sqrt(N.diagonal())
    factor, info = dpotrf(N * scale[:, None] * scale, lower=1)
    if info != 0:
        raise np.linalg.LinAlgError("the data do not determine the parameters")
    inverse, _ = dpotri(factor, lower=1, overwrite_c=1)
    lower = np.tril(inverse) + np.tril(inverse, -1).T
    return lower * scale[:, None] * scale
