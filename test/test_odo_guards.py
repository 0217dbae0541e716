"""The guards: an outlier loses its weight, and a jump of the scale is told from all else."""

from __future__ import annotations

import numpy as np
import pytest

from sins_align.odo.guards import JUMP_EPOCHS, SOFT_LIMIT, ScaleJump, soften
from sins_align.types import Array

FORWARD = np.array([10.0, 0.0, 0.0])  # dz/dK of 10 m of travel [m]
SIGMA = 0.02  # of the innovation [m]
S_INVERSE = np.eye(3) / SIGMA**2


def feed(
    jump: ScaleJump, scales: list[float], h: Array = FORWARD, distance: float = 10.0
) -> list[float | None]:
    return [jump.test(h, S_INVERSE, scale * h, distance) for scale in scales]


def test_a_jump_is_found_in_five_epochs() -> None:
    """Nothing is said before, and the size is right."""
    found = feed(ScaleJump(), [0.02] * JUMP_EPOCHS)
    assert found[:-1] == [None] * (JUMP_EPOCHS - 1)
    assert found[-1] == pytest.approx(0.02)


def test_sign_of_a_jump() -> None:
    assert feed(ScaleJump(), [-0.03] * JUMP_EPOCHS)[-1] == pytest.approx(-0.03)


def test_a_jump_among_noise() -> None:
    """2 % on 10 m are ten sigma an epoch; the estimate weighs all five."""
    rng = np.random.default_rng(1)
    jump, found = ScaleJump(), None
    for _ in range(JUMP_EPOCHS):
        turned = 10.0 * np.array([np.cos(rng.normal()), np.sin(rng.normal()), 0.0])
        found = jump.test(turned, S_INVERSE, 0.02 * turned + SIGMA * rng.normal(size=3), 10.0)
    assert found == pytest.approx(0.02, abs=4.0 * SIGMA / 10.0 / np.sqrt(5.0))


def test_a_jump_is_told_once() -> None:
    """Then the votes are cast anew."""
    jump = ScaleJump()
    feed(jump, [0.02] * JUMP_EPOCHS)
    assert feed(jump, [0.02] * (JUMP_EPOCHS - 1)) == [None] * (JUMP_EPOCHS - 1)
    assert feed(jump, [0.02]) == [pytest.approx(0.02)]


def test_noise_is_no_jump() -> None:
    rng = np.random.default_rng(2)
    jump = ScaleJump()
    found = [jump.test(FORWARD, S_INVERSE, SIGMA * rng.normal(size=3), 10.0) for _ in range(5000)]
    assert found == [None] * 5000


@pytest.mark.parametrize(
    "scales",
    [
        pytest.param([0.25] * 5, id="too large: slip, and not the wheel's size"),
        pytest.param([0.02, 0.02, -0.001, 0.02, 0.02], id="not of one sign"),
        pytest.param([0.02, 0.02, 0.05, 0.02, 0.02], id="one says twice as much"),
        pytest.param([0.02, 0.02, 0.008, 0.02, 0.02], id="one says less than half"),
        pytest.param([0.0, 0.0, 0.0, 0.0, 0.05], id="a single outlier"),
        pytest.param([0.004] * 5, id="within the noise: ratio 20"),
    ],
)
def test_what_is_no_jump(scales: list[float]) -> None:
    assert feed(ScaleJump(), scales) == [None] * 5


def test_ratio_on_either_side_of_its_limit() -> None:
    """(sum b)^2 / sum a = 5 (10 m delta / sigma)^2, against 30."""
    limit = SIGMA / 10.0 * np.sqrt(30.0 / 5.0)
    assert feed(ScaleJump(), [0.99 * limit] * 5)[-1] is None
    assert feed(ScaleJump(), [1.01 * limit] * 5)[-1] == pytest.approx(1.01 * limit)


def test_what_goes_sideways_as_well_is_no_jump() -> None:
    """It must explain 0.7 of the normalised innovation squared."""
    for sideways, is_jump in ((0.6, True), (0.7, False)):
        jump, found = ScaleJump(), None
        for _ in range(JUMP_EPOCHS):
            innovation = 0.02 * (FORWARD + sideways * np.array([0.0, 10.0, 0.0]))
            found = jump.test(FORWARD, S_INVERSE, innovation, 10.0)
        assert (found is not None) == is_jump


@pytest.mark.parametrize("distance", [0.5, -0.5, 0.0])
def test_hardly_moved_epochs_have_no_vote(distance: float) -> None:
    """They neither count nor break the row."""
    jump = ScaleJump()
    feed(jump, [0.02] * 4)
    assert jump.test(FORWARD, S_INVERSE, -FORWARD, distance) is None
    assert feed(jump, [0.02]) == [pytest.approx(0.02)]


def test_reverse_counts() -> None:
    found = feed(ScaleJump(), [0.02] * 5, h=-FORWARD, distance=-10.0)
    assert found[-1] == pytest.approx(0.02)


def test_old_epochs_are_forgotten() -> None:
    found = feed(ScaleJump(), [0.0] * 20 + [0.02] * 5)
    assert found[:-1] == [None] * 24
    assert found[-1] == pytest.approx(0.02)


R = np.diag([0.01, 0.02, 0.03]) ** 2
DIRECTION = np.array([1.0, -0.5, 0.3])


def of_nis(S: Array, nis: float) -> Array:
    """An innovation of that normalised square."""
    return DIRECTION * np.sqrt(nis / (DIRECTION @ np.linalg.solve(S + R, DIRECTION)))


@pytest.mark.parametrize("nis", [12.0, 20.0, 100.0, 1e4])
def test_noise_of_an_outlier_grows_as_the_square(nis: float) -> None:
    """R (NIS / 11.3)^2 where the state is known well."""
    S = 1e-9 * R
    softened = soften(S, R, of_nis(S, nis), nis)
    np.testing.assert_allclose(softened, (nis / SOFT_LIMIT) ** 2 * R, rtol=1e-3, atol=1e-12)


@pytest.mark.parametrize("share", [1e-3, 1.0, 100.0])
@pytest.mark.parametrize("nis", [12.0, 30.0, 1e3, 1e5])
def test_outlier_loses_its_weight(nis: float, share: float) -> None:
    """Whatever the state's own share: its square is 11.3^2 / nis, 1.2 of it at most."""
    S = share * np.diag([3.0, 1.0, 0.5]) @ R
    innovation = of_nis(S, nis)
    softened = soften(S, R, innovation, nis)
    np.testing.assert_allclose(softened, softened.T)
    left = float(innovation @ np.linalg.solve(softened, innovation))
    assert left < 1.2 * SOFT_LIMIT**2 / nis * (1.0 + 1e-9)
    # Never shut out: R has not grown without bound.
    assert left > 0.02 * SOFT_LIMIT**2 / nis


def test_larger_outlier_moves_the_state_less() -> None:
    """Gain times innovation, a scalar's worth of it."""
    S, moved = 0.5 * R, []
    for nis in (12.0, 50.0, 1e3, 1e5):
        innovation = of_nis(S, nis)
        moved.append(
            float(np.linalg.norm(S @ np.linalg.solve(soften(S, R, innovation, nis), innovation)))
        )
    assert moved == sorted(moved, reverse=True)
