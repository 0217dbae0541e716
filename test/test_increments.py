"""Integrals over samples: order of accuracy, coning and sculling, losses, odd streams."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from sins_align.gaps import fill_gaps
from sins_align.increments import integrate_rotation, join_blocks, uniform_step
from sins_align.rotation import (
    cumulative_rotation,
    dcm_from_quaternion,
    quaternion_from_rotation_vector,
)
from sins_align.types import Array, ImuBlock, ImuSampling, IntArray
from sins_align.units import ARCSEC
from sins_align.windows import Windows, integrate_windows

MEAN, INSTANTANEOUS = ImuSampling.MEAN, ImuSampling.INSTANTANEOUS
BOTH = pytest.mark.parametrize("sampling", [MEAN, INSTANTANEOUS])
T0 = 1_700_000_000_000_000_000
FOURTH_ORDER, THIRD_ORDER = 2.0**4, 2.0**3
# A swing of 0.3 rad with a period near 1 s is about the wildest that a base does.
FREQUENCIES = 2.0 * math.pi * np.array([[0.9], [1.3], [0.7]])


@dataclass(frozen=True)
class Motion:
    """Smooth rate and specific force, out of phase on all axes: it cones and sculls."""

    def w(self, t: Array) -> Array:
        phases = np.array([[0.2], [1.7], [3.0]])
        size = np.array([[0.5], [0.8], [0.3]])
        return size * np.sin(FREQUENCIES * t + phases) + [[0.05], [0.0], [0.1]]

    def f(self, t: Array) -> Array:
        phases = np.array([[1.0], [0.4], [2.2]])
        size = np.array([[2.0], [1.0], [3.0]])
        return size * np.cos(FREQUENCIES * t + phases) + [[0.3], [-0.5], [9.8]]

    def mean(self, which: str, begin: Array, end: Array) -> Array:
        x, weights = np.polynomial.legendre.leggauss(8)
        middle, half = 0.5 * (begin + end), 0.5 * (end - begin)
        return 0.5 * sum(
            w * getattr(self, which)(middle + half * a) for a, w in zip(x, weights, strict=True)
        )


MOTION = Motion()


def block(stamp_ns: IntArray, sampling: ImuSampling, nominal_ns: int | None = None) -> ImuBlock:
    """What an IMU says at the stamps; means reach back to the stamp before, or `nominal_ns`."""
    t = (stamp_ns - T0) * 1e-9
    if sampling is INSTANTANEOUS:
        return ImuBlock(stamp_ns, MOTION.w(t), MOTION.f(t))
    if nominal_ns is None:
        begin = np.concatenate(([t[0] - (t[1] - t[0])], t[:-1]))
    else:
        begin = t - nominal_ns * 1e-9
    return ImuBlock(stamp_ns, MOTION.mean("w", begin, t), MOTION.mean("f", begin, t))


def regular(rate_hz: float, duration_s: float = 1.0) -> IntArray:
    count = round(rate_hz * duration_s)
    return T0 + np.rint(np.arange(count + 1) * (1e9 / rate_hz)).astype(np.int64)


def jittered(rate_hz: float, seed: int = 0) -> IntArray:
    stamps = regular(rate_hz)
    share = np.random.default_rng(seed).uniform(-0.2, 0.2, stamps.size)
    share[[0, -1]] = 0.0
    return stamps + np.rint(share * 1e9 / rate_hz).astype(np.int64)


def dense_reference(duration_s: float = 1.0, count: int = 2) -> Windows:
    """The same integrals by Gauss-Legendre quadrature on 4000 cells a second.

    Rotation of a cell by its fourth-order Magnus expansion.
    """
    cells = round(4000 * duration_s)
    h = duration_s / cells
    begin = np.arange(cells) * h
    root = math.sqrt(3.0) / 6.0
    w1, w2 = (MOTION.w(begin + h * (0.5 + s * root)) for s in (-1, 1))
    theta = 0.5 * h * (w1 + w2) + math.sqrt(3.0) / 12.0 * h * h * np.cross(w1, w2, axis=0)
    q = cumulative_rotation(quaternion_from_rotation_vector(theta))
    C = dcm_from_quaternion(q)
    g = np.concatenate(
        (C.reshape(9, -1), np.einsum("ijn,jn->in", C, MOTION.f(begin_end(begin, h))))
    )
    per = cells // count
    simpson = np.ones(per + 1)
    simpson[1:-1:2], simpson[2:-1:2] = 4.0, 2.0
    left = h * per - h * np.arange(per + 1)
    sums = [
        (g[:, k * per : (k + 1) * per + 1] @ (np.stack((simpson, simpson * left)).T * h / 3.0))
        for k in range(count)
    ]
    S = np.stack(sums)  # (W, 12, 2)
    B, BB = S[:, :9].reshape(count, 3, 3, 2).transpose(3, 0, 1, 2)
    u, s = S[:, 9:].transpose(2, 0, 1)
    C_end = C[:, :, per::per].transpose(2, 0, 1)
    return Windows(np.full(count, h * per), u, s, B, BB, C_end, q[:, -1])


def begin_end(begin: Array, h: float) -> Array:
    return np.append(begin, begin[-1] + h)


def errors(found: Windows, expected: Windows) -> dict[str, float]:
    """Largest error of each integral; of the rotation as an angle."""
    # For a small angle, C_expected^T C_found - I is its skew matrix.
    turn = expected.C_end.transpose(0, 2, 1) @ found.C_end - np.eye(3)
    result = {
        name: float(np.abs(getattr(found, name) - getattr(expected, name)).max())
        for name in ("u", "s", "B", "BB")
    }
    return {"q": float(np.abs(turn).max()), **result}


REFERENCE = dense_reference()


@BOTH
@pytest.mark.parametrize("stamps", [regular, jittered], ids=["regular", "jittered"])
def test_order_of_accuracy(stamps, sampling: ImuSampling) -> None:  # type: ignore[no-untyped-def]
    """Halving the step divides the error by 16, by 8 at least.

    Irregular stamps vary; the velocity of interval means is of third order.
    """
    coarse, fine = (
        errors(integrate_windows(block(stamps(rate), sampling), sampling, 2), REFERENCE)
        for rate in (40.0, 80.0)
    )
    for name in coarse:
        exact = stamps is regular and not (sampling is MEAN and name in "us")
        assert coarse[name] / fine[name] > (0.8 * FOURTH_ORDER if exact else THIRD_ORDER), name


@BOTH
@pytest.mark.parametrize(
    ("rate_hz", "attitude", "velocity"),
    [
        (50.0, 2.0 * ARCSEC, 2e-4),
        (100.0, 0.15 * ARCSEC, 2e-5),
        (200.0, 0.01 * ARCSEC, 1e-6),
        (1000.0, 1e-4 * ARCSEC, 1e-8),
        (2000.0, 1e-4 * ARCSEC, 1e-8),
    ],
)
def test_coning_and_sculling_at_the_rates_of_imus(
    rate_hz: float, attitude: float, velocity: float, sampling: ImuSampling
) -> None:
    found = errors(integrate_windows(block(regular(rate_hz), sampling), sampling, 2), REFERENCE)
    assert found["q"] < attitude
    assert found["u"] < velocity
    assert found["s"] < velocity
    assert max(found["B"], found["BB"]) < attitude


@BOTH
def test_ten_hertz_works_and_is_as_bad_as_it_must_be(sampling: ImuSampling) -> None:
    found = errors(integrate_windows(block(regular(10.0), sampling), sampling, 2), REFERENCE)
    assert found["q"] < 0.02
    assert found["u"] < 0.2


@BOTH
def test_kilohertz_jitter_agrees_to_the_rounding(sampling: ImuSampling) -> None:
    windows = integrate_windows(block(jittered(1000.0), sampling), sampling, 2)
    # An interval that ends before or after 0.5 s ends the first window.
    assert errors(windows, REFERENCE)["q"] < 1.0  # the ends differ, the whole does not:
    whole = integrate_windows(block(jittered(1000.0), sampling), sampling, 1)
    found = errors(whole, dense_reference(count=1))
    assert found["q"] < 1e-3 * ARCSEC
    assert found["u"] < 1e-7


def test_classic_coning_rate() -> None:
    """Cone of half-angle a at frequency W: the body drifts by W (1 - cos a) about the axis.

    w = (W sin a cos Wt, W sin a sin Wt, -W (1 - cos a)) returns to the start each turn; without
    coning correction it would drift by about W a^2 / 2 (1 - sin(Wh)/(Wh)).
    """
    half_angle, turn = 0.05, 2.0 * math.pi * 5.0
    stamps = regular(100.0)
    t = (stamps - T0) * 1e-9
    w = np.stack((
        turn * math.sin(half_angle) * np.cos(turn * t),
        turn * math.sin(half_angle) * np.sin(turn * t),
        np.full_like(t, -turn * (1.0 - math.cos(half_angle))),
    ))  # fmt: skip
    q = integrate_rotation(ImuBlock(stamps, w, np.zeros_like(w)), INSTANTANEOUS)
    # Sampled at 20 a turn; 5 turns uncorrected would leave 2 pi 5 a^2/2 (Wh)^2/6 = 6.5e-4 rad.
    assert 2.0 * np.abs(q[1:]).max() < 2e-5


@BOTH
def test_rotation_is_the_end_of_the_windows(sampling: ImuSampling) -> None:
    for stamps in (regular(200.0), jittered(200.0), np.delete(regular(200.0), [40, 41, 90])):
        one = block(stamps, sampling)
        windows = integrate_windows(one, sampling, 3)
        np.testing.assert_array_equal(integrate_rotation(one, sampling), windows.q_end)


@BOTH
@pytest.mark.parametrize("size", [1, 2, 3, 4, 5, 6, 7])
def test_tiny_blocks(size: int, sampling: ImuSampling) -> None:
    """From one interval on; more than one window only where each has three intervals."""
    one = block(T0 + np.arange(size + 1) * 10_000_000, sampling)
    windows = integrate_windows(one, sampling, 2)
    assert windows.duration_s.shape == (2 if size >= 6 else 1,)
    assert windows.duration_s.sum() == pytest.approx(0.01 * size)
    expected = dense_reference(0.01 * size, 1)
    if size < 6:
        found = errors(windows, expected)
        # A mean cannot tell within one interval how it changed.
        assert found["q"] < (0.1 if size == 1 else 4.0) * 10.0 * ARCSEC
        assert found["u"] < 2e-3
    np.testing.assert_array_equal(integrate_rotation(one, sampling), windows.q_end)


def test_a_single_sample_is_no_rotation() -> None:
    one = block(regular(100.0), MEAN)
    first = ImuBlock(one.stamp_ns[:1], one.w_ib_b[:, :1], one.f_ib_b[:, :1])
    np.testing.assert_array_equal(integrate_rotation(first, MEAN), [1.0, 0.0, 0.0, 0.0])


@BOTH
def test_windows_add_up(sampling: ImuSampling) -> None:
    """u, B of parts sum to those of the whole; s of the whole is s + u T of the parts."""
    one = block(regular(200.0), sampling)
    whole, parts = (integrate_windows(one, sampling, count) for count in (1, 4))
    assert parts.duration_s.sum() == pytest.approx(1.0, abs=1e-12)
    np.testing.assert_allclose(parts.u.sum(axis=0), whole.u[0], atol=1e-7)
    np.testing.assert_allclose(parts.B.sum(axis=0), whole.B[0], atol=1e-8)
    left = 1.0 - np.cumsum(parts.duration_s)
    np.testing.assert_allclose(
        (parts.s + parts.u * left[:, None]).sum(axis=0), whole.s[0], atol=1e-7
    )


def test_joined_blocks_are_the_stream() -> None:
    one = block(regular(100.0), MEAN)
    cut = [0, 20, 21, 60, 100]
    parts = [
        ImuBlock(one.stamp_ns[a : b + 1], one.w_ib_b[:, a : b + 1], one.f_ib_b[:, a : b + 1])
        for a, b in pairwise(cut)
    ]
    for found, expected in zip(join_blocks(parts), one, strict=True):
        np.testing.assert_array_equal(found, expected)
    assert join_blocks(parts[:1]) is parts[0]


def without(stamps: IntArray, lost: list[int], sampling: ImuSampling, rate: float) -> ImuBlock:
    """The samples that are left, each with the mean over its own nominal interval."""
    full = block(stamps, sampling, round(1e9 / rate) if sampling is MEAN else None)
    keep = np.delete(np.arange(stamps.size), lost)
    return ImuBlock(full.stamp_ns[keep], full.w_ib_b[:, keep], full.f_ib_b[:, keep])


LOSSES = {
    "one": [50],
    "three": [50, 51, 52],
    "seven": list(range(50, 57)),
    "first": [1],
    "last": [99],
    "both edges": [1, 2, 98, 99],
    "neighbours": [50, 52, 54],
    "every third": list(range(1, 99, 3)),
}


@BOTH
@pytest.mark.parametrize("lost", LOSSES.values(), ids=LOSSES)
def test_lost_samples_are_put_back(lost: list[int], sampling: ImuSampling) -> None:
    stamps = regular(100.0)
    filled = fill_gaps(without(stamps, lost, sampling, 100.0))
    np.testing.assert_array_equal(filled.stamp_ns, stamps)
    full = block(stamps, sampling)
    # 0.08 s of a swing of 1 s: what a cubic leaves over.
    assert np.abs(filled.w_ib_b - full.w_ib_b).max() < 5e-3
    assert np.abs(filled.f_ib_b - full.f_ib_b).max() < 5e-2
    found = errors(integrate_windows(filled, sampling, 1), dense_reference(count=1))
    assert found["q"] < 20.0 * ARCSEC
    assert found["u"] < 2e-3


@BOTH
def test_losses_keep_the_order(sampling: ImuSampling) -> None:
    """A tenth of the samples lost, one at a time: still at least third order."""
    expected = dense_reference(count=1)
    found = []
    for rate in (40.0, 80.0):
        stamps = regular(rate)
        lost = list(range(5, stamps.size - 2, 10))
        one = without(stamps, lost, sampling, rate)
        found.append(errors(integrate_windows(one, sampling, 1), expected))
    for name in found[0]:
        assert found[0][name] / found[1][name] > THIRD_ORDER, name


@BOTH
@pytest.mark.parametrize("gap_s", [0.1, 0.25, 0.5])
def test_noise_is_not_multiplied_over_a_long_gap(gap_s: float, sampling: ImuSampling) -> None:
    """A vibrating vehicle at 1 kHz: the four samples around a gap must not decide alone.

    Their cubic would make 1 % of the noise into as many hundred times that of the integral.
    """
    stamps = regular(1000.0, 2.0)
    rng = np.random.default_rng(7)
    lost = slice(700, 700 + round(1000 * gap_s) - 1)
    sigma = 1.0  # [m/s^2], and a thousandth in [rad/s]
    deviations = []
    for _ in range(20):
        f = sigma * rng.normal(size=(3, stamps.size))
        still = ImuBlock(stamps, 1e-3 * f, f)
        left = ImuBlock(*(np.delete(x, lost, axis=-1) for x in still))
        window = integrate_windows(left, sampling, 1)
        deviations.append(window.u[0])
    white = sigma * math.sqrt(2.0 * 1e-3)
    # The fit through a stretch as long as the gap costs its noise once more.
    assert np.sqrt(np.mean(np.square(deviations))) < 2.0 * white


def test_nothing_to_fill_is_the_same_object() -> None:
    for stamps in (regular(100.0), jittered(100.0)):
        one = block(stamps, INSTANTANEOUS)
        assert fill_gaps(one) is one


def test_uniform_step_tolerates_rounded_stamps() -> None:
    t = (regular(300.0) - T0) * 1e-9
    assert uniform_step(t) == pytest.approx(1.0 / 300.0)
    assert uniform_step((jittered(300.0) - T0) * 1e-9) is None


def test_bursts_of_stamps_cost_neither_memory_nor_sense() -> None:
    """Stamped on arrival: ten samples 10 us apart, then 50 ms nothing."""
    burst = (np.arange(20)[:, None] * 50_000_000 + np.arange(10) * 10_000).ravel()
    rng = np.random.default_rng(0)
    w, f = 1e-3 * rng.normal(size=(3, 200)), rng.normal(size=(3, 200))
    one = ImuBlock(T0 + burst, w, f + np.array([[0.0], [0.0], [9.8]]))
    assert fill_gaps(one).stamp_ns.size < 25_000
    windows = integrate_windows(one, INSTANTANEOUS, 1)
    assert windows.u[0, 2] == pytest.approx(9.8 * windows.duration_s[0], abs=1.0)


steps_ns = st.lists(st.integers(10_000, 500_000_000), min_size=1, max_size=40)


@settings(max_examples=150, deadline=None)
@given(steps_ns, st.integers(1, 4), st.sampled_from([MEAN, INSTANTANEOUS]))
@example([116_264_299, 10_000, 10_020, 51_663_002], 1, MEAN)
def test_any_stamps_give_finite_integrals(
    steps: list[int], count: int, sampling: ImuSampling
) -> None:
    stamps = T0 + np.concatenate(([0], np.cumsum(steps)))
    one = ImuBlock(stamps, np.zeros((3, stamps.size)), np.ones((3, stamps.size)))
    windows = integrate_windows(one, sampling, count)
    duration = sum(steps) * 1e-9
    assert windows.duration_s.min() > 0.0
    assert windows.duration_s.sum() == pytest.approx(duration)
    # A constant is integrated exactly whatever the stamps, but for the rounding of divided
    # differences over steps of which one is so many times another.
    rtol = 1e-9 + np.finfo(float).eps * (max(steps) / min(steps)) ** 2
    np.testing.assert_allclose(windows.u.sum(axis=0), duration, rtol=rtol)
    np.testing.assert_allclose(
        windows.s, np.outer(0.5 * windows.duration_s**2, np.ones(3)), rtol=rtol
    )
    np.testing.assert_allclose(windows.q_end[0], 1.0)
