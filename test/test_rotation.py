"""Rotations against SciPy, and at the places where formulas change or break."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from sins_align.rotation import (
    cross,
    cumulative_rotation,
    dcm_from_quaternion,
    dcm_from_rpy,
    exp_rotation,
    heading_from_yaw,
    log_rotation,
    multiply_quaternions,
    quaternion_from_dcm,
    quaternion_from_rotation_vector,
    rpy_from_dcm,
    skew,
    unskew,
)
from sins_align.types import Array

ROUNDING = 1e-15  # a few units in the last place of 1
TIGHT = 20 * ROUNDING

components = st.floats(-1.0, 1.0)
vectors = st.tuples(components, components, components).map(np.array)
angles = st.floats(-math.pi, math.pi)
exponents = st.integers(-12, 0)


def directions(count: int, seed: int = 0) -> Array:
    v = np.random.default_rng(seed).normal(size=(count, 3))
    return v / np.linalg.norm(v, axis=1)[:, None]


def scipy_quaternion(rotation: Rotation) -> Array:
    return rotation.as_quat(scalar_first=True)


@given(vectors, vectors)
def test_skew_is_the_cross_product(a: Array, b: Array) -> None:
    np.testing.assert_allclose(skew(a) @ b, np.cross(a, b), atol=ROUNDING)
    np.testing.assert_array_equal(unskew(skew(a)), a)
    np.testing.assert_allclose(cross(a[:, None], b[:, None])[:, 0], np.cross(a, b), atol=ROUNDING)


def test_skew_and_cross_over_many() -> None:
    a, b = np.random.default_rng(1).normal(size=(2, 3, 50))
    np.testing.assert_allclose(cross(a, b), np.cross(a, b, axis=0), atol=TIGHT)
    np.testing.assert_array_equal(skew(a.T)[7], skew(a[:, 7]))
    np.testing.assert_array_equal(unskew(skew(a.T)), a.T)
    assert cross(a, b[:, :1]).shape == (3, 50)


@pytest.mark.parametrize("angle", [0.0, 1e-300, 1e-17, 1e-9, 1e-4, 0.03, 0.0632, 0.0633, 1.0, 3.0,
                                   math.pi, 3.2, 2 * math.pi - 1e-7, 2 * math.pi, 9.0])  # fmt: skip
def test_exp_against_scipy(angle: float) -> None:
    for axis in directions(20):
        expected = Rotation.from_rotvec(angle * axis)
        np.testing.assert_allclose(exp_rotation(angle * axis), expected.as_matrix(), atol=TIGHT)
        q = quaternion_from_rotation_vector(angle * axis)
        assert abs(abs(q @ scipy_quaternion(expected)) - 1.0) < TIGHT
        assert abs(q @ q - 1.0) < TIGHT


def test_exp_has_full_relative_precision_near_zero() -> None:
    for angle in 10.0 ** np.arange(-300.0, 0.0, 10.0):
        q = quaternion_from_rotation_vector(np.array([0.0, angle, 0.0]))
        assert q[2] == pytest.approx(0.5 * angle, rel=2e-3 if angle > 0.1 else 1e-12)


def test_series_meets_the_closed_form() -> None:
    """The switch is at |phi|^2 / 4 = 1e-3, and one large vector switches all of them."""
    switch = 2.0 * math.sqrt(1e-3)
    for factor in (0.2, 0.9, 1.0 - 1e-12):
        small = factor * switch * directions(40).T
        series = quaternion_from_rotation_vector(small)
        closed = quaternion_from_rotation_vector(np.column_stack((small, [1.0, 0.0, 0.0])))
        np.testing.assert_allclose(series, closed[:, :-1], atol=ROUNDING, rtol=0.0)


def test_no_vectors_at_all() -> None:
    assert quaternion_from_rotation_vector(np.zeros((3, 0))).shape == (4, 0)
    np.testing.assert_array_equal(cumulative_rotation(np.zeros((4, 0))), [[1], [0], [0], [0]])


@given(vectors, exponents)
def test_log_undoes_exp(direction: Array, exponent: int) -> None:
    phi = direction * 10.0**exponent * 1.8  # |phi| < pi
    np.testing.assert_allclose(log_rotation(exp_rotation(phi)), phi, atol=TIGHT, rtol=1e-14)


@pytest.mark.parametrize("below", [0.0, 1e-15, 1e-12, 1e-8, 1e-6, 1e-3])
def test_log_near_pi(below: float) -> None:
    for axis in directions(50, seed=2):
        phi = (math.pi - below) * axis
        found = log_rotation(exp_rotation(phi))
        assert np.linalg.norm(found) <= math.pi + ROUNDING
        if below < 1e-12 and found @ phi < 0.0:  # at pi both directions are the same rotation
            found = -found
        np.testing.assert_allclose(found, phi, atol=1e-14 + below * 1e-8)


def test_log_at_exactly_pi_about_the_axes() -> None:
    for i in range(3):
        C = -np.eye(3)
        C[i, i] = 1.0
        np.testing.assert_allclose(np.abs(log_rotation(C)), math.pi * np.eye(3)[i], atol=ROUNDING)
    np.testing.assert_array_equal(log_rotation(np.eye(3)), np.zeros(3))


def test_quaternion_and_matrix_against_scipy() -> None:
    """Every branch of Shepperd's method occurs among random attitudes."""
    rotations = Rotation.random(400, rng=np.random.default_rng(3))
    for rotation in rotations:
        expected = scipy_quaternion(rotation)
        expected *= np.copysign(1.0, expected[0])
        q = quaternion_from_dcm(rotation.as_matrix())
        np.testing.assert_allclose(q, expected, atol=TIGHT)
        np.testing.assert_allclose(dcm_from_quaternion(q), rotation.as_matrix(), atol=TIGHT)


