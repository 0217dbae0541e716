"""Angular acceleration: the observer of the paper and the central difference."""

from __future__ import annotations

import numpy as np
import pytest

from sins_align.swing.paper_differentiator import (
    CentralDifference,
    ExtendedStateObserver,
    make_differentiator,
    noise_gain,
)
from sins_align.types import Array


def observe_step_by_step(w: Array, h: float, bandwidth: float) -> Array:
    """The paper's recursion, sample by sample: s2 after each of the samples w (N,)."""
    s1, s2 = w[0], 0.0
    found = []
    for sample in w:
        error = s1 - sample
        s1, s2 = s1 + h * (s2 - 2.0 * bandwidth * error), s2 - h * bandwidth**2 * error
        found.append(s2)
    return np.array(found)


def in_stretches(differentiate, t: Array, w: Array, length: int) -> Array:
    """Derivative at t[1:-1], found stretch by stretch as the aligner does."""
    found = []
    for first in range(1, t.size - 1 - length, length):
        window = slice(first - 1, first + length + 2)
        slope = differentiate(t[window], w[:, window])
        found.append(slope if first == 1 else slope[:, 1:])
    return np.concatenate(found, axis=1)


def swing(t: Array) -> tuple[Array, Array]:
    omega = 2.0 * np.pi * np.array([[1 / 8], [1 / 10], [1 / 12]])
    return 0.1 * np.sin(omega * t + 1.0), 0.1 * omega * np.cos(omega * t + 1.0)


@pytest.mark.parametrize("bandwidth", [1000.0, 300.0])
def test_observer_is_the_recursion_of_the_paper(bandwidth: float) -> None:
    h = 1e-3
    t = h * np.arange(402)
    w = np.random.default_rng(0).normal(size=(3, t.size))
    slope = in_stretches(ExtendedStateObserver(bandwidth), t, w, 100)
    for axis in range(3):
        expected = observe_step_by_step(w[axis], h, bandwidth)[1 : slope.shape[1] + 1]
        np.testing.assert_allclose(slope[axis], expected, rtol=1e-9, atol=1e-8)


@pytest.mark.parametrize("bandwidth", [1000.0, None, 1e5])
def test_at_the_settings_of_the_paper_it_is_the_backward_difference(
    bandwidth: float | None,
) -> None:
    h = 1e-3
    t = h * np.arange(302)
    w = np.random.default_rng(0).normal(size=(3, t.size))
    slope = in_stretches(ExtendedStateObserver(bandwidth), t, w, 100)
    backward = np.diff(w)[:, : slope.shape[1]] / h
    np.testing.assert_allclose(slope, backward, rtol=1e-9)


@pytest.mark.parametrize("rate", [50.0, 200.0, 1000.0, 2000.0])
@pytest.mark.parametrize(("name", "bandwidth"), [("eso", None), ("eso", 30.0), ("central", None)])
def test_derivative_of_a_swing_comes_late_by_the_lag(
    name: str, bandwidth: float | None, rate: float
) -> None:
    h = 1.0 / rate
    t = h * np.arange(round(20.0 * rate) + 2)
    differentiate = make_differentiator(name, bandwidth)
    slope = in_stretches(differentiate, t, swing(t)[0], round(rate))
    times = t[1 : slope.shape[1] + 1]
    settled = times > 2.0
    late = swing(times - differentiate.lag(h))[1]
    largest = np.abs(late).max()
    # What is left is of second order in the lag and in the sampling interval.
    tolerance = 0.5 * (differentiate.lag(h) ** 2 + h**2) * largest + 1e-9
    assert np.abs(slope - late)[:, settled].max() < tolerance


@pytest.mark.parametrize(("name", "bandwidth"), [("eso", None), ("eso", 300.0), ("central", None)])
def test_noise_gain(name: str, bandwidth: float | None) -> None:
    h = 1e-3
    t = h * np.arange(60_002)
    w = np.random.default_rng(3).normal(size=(3, t.size))
    differentiate = make_differentiator(name, bandwidth)
    measured = differentiate(t, w).std()
    fresh = make_differentiator(name, bandwidth)
    assert measured == pytest.approx(noise_gain(fresh, h, False), rel=0.02)


def test_central_difference_of_irregular_samples() -> None:
    t = np.cumsum(np.random.default_rng(5).uniform(0.5e-3, 1.5e-3, 200))
    slope = CentralDifference()(t, np.vstack((2.0 * t, -t, 0.0 * t)))
    np.testing.assert_allclose(slope, [[2.0], [-1.0], [0.0]] * np.ones(t.size - 2), atol=1e-12)
