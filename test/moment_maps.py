"""Conditionally linear maps, covariances and all moment rules."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import pytest

from sins_align.odo.moments import (
    Cubature,
    FullGaussHermite,
    Linearised,
    MomentRule,
    Moments,
    ReducedGaussHermite,
    Unscented,
)
from sins_align.types import Array

# Errors are counted in units of the quantities' own sigmas.
ROUNDING = 1e-12
# Unscented's points are alpha = 1e-3 apart, Linearised's differences a step of 1e-4 rad.
DIFFERENCED = 1e-8
DEGREE = math.radians(1.0)
SIGMA_POINTS = [Cubature(), Unscented(), Unscented(alpha=0.7, beta=1.5, kappa=2.0)]
GAUSS_HERMITE = [
    ReducedGaussHermite(2),
    ReducedGaussHermite(),
    ReducedGaussHermite(7),
    FullGaussHermite(2),
    FullGaussHermite(),
]
RULES: list[MomentRule] = [*GAUSS_HERMITE, *SIGMA_POINTS, Linearised()]
every_rule = pytest.mark.parametrize("rule", RULES, ids=str)


@dataclass(frozen=True)
class Trigonometric:
    """F(U) = F[0] + F[1] sin U + F[2] cos U, g the same: F (3, k, n), g (3, k)."""

    F: Array
    g: Array

    def at(self, angle: Array) -> tuple[Array, Array]:
        terms = np.stack((np.ones_like(angle), np.sin(angle), np.cos(angle)), axis=1)
        return np.einsum("mt,tkn->mkn", terms, self.F), terms @ self.g

    def by_angle(self, angle: float) -> tuple[Array, Array]:
        """dF/dU (k, n), dg/dU (k,)."""
        terms = np.array([0.0, math.cos(angle), -math.sin(angle)])
        return np.einsum("t,tkn->kn", terms, self.F), terms @ self.g


@dataclass(frozen=True)
class Constant:
    """y = F x + g, of one F (k, n) and g (k,), which are read-only."""

    F: Array
    g: Array

    def at(self, angle: Array) -> tuple[Array, Array]:
        many = (angle.size,)
        return np.broadcast_to(self.F, many + self.F.shape), np.broadcast_to(
            self.g, many + self.g.shape
        )


def random_map(rng: np.random.Generator, k: int, n: int) -> Trigonometric:
    return Trigonometric(rng.normal(size=(3, k, n)), rng.normal(size=(3, k)))


def random_covariance(rng: np.random.Generator, n: int, rank: int | None = None) -> Array:
    """(n, n) of unit variances."""
    S = rng.normal(size=(n, n if rank is None else rank))
    S /= np.linalg.norm(S, axis=1)[:, None]
    return frozen(S @ S.T)


def frozen(array: Array) -> Array:
    array.setflags(write=False)
    return array


def tolerance(rule: MomentRule) -> float:
    return DIFFERENCED if isinstance(rule, Unscented | Linearised) else ROUNDING


def assert_close(got: Moments, wanted: Moments, P: Array, atol: float) -> None:
    """Moments of y that is about 1; cross per sigma of x."""
    sigma = np.sqrt(P.diagonal())[:, None]
    np.testing.assert_allclose(got.mean, wanted.mean, rtol=0.0, atol=atol)
    np.testing.assert_allclose(got.covariance, wanted.covariance, rtol=0.0, atol=atol)
    assert (np.abs(got.cross - wanted.cross) <= atol * sigma).all()
