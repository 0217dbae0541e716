"""Guards of a measurement update: implausible innovations, and a scale that jumped."""

from __future__ import annotations

from collections import deque
from typing import NamedTuple

import numpy as np

from sins_align.types import Array

# 99 % of chi-square with three degrees of freedom.
SOFT_LIMIT = 11.3
SOFT_STEPS, SOFT_ENOUGH = 8, 1.2
# The test for a jump of the scale.
JUMP_EPOCHS = 5
JUMP_LEAST_DISTANCE = 1.0  # [m] of an epoch that counts
JUMP_LEAST_RATIO = 30.0
JUMP_GREATEST = 0.2
JUMP_AGREEMENT = 0.5
JUMP_SHARE = 0.7


def soften(S: Array, R: Array, innovation: Array, nis: float) -> Array:
    """(3, 3) S + factor R for an implausible innovation of normalised square `nis`.

    The factor makes the normalised square 11.3^2 / nis: where R dominates it is (nis /
    11.3)^2. An outlier loses its weight, the more the larger it is, but is never shut out: a
    hard gate would lock the filter out once it was wrong. Where the state's own uncertainty S
    dominates, R has to grow by more for the same, or half of the outlier would be believed.
    """
    factor, wanted = (nis / SOFT_LIMIT) ** 2, SOFT_LIMIT**2 / nis
    for _ in range(SOFT_STEPS):
        total = S + factor * R
        ratio = float(innovation @ np.linalg.solve(total, innovation)) / wanted
        if ratio < SOFT_ENOUGH:
            break
        factor *= ratio
    return total


class _Vote(NamedTuple):
    a: float  # h' S^-1 h
    b: float  # h' S^-1 nu
    nis: float


class ScaleJump:
    """Tells a jump of the scale from other causes of large innovations.

    With h = dz/dK, a = h' S^-1 h and b = h' S^-1 nu, the most likely jump of the last epochs
    is delta = sum b / sum a, and twice the logarithm of its likelihood ratio (sum b)^2 / sum
    a. It is believed when it explains most of the innovations and every epoch alone says
    about the same.
    """

    def __init__(self) -> None:
        self._votes: deque[_Vote] = deque(maxlen=JUMP_EPOCHS)

    def test(self, h: Array, S_inverse: Array, innovation: Array, distance: float) -> float | None:
        """The jump that the last epochs tell of, None where there is none.

        Parameters
        ----------
        h : (3,) innovation by the scale error; S_inverse : (3, 3); innovation : (3,)
        distance : travelled in the epoch [m]
        """
        if abs(distance) < JUMP_LEAST_DISTANCE:
            return None
        weighted = S_inverse @ innovation
        self._votes.append(
            _Vote(float(h @ S_inverse @ h), float(h @ weighted), float(innovation @ weighted))
        )
        if len(self._votes) < JUMP_EPOCHS:
            return None
        a = sum(vote.a for vote in self._votes)
        b = sum(vote.b for vote in self._votes)
        nis = sum(vote.nis for vote in self._votes)
        jump, ratio = b / a, b * b / a
        if not (ratio > JUMP_LEAST_RATIO and ratio > JUMP_SHARE * nis):
            return None
        tolerance = JUMP_AGREEMENT * abs(jump)
        agree = all(abs(vote.b / vote.a - jump) <= tolerance for vote in self._votes)
        if abs(jump) < JUMP_GREATEST and agree:
            self._votes.clear()
            return jump
        return None


def inverse3(S: Array) -> Array:
    """Inverse of a symmetric positive matrix (3, 3), by cofactors.

    Raises
    ------
    LinAlgError : it is not positive
    """
    (a, b, c), (_, d, e), (_, _, f) = S.tolist()
    A, B, C = d * f - e * e, c * e - b * f, b * e - c * d
    determinant = a * A + b * B + c * C
    if not determinant > 0.0:
        raise np.linalg.LinAlgError("the innovation's covariance is not positive")
    D, E, F = a * f - c * c, b * c - a * e, a * d - b * b
    return np.array([[A, B, C], [B, D, E], [C, E, F]]) / determinant
