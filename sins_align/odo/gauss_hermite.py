"""The Gauss-Hermite rule: nodes and weights for expectations over a standard normal."""

from __future__ import annotations

import math
import operator
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from sins_align.types import Array

# A product rule has order^dimension nodes; beyond this it was asked for by mistake.
MOST_NODES = 1_000_000
KEPT_RULES = 32


class Rule(NamedTuple):
    """Nodes and weights with E[f(u)] ~ sum_i weights[i] f(nodes[i]), u ~ N(0, I).

    nodes : (m, n) symmetric about zero, exactly: nodes[::-1] == -nodes
    weights : (m,) positive, of sum 1, symmetric
    """

    nodes: Array
    weights: Array


@lru_cache(maxsize=KEPT_RULES)
def gauss_hermite(order: int, dimension: int = 1) -> Rule:
    """The Gauss-Hermite rule for the standard normal density; its arrays are read-only.

    It is exact for all polynomials of degree 2 order - 1 or less in each coordinate. In one
    dimension, with J symmetric, tridiagonal and zero on its diagonal,

        J[i, i+1] = sqrt(i / 2), i = 1 .. order - 1
        u_i = sqrt(2) alpha_i,  W_i = (first component of v_i)^2

    where alpha_i, v_i are J's eigenvalues and normalised eigenvectors (Wu, Tang and Huang,
    eqs. (1), (2)); in more dimensions the tensor product, with order^dimension nodes. Weights
    are right to 1e-15 of the largest; those of less than that, from order 25 on, are not.

    Parameters
    ----------
    order : number of nodes in each coordinate
    dimension : n, number of coordinates

    Returns
    -------
    Rule, in ascending order of the nodes (the first coordinate changes last)

    Raises
    ------
    ValueError : order or dimension is less than 1, or the nodes are more than MOST_NODES
    TypeError : order or dimension is no integer
    """
    order, dimension = operator.index(order), operator.index(dimension)
    if order < 1:
        raise ValueError(f"a Gauss-Hermite rule needs an order of 1 or more, not {order}")
    if dimension < 1:
        raise ValueError(f"a Gauss-Hermite rule needs a dimension of 1 or more, not {dimension}")
    if dimension * math.log(order) > math.log(MOST_NODES):  # the power itself may be huge
        raise ValueError(
            f"{order}^{dimension} nodes are more than {MOST_NODES}: take a lower order, "
            "or condition on the nonlinear states"
        )
    u, W = _one_dimension(order)
    nodes = np.stack(np.meshgrid(*[u] * dimension, indexing="ij"), axis=-1)
    weights = np.stack(np.meshgrid(*[W] * dimension, indexing="ij"), axis=-1).prod(axis=-1)
    rule = Rule(nodes.reshape(-1, dimension), weights.reshape(-1))
    for array in rule:
        array.setflags(write=False)
    return rule


def _one_dimension(order: int) -> tuple[Array, Array]:
    """Nodes and weights, (order,) each."""
    beside = np.sqrt(np.arange(1, order) / 2.0)
    alpha, v = np.linalg.eigh(np.diag(beside, -1))  # which reads the lower triangle
    u, W = np.sqrt(2.0) * alpha, v[0] ** 2
    # The rule is symmetric, its computed eigenvalues only nearly. Odd moments have to vanish,
    # and the middle node of an odd order is the mean itself.
    return 0.5 * (u - u[::-1]), 0.5 * (W + W[::-1])
