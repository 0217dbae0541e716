"""The Gauss-Hermite rule against the exact moments of the normal, and against NumPy's."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from numpy.polynomial.hermite_e import hermegauss

from sins_align.odo.gauss_hermite import MOST_NODES, gauss_hermite

ROUNDING = 1e-15  # a few units in the last place of 1
NODE = 10 * ROUNDING  # of nodes up to 8
MOMENT = 50 * ROUNDING  # of the sum of its terms' magnitudes

ORDERS = range(1, 21)
PRODUCTS = [(1, 3), (2, 2), (3, 2), (6, 2), (2, 3), (4, 3), (3, 5)]  # order, dimension


def normal_moment(degree: int) -> int:
    """E u^degree of the standard normal."""
    return 0 if degree % 2 else math.prod(range(1, degree, 2))


@pytest.mark.parametrize("order", ORDERS)
def test_moments_up_to_twice_the_order_less_one(order: int) -> None:
    nodes, weights = gauss_hermite(order)
    for degree in range(2 * order):
        terms = weights * nodes[:, 0] ** degree
        assert abs(terms.sum() - normal_moment(degree)) <= MOMENT * np.abs(terms).sum()


@pytest.mark.parametrize("order", ORDERS)
def test_the_next_even_moment_lacks_a_factorial(order: int) -> None:
    """The error of Gauss's rule at u^2m is the squared norm of He_m, m!: it is no better rule."""
    nodes, weights = gauss_hermite(order)
    exact = normal_moment(2 * order)
    missing = exact - weights @ nodes[:, 0] ** (2 * order)
    assert missing == pytest.approx(math.factorial(order), abs=MOMENT * exact)


@pytest.mark.parametrize(("order", "dimension"), PRODUCTS)
def test_moments_of_products(order: int, dimension: int) -> None:
    """All monomials of degree 2m - 1 or less in each coordinate."""
    nodes, weights = gauss_hermite(order, dimension)
    assert nodes.shape == (order**dimension, dimension)
    assert weights.shape == (order**dimension,)
    for degrees in itertools.product(range(2 * order), repeat=dimension):
        terms = weights * (nodes ** np.array(degrees)).prod(axis=1)
        exact = math.prod(normal_moment(degree) for degree in degrees)
        assert abs(terms.sum() - exact) <= MOMENT * np.abs(terms).sum()


@pytest.mark.parametrize("order", ORDERS)
def test_against_numpy(order: int) -> None:
    nodes, weights = gauss_hermite(order)
    their_nodes, their_weights = hermegauss(order)
    np.testing.assert_allclose(nodes[:, 0], their_nodes, rtol=0.0, atol=NODE)
    np.testing.assert_allclose(weights, their_weights / their_weights.sum(), rtol=0.0, atol=NODE)


def test_three_nodes() -> None:
    nodes, weights = gauss_hermite(3)
    np.testing.assert_allclose(nodes[:, 0], np.sqrt([3.0, 0.0, 3.0]) * [-1, 0, 1], atol=NODE)
    np.testing.assert_allclose(weights, [1 / 6, 2 / 3, 1 / 6], atol=ROUNDING)


@pytest.mark.parametrize(("order", "dimension"), [*((order, 1) for order in ORDERS), *PRODUCTS])
def test_exactly_symmetric(order: int, dimension: int) -> None:
    nodes, weights = gauss_hermite(order, dimension)
    np.testing.assert_array_equal(nodes[::-1], -nodes)
    np.testing.assert_array_equal(weights[::-1], weights)
    assert (weights > 0.0).all()
    if order % 2:
        assert (nodes[len(nodes) // 2] == 0.0).all()


def test_one_value_for_all() -> None:
    rule = gauss_hermite(4, 2)
    assert gauss_hermite(4, 2) is rule
    for array in rule:
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 1.0


@pytest.mark.parametrize(
    ("order", "dimension", "says"),
    [
        (0, 1, "order of 1 or more, not 0"),
        (-3, 1, "order of 1 or more, not -3"),
        (3, 0, "dimension of 1 or more, not 0"),
        (3, 32, r"3\^32 nodes"),
        (MOST_NODES + 1, 1, "lower order"),
    ],
)
def test_rules_that_are_none(order: int, dimension: int, says: str) -> None:
    with pytest.raises(ValueError, match=says):
        gauss_hermite(order, dimension)


def test_the_order_is_an_integer() -> None:
    with pytest.raises(TypeError):
        gauss_hermite(2.5)  # type: ignore[arg-type]