@pytest.mark.parametrize("q", [*np.eye(4), *(np.ones((4, 4)) - 2.0 * np.eye(4)) / 2.0])
def test_quaternion_where_elements_are_equal_or_zero(q: Array) -> None:
    found = quaternion_from_dcm(dcm_from_quaternion(q))
    assert found[0] >= 0.0
    assert abs(abs(found @ q) - 1.0) < TIGHT


def test_matrices_of_many_quaternions_go_where_they_are_told() -> None:
    q = scipy_quaternion(Rotation.random(30, rng=np.random.default_rng(4))).T
    expected = Rotation.from_quat(q.T, scalar_first=True).as_matrix().transpose(1, 2, 0)
    out = np.full((3, 3, 30), np.nan)
    assert dcm_from_quaternion(q, out=out) is out
    np.testing.assert_allclose(out, expected, atol=TIGHT)


def test_product_is_that_of_the_matrices() -> None:
    p, q = (scipy_quaternion(Rotation.random(9, rng=np.random.default_rng(k))).T for k in (5, 6))
    product = dcm_from_quaternion(multiply_quaternions(p, q))
    np.testing.assert_allclose(
        product,
        np.einsum("ijn,jkn->ikn", dcm_from_quaternion(p), dcm_from_quaternion(q)),
        atol=TIGHT,
    )


@pytest.mark.parametrize(("count", "size"), [(1, 1.0), (2, 3.0), (7, 3.0), (1000, 1e-3), (1000, 2)])
def test_cumulative_rotation_is_the_sequential_product(count: int, size: float) -> None:
    phi = size * np.random.default_rng(count).normal(size=(3, count))
    d = quaternion_from_rotation_vector(phi)
    q = np.array([1.0, 0.0, 0.0, 0.0])
    expected = [q]
    for k in range(count):
        q = multiply_quaternions(q, d[:, k])
        expected.append(q)
    found = cumulative_rotation(d)
    assert found.flags.c_contiguous
    np.testing.assert_allclose(found, np.array(expected).T, atol=1e-14)


