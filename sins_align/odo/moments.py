"""Mean and covariance of a map that is linear in all states but one, an angle.

    y = F(U) x + g(U),  U = x[index],  x ~ N(mean, P)

is the error model of an alignment whose azimuth alone is large (Wu, Tang and Huang, eqs. (21)
and (22)): F and g hold the sines and cosines of U. Predictions and innovations of a Gaussian
filter are the moments of such maps, and the rules for them are what its variants differ in.

All of them split x in the same way. With s = P[:, index] / sigma_U,

    x = mean + s u + L w,  u ~ N(0, 1),  w ~ N(0, I),  L L' = P - s s'

the angle is U = mean[index] + sigma_U u and does not depend on w, so that y is linear in w.
This is the paper's Cholesky factor S = [s, L] with the angle as the first state. Where a rule
needs L any square root does: turning the other states changes nothing.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np

from sins_align.odo.conditioning import check_variances, condition, root
from sins_align.odo.gauss_hermite import gauss_hermite
from sins_align.types import Array


class ConditionallyLinear(Protocol):
    """A map y = F(U) x + g(U)."""

    def at(self, angle: Array) -> tuple[Array, Array]:
        """F and g for many angles at once.

        Parameters
        ----------
        angle : (m,) values of U [rad], not wrapped

        Returns
        -------
        F : (m, k, n), g : (m, k); new arrays, which belong to the caller
        """
        ...


class Moments(NamedTuple):
    """Moments of y and x, without any noise added.

    mean : (k,) of y
    covariance : (k, k) of y, exactly symmetric
    cross : (n, k) E[(x - E x) (y - E y)']
    """

    mean: Array
    covariance: Array
    cross: Array


class MomentRule(Protocol):
    """A way to compute the moments of a map."""

    def __call__(self, map_: ConditionallyLinear, mean: Array, P: Array, index: int) -> Moments:
        """Moments of y = F(U) x + g(U).

        Parameters
        ----------
        map_ : F and g
        mean : (n,) of x
        P : (n, n) covariance of x, symmetric; may be semidefinite
        index : of U in x

        Raises
        ------
        LinAlgError : a variance is negative or not a number
        """
        ...


@dataclass(frozen=True)
class ReducedGaussHermite:
    """Gauss-Hermite over the angle alone, exact in all that depends on it linearly.

    Wu, Tang and Huang, eqs. (40) to (57), without the Cholesky factor. With the nodes u_i and
    weights W_i of one dimension, rest = P - s s', F_i = F(U_i), g_i = g(U_i),

        theta_i = mean + s u_i                                    (46), (54)
        eta_i = F_i theta_i + g_i                                 (45), (52)
        E y = sum W_i eta_i                                       (40), (42)
        d_i = eta_i - E y
        P_yy = sum W_i (d_i d_i' + F_i rest F_i')                 (41), (43), (47), (51)
        P_xy = sum W_i (s u_i d_i' + rest F_i')                   (44), (53)

    The paper takes second moments about zero and then subtracts the outer products of the
    means: in (41) and (43) those have to be the means of y, not of x. In (44) the products
    are with H' and h', and (51) lacks the last transpose, of H S; steps 3 and 6 lack W_i. About the
    mean, as here, no digits are lost. Its S diag(0, I) S' is `rest`.

    Parameters
    ----------
    order : nodes; 3 are enough for an azimuth error of some degrees

    Raises
    ------
    ValueError : order is less than 2, where the angle's own variance would be lost
    """

    order: int = 3

    def __post_init__(self) -> None:
        _check_order(self.order)

    def __call__(self, map_: ConditionallyLinear, mean: Array, P: Array, index: int) -> Moments:
        """Moments of y, see `MomentRule`."""
        nodes, W = gauss_hermite(self.order)
        s, rest = condition(P, index)
        F, e, origin = _deviations(map_, mean, nodes * s, index)
        m, k, n = F.shape
        shift = W @ e
        d = e - shift
        Wd = W[:, None] * d
        # W_i F_i rest of all nodes in one product, and then the sum over i in another.
        F_rest = (W[:, None] * F.reshape(m, k * n)).reshape(m * k, n) @ rest
        left = F_rest.reshape(m, k, n).transpose(1, 0, 2).reshape(k, m * n)
        right = F.transpose(1, 0, 2).reshape(k, m * n)
        covariance = left @ right.T + Wd.T @ d
        cross = F_rest.reshape(m, k, n).sum(axis=0).T + np.outer(s, nodes[:, 0] @ Wd)
        return Moments(origin + shift, _symmetric(covariance), cross)


@dataclass(frozen=True)
class FullGaussHermite:
    """Gauss-Hermite over all n states, with order^n nodes: for small n.

    Wu, Tang and Huang, eqs. (3), (5) to (9), the factor S with the angle first; in (9) the
    first factor is of the states themselves, not f of them. Equal to `ReducedGaussHermite` of
    the same order, and there to show that it is.

    Raises
    ------
    ValueError : order is less than 2, or the nodes are too many
    """

    order: int = 3

    def __post_init__(self) -> None:
        _check_order(self.order)

    def __call__(self, map_: ConditionallyLinear, mean: Array, P: Array, index: int) -> Moments:
        """Moments of y, see `MomentRule`."""
        nodes, W = gauss_hermite(self.order, mean.size)
        return _weighted_moments(map_, mean, nodes @ root(P, index).T, W, index)


@dataclass(frozen=True)
class Cubature:
    """The spherical-radial rule of third degree: 2n points mean +- sqrt(n) S_j, weights 1/2n.

    Arasaratnam and Haykin, 2009. The column of the angle takes it sqrt(n) sigma_U to either
    side; in all other points it stays at its mean.
    """

    def __call__(self, map_: ConditionallyLinear, mean: Array, P: Array, index: int) -> Moments:
        """Moments of y, see `MomentRule`."""
        n = mean.size
        steps = math.sqrt(n) * root(P, index).T
        weights = np.full(2 * n, 0.5 / n)
        return _weighted_moments(map_, mean, np.concatenate((steps, -steps)), weights, index)


@dataclass(frozen=True)
class Unscented:
    """The scaled unscented transformation: the mean and mean +- sqrt(c) S_j.

    Wan and van der Merwe, 2000, with c = n + lambda = alpha^2 (n + kappa): weights 1/2c, in
    the middle 1 - n/c, and for the covariance 2 - n/c - alpha^2 + beta.

    Parameters
    ----------
    alpha : spread of the points; beta : 2 for Gaussian states; kappa : second scaling

    Raises
    ------
    ValueError : alpha is not positive, or n + kappa is not
    """

    alpha: float = 1e-3
    beta: float = 2.0
    kappa: float = 0.0

    def __post_init__(self) -> None:
        if not self.alpha > 0.0:
            raise ValueError(f"alpha must be positive, not {self.alpha}")

    def __call__(self, map_: ConditionallyLinear, mean: Array, P: Array, index: int) -> Moments:
        """Moments of y, see `MomentRule`."""
        n = mean.size
        c = self.alpha**2 * (n + self.kappa)
        if not c > 0.0:
            raise ValueError(f"n + kappa must be positive, not {n + self.kappa}")
        steps = math.sqrt(c) * root(P, index).T
        offsets = np.concatenate((np.zeros((1, n)), steps, -steps))
        _, e, origin = _deviations(map_, mean, offsets, index)
        # A small alpha makes the middle weights about -1/alpha^2, against which all others
        # would cancel. With e_i = y_i - y_0 and d = sum W_i e_i over i > 0 the same sums are
        #     E y = y_0 + d,  P_yy = sum W_i e_i e_i' + (beta - alpha^2) d d'
        # and the middle weights do not appear.
        W, e = 0.5 / c, e[1:]
        d = W * e.sum(axis=0)
        covariance = W * (e.T @ e) + (self.beta - self.alpha**2) * np.outer(d, d)
        return Moments(origin + d, _symmetric(covariance), W * (offsets[1:].T @ e))


@dataclass(frozen=True)
class Linearised:
    """The extended Kalman filter: the map's Jacobian at the mean.

        J = F(U) + d(F(U) mean + g(U))/dU e_index',  P_yy = J P J',  P_xy = P J'

    Parameters
    ----------
    step : of the central difference by U [rad]; its error is step^2 / 6 of a third
        derivative, and one rounding over the step

    Raises
    ------
    ValueError : step is not positive
    """

    step: float = 1e-4

    def __post_init__(self) -> None:
        if not self.step > 0.0:
            raise ValueError(f"the step must be positive, not {self.step}")

    def __call__(self, map_: ConditionallyLinear, mean: Array, P: Array, index: int) -> Moments:
        """Moments of y, see `MomentRule`."""
        check_variances(P)
        F, g = map_.at(mean[index] + np.array([0.0, self.step, -self.step]))
        y = F @ mean + g
        J = F[0].copy()
        J[:, index] += (y[1] - y[2]) / (2.0 * self.step)
        cross = P @ J.T
        return Moments(y[0], _symmetric(J @ cross), cross)


def _check_order(order: int) -> None:
    if order < 2:
        raise ValueError(f"the moments need an order of 2 or more, not {order}")


def _symmetric(A: Array) -> Array:
    return 0.5 * (A + A.T)


def _deviations(
    map_: ConditionallyLinear, mean: Array, offsets: Array, index: int
) -> tuple[Array, Array, Array]:
    """y at the points mean + offsets, as origin + e.

    origin = F_0 mean + g_0, e_i = F_i offsets_i + (F_i - F_0) mean + (g_i - g_0): small where
    the offsets are, however large mean and g.

    Returns
    -------
    F : (m, k, n), e : (m, k), origin : (k,)
    """
    F, g = map_.at(mean[index] + offsets[:, index])
    y = g + F @ mean if mean.any() else g
    e = (F @ offsets[:, :, None])[:, :, 0] + (y - y[0])
    return F, e, y[0]


def _weighted_moments(
    map_: ConditionallyLinear, mean: Array, offsets: Array, weights: Array, index: int
) -> Moments:
    """Moments from points mean + offsets (m, n) with weights (m,) of sum 1."""
    _, e, origin = _deviations(map_, mean, offsets, index)
    shift = weights @ e
    d = e - shift
    Wd = weights[:, None] * d
    return Moments(origin + shift, _symmetric(Wd.T @ d), offsets.T @ Wd)
