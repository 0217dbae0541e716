"""Every block of the paper's error model against the non-linear propagation itself."""

from __future__ import annotations

import numpy as np
import pytest

from sins_align.rotation import dcm_from_quaternion, multiply_quaternions
from sins_align.swing import paper_error_model as model
from sins_align.types import Array, Position

EARTH = model.Earth.at(Position(np.radians(40.0), 0.0, 300.0))
TOLERANCE = 4e-11
STEP = 1e-5


@pytest.fixture(params=range(3))
def point(request: pytest.FixtureRequest) -> dict[str, Array]:
    rng = np.random.default_rng(request.param)
    Q = rng.normal(size=4)
    return {
        "Q": Q / np.linalg.norm(Q),
        "V": rng.normal(size=2),
        "w": 0.3 * rng.normal(size=3),
        "f": rng.normal(size=3) + np.array([0.0, 0.0, 9.8]),
    }


def rotate(Q: Array, v: Array) -> Array:
    """Q v Q*, which for a Q that is no unit quaternion scales by |Q|^2."""
    conjugate = Q * [1.0, -1.0, -1.0, -1.0]
    return multiply_quaternions(multiply_quaternions(Q, np.append(0.0, v)), conjugate)[1:]


def quaternion_rate(Q: Array, V: Array, w: Array) -> Array:
    """Q' = 1/2 (Q w_ib_b - w_in_n Q)."""
    of_body = multiply_quaternions(Q, np.append(0.0, w))
    of_navigation = multiply_quaternions(np.append(0.0, EARTH.rate_n(V)), Q)
    return 0.5 * (of_body - of_navigation)


def velocity_rate(Q: Array, V: Array, f: Array) -> Array:
    """V' = C(Q) f - (2 w_ie_n + w_en_n) x V + g, east and north, no velocity up."""
    turning = EARTH.w_ie_n + EARTH.rate_n(V)
    return (rotate(Q, f) - np.cross(turning, [*V, 0.0]))[:2]


def derivative(function, x: Array, step: float = STEP) -> Array:
    """Central difference with its leading error removed (Richardson)."""

    def central(h: float) -> Array:
        columns = [(function(x + h * e) - function(x - h * e)) / (2.0 * h) for e in np.eye(x.size)]
        return np.stack(columns, axis=-1)

    return (4.0 * central(step) - central(2.0 * step)) / 3.0


def test_quaternion_products_are_matrices() -> None:
    p, q = np.random.default_rng(1).normal(size=(2, 4))
    product = multiply_quaternions(p, q)
    np.testing.assert_allclose(model.left_matrix(p) @ q, product, atol=1e-15)
    np.testing.assert_allclose(model.right_matrix(q) @ p, product, atol=1e-15)


def test_a_qq(point: dict[str, Array]) -> None:
    numeric = derivative(lambda Q: quaternion_rate(Q, point["V"], point["w"]), point["Q"])
    analytic = model.A_QQ(point["w"], EARTH.rate_n(point["V"]))
    np.testing.assert_allclose(analytic, numeric, rtol=0, atol=TOLERANCE)


def test_a_qv(point: dict[str, Array]) -> None:
    # Linear in V, and 1/R small: a wide step keeps the digits.
    numeric = derivative(lambda V: quaternion_rate(point["Q"], V, point["w"]), point["V"], 1e3)
    np.testing.assert_allclose(model.A_QV(point["Q"], EARTH), numeric, rtol=1e-9, atol=1e-18)


def test_a_vq(point: dict[str, Array]) -> None:
    numeric = derivative(lambda Q: velocity_rate(Q, point["V"], point["f"]), point["Q"], step=3e-3)
    np.testing.assert_allclose(model.A_VQ(point["Q"], point["f"]), numeric, rtol=0, atol=TOLERANCE)


def test_a_vv(point: dict[str, Array]) -> None:
    numeric = derivative(lambda V: velocity_rate(point["Q"], V, 0.0 * point["f"]), point["V"], 1e2)
    np.testing.assert_allclose(model.A_VV(point["V"], EARTH), numeric, rtol=1e-9, atol=1e-17)


def test_noise_inputs(point: dict[str, Array]) -> None:
    Q, C_nb = point["Q"], dcm_from_quaternion(point["Q"])
    gyro = derivative(lambda w: quaternion_rate(Q, point["V"], w), point["w"])
    accelerometer = derivative(lambda f: velocity_rate(Q, point["V"], f), point["f"], 1e-1)
    G = model.G(Q, C_nb)
    np.testing.assert_allclose(model.T(Q), gyro, rtol=0, atol=TOLERANCE)
    np.testing.assert_allclose(G[:4, :3], gyro, rtol=0, atol=TOLERANCE)
    np.testing.assert_allclose(G[4:, 3:], accelerometer, rtol=0, atol=TOLERANCE)
    assert not G[:4, 3:].any() and not G[4:, :3].any()


def test_whole_matrix_is_made_of_the_blocks(point: dict[str, Array]) -> None:
    Q, V, w, f = (point[key] for key in ("Q", "V", "w", "f"))
    A = model.A(Q[np.newaxis], V, w[np.newaxis], f[np.newaxis], EARTH)[0]
    rates = derivative(
        lambda x: np.append(quaternion_rate(x[:4], x[4:], w), velocity_rate(x[:4], x[4:], f)),
        np.append(Q, V),
        step=3e-3,
    )
    np.testing.assert_allclose(A, rates, rtol=0, atol=TOLERANCE)


def test_misalignment_is_two_xi_transposed_dq(point: dict[str, Array]) -> None:
    """C_nb_estimated = (I - [phi x]) C_nb_true, and psi = -phi: the sign of the conventions."""
    Q, psi = point["Q"], 1e-7 * np.array([1.0, -2.0, 3.0])
    half_xi = model.tilt_to_quaternion(Q)
    C_true, C_estimated = dcm_from_quaternion(Q), dcm_from_quaternion(Q + half_xi @ psi)
    cross = C_estimated @ C_true.T - np.eye(3)
    np.testing.assert_allclose(-cross[[2, 0, 1], [1, 2, 0]], -psi, rtol=0, atol=1e-12)
    np.testing.assert_allclose(4.0 * half_xi.T @ half_xi, np.eye(3), atol=1e-15)
    np.testing.assert_allclose(half_xi.T @ Q, 0.0, atol=1e-15)


def test_near_the_pole_rates_stay_finite() -> None:
    earth = model.Earth.at(Position(np.radians(90.0)))
    assert np.all(np.abs(earth.rate_n(np.ones(2))) < 1e-3)