def test_cumulative_rotation_does_not_change_its_input() -> None:
    d = quaternion_from_rotation_vector(np.random.default_rng(0).normal(size=(3, 10)))
    before = d.copy()
    cumulative_rotation(d)
    np.testing.assert_array_equal(d, before)


@given(angles, st.floats(-1.57, 1.57), angles)
def test_rpy_against_scipy(roll: float, pitch: float, yaw: float) -> None:
    C_nb = dcm_from_rpy(roll, pitch, yaw)
    expected = Rotation.from_euler("ZYX", [yaw, pitch, roll]).as_matrix()
    np.testing.assert_allclose(C_nb, expected, atol=TIGHT)
    np.testing.assert_allclose(dcm_from_rpy(*rpy_from_dcm(C_nb)), C_nb, atol=1e-11)


@pytest.mark.parametrize("pitch", [0.5 * math.pi, -0.5 * math.pi])
@pytest.mark.parametrize("off", [0.0, 1e-9, 1e-7, 1e-6, 3e-6, 1e-4])
def test_rpy_at_and_near_the_gimbal(pitch: float, off: float) -> None:
    """Whatever the split of roll and yaw, the attitude is the same."""
    for roll, yaw in ((0.0, 0.0), (0.3, -2.0), (3.0, 1.0), (-1.0, 3.1)):
        C_nb = dcm_from_rpy(roll, pitch - math.copysign(off, pitch), yaw)
        found = rpy_from_dcm(C_nb)
        assert all(map(math.isfinite, found))
        # Within 1.4e-6 rad the pitch is taken as 90 deg.
        np.testing.assert_allclose(dcm_from_rpy(*found), C_nb, atol=2e-6)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_pitch_of_a_matrix_that_rounding_made_too_long(sign: float) -> None:
    C_nb = dcm_from_rpy(0.0, sign * 0.5 * math.pi, 0.7)
    C_nb[2, 0] = -sign * (1.0 + 4e-16)
    roll, pitch, yaw = rpy_from_dcm(C_nb)
    assert (roll, pitch) == (0.0, sign * 0.5 * math.pi)
    assert yaw == pytest.approx(0.7)


def test_rpy_is_positive_nose_down_left_wing_up() -> None:
    nose = dcm_from_rpy(0.0, 0.1, 0.0)[:, 0]
    left = dcm_from_rpy(0.1, 0.0, 0.0)[:, 1]
    assert nose[2] < 0.0 < left[2]


@pytest.mark.parametrize(
    ("yaw_deg", "heading_deg"),
    [(90, 0), (0, 90), (-90, 180), (180, 270), (-180, 270), (90.5, 359.5), (-270, 0), (810, 0)],
)
def test_heading_of_yaw(yaw_deg: float, heading_deg: float) -> None:
    found = math.degrees(heading_from_yaw(math.radians(yaw_deg)))
    assert (found - heading_deg + 180.0) % 360.0 - 180.0 == pytest.approx(0.0, abs=1e-12)


@given(
    st.one_of(
        st.floats(-1e6, 1e6),
        st.integers(-5, 5).map(lambda k: np.nextafter(0.5 * math.pi, 9.0) + k * 2.0 * math.pi),
        st.floats(-1e-15, 1e-15).map(lambda x: 0.5 * math.pi + x),
    )
)
def test_heading_never_leaves_its_range(yaw: float) -> None:
    heading = heading_from_yaw(yaw)
    assert 0.0 <= heading < 2.0 * math.pi
    assert math.degrees(heading) < 360.0


@pytest.mark.parametrize("function", [exp_rotation, quaternion_from_rotation_vector])
def test_not_a_number_stays_one(function: Callable[[Array], Array]) -> None:
    assert np.isnan(function(np.array([np.nan, 0.0, 0.0]))).any()
