"""A covariance given one component, and its root with that component first."""

from __future__ import annotations

import math

import numpy as np

from sins_align.types import Array

# A correlation matrix with a lower eigenvalue than this is wrong, and not just rounded.
LEAST_EIGENVALUE = -1e-6


def check_variances(P: Array) -> None:
    """Refuse a covariance with a negative variance, or none.

    Raises
    ------
    LinAlgError : a variance is negative or not a number
    """
    if not (P.diagonal() >= 0.0).all():
        raise np.linalg.LinAlgError("a variance is negative or not a number")


def condition(P: Array, index: int) -> tuple[Array, Array]:
    """s (n,) and rest (n, n): the part of P that goes with the angle, and what is left.

    A known angle has no part: s = 0.
    """
    check_variances(P)
    variance = float(P[index, index])
    s = P[:, index] / math.sqrt(variance) if variance > 0.0 else np.zeros(P.shape[0])
    return s, P - np.multiply.outer(s, s)


def root(P: Array, index: int) -> Array:
    """S (n, n) with S S' = P, its first column s, and no other has a part in the angle.

    P is scaled to correlations first: with variances from 1e-20 to 1e4 what is rounding to
    one state is all of another. A P that is only semidefinite (a known state, a constraint),
    or that rounding made indefinite, has no Cholesky factor. Then the root comes from the
    eigenvectors, less the negative eigenvalues: that changes P by what it was wrong, whereas
    a jitter large enough for Cholesky adds noise to every state.

    Raises
    ------
    LinAlgError : P is not semidefinite, by more than rounding
    """
    s, rest = condition(P, index)
    others = np.delete(np.arange(s.size), index)
    sigma = np.sqrt(P.diagonal()[others])
    scale = np.divide(1.0, sigma, out=np.zeros_like(sigma), where=sigma > 0.0)
    correlation = rest[np.ix_(others, others)] * np.multiply.outer(scale, scale)
    S = np.zeros_like(rest)
    S[:, 0] = s
    S[others, 1:] = sigma[:, None] * _correlation_root(correlation)
    return S


def _correlation_root(correlation: Array) -> Array:
    try:
        return np.linalg.cholesky(correlation)
    except np.linalg.LinAlgError:
        values, vectors = np.linalg.eigh(correlation)
        if not values[0] >= LEAST_EIGENVALUE:
            raise np.linalg.LinAlgError("the covariance is not semidefinite") from None
        return vectors * np.sqrt(np.maximum(values, 0.0))
