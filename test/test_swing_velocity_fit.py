"""The second opinion: as good as it claims, and no friend of other data."""

from __future__ import annotations

import functools
import math
from dataclasses import replace

import numpy as np
import pytest
from numpy.polynomial.legendre import leggauss
from swing_filtered import (
    LATITUDE_DEG,
    OPTIONS,
    Filtered,
    filter_run,
    gravity_model,
    mean_square_bounds,
)

from evidence.monte_carlo import misalignment
from sins_align.consistency import MAX_DISAGREEMENT
from sins_align.limits import heading_limit
from sins_align.rotation import exp_rotation
from sins_align.simulate import SwingOptions
from sins_align.swing.epochs import Epochs
from sins_align.swing.solution import Solution
from sins_align.swing.velocity_fit import VelocityFit
from sins_align.types import ImuBlock, ImuSampling, Witness
from sins_align.units import DEG
from sins_align.windows import integrate_windows

SEEDS = 16
SCENARIOS = pytest.mark.parametrize("scenario", ["still", "level", "pitch", "erect"])
LONG = replace(OPTIONS, duration_s=100.0)


@functools.cache
def runs(scenario: str) -> list[Filtered]:
    return [filter_run(replace(LONG, scenario=scenario, seed=seed)) for seed in range(SEEDS)]


def fit_of(filtered: Filtered) -> VelocityFit:
    fit = VelocityFit(filtered.gravity, filtered.noise)
    fit.update(filtered.epochs)
    return fit


def compare(
    fit: VelocityFit, filtered: Filtered, solution: Solution | None = None, sigma: float = math.nan
) -> Witness:
    """A fit beside the filter's solution, or beside another one with its sigma of heading."""
    if solution is None:
        solution, sigma = filtered.solution, filtered.heading_sigma(filtered.filter)
    position = filtered.filter.noise.variance
    witness = fit.compare(solution, filtered.prior, filtered.epochs, sigma**2, position)
    assert witness is not None
    return witness


@pytest.mark.parametrize("latitude_deg", [-35.0, 0.0, 40.0, 89.0])
@pytest.mark.parametrize("end_s", [0.5, 60.0, 600.0, 3600.0])
def test_integral_is_that_of_the_basis(latitude_deg: float, end_s: float) -> None:
    model = gravity_model(latitude_deg)
    x, weight = leggauss(12)
    t = 0.5 * end_s * (x + 1.0)
    numeric = 0.5 * end_s * (weight @ model.basis(t))
    found = model.integral(np.array([0.0, end_s]))
    assert not found[0].any()
    # The series that it is made of leaves out (W t)^4 / 840, the share of an hour.
    assert found[1] == pytest.approx(numeric, rel=1e-7 + (7.3e-5 * end_s) ** 4 / 600.0, abs=1e-12)


@SCENARIOS
def test_agrees_with_the_filter(scenario: str) -> None:
    """From the same data, so the two are nearer than independent ones would be."""
    squares = [compare(fit_of(f), f).square for f in runs(scenario)]
    assert max(squares) < 0.5 * MAX_DISAGREEMENT
    assert np.mean(squares) > 1e-3  # and it is not the same estimate


@SCENARIOS
def test_agrees_with_the_truth(scenario: str) -> None:
    """Its own variance, with the bias that no filter tells from heading: honest both ways."""
    squares, headings = [], []
    limit = heading_limit(LONG.imu_grade, LATITUDE_DEG * DEG)
    for filtered in runs(scenario):
        true = replace(filtered.solution, R=filtered.truth.R)
        witness = compare(fit_of(filtered), filtered, true, limit)
        squares.append(witness.square)
        headings.append(witness.phi[2])
        assert not witness.phi[:2].any()
    low, high = mean_square_bounds(SEEDS)
    assert low < np.mean(squares) < high
    assert np.sqrt(np.mean(np.square(headings))) < 0.1 * DEG


def test_in_portions_it_is_the_same() -> None:
    """The epochs come as the cycles end: seen once each."""
    filtered = runs("pitch")[0]
    parts, epochs = VelocityFit(filtered.gravity, filtered.noise), Epochs()
    stamps, w, f = filtered.run.imu
    for first, last in ((0, 1000), (1000, 1025), (1025, 5000)):
        part = slice(first, last + 1)
        block = ImuBlock(stamps[part], w[:, part], f[:, part])
        count = round((last - first) / 25)
        epochs.append(integrate_windows(block, ImuSampling.INSTANTANEOUS, count))
        parts.update(epochs)
    whole = VelocityFit(filtered.gravity, filtered.noise)
    whole.update(epochs)
    expected, found = compare(whole, filtered), compare(parts, filtered)
    assert found.phi[2] == pytest.approx(expected.phi[2], rel=1e-3)
    assert abs(expected.phi[2]) > 1e-6


@pytest.mark.parametrize("heading_deg", [-3.0, 3.0])
def test_other_data_do_not_agree(heading_deg: float) -> None:
    """The fit of a base that stands otherwise; phi is of the solution against the fit."""
    options = replace(LONG, scenario="still", seed=1)
    mine, other = filter_run(options), filter_run(replace(options, heading_deg=heading_deg))
    witness = compare(fit_of(other), mine)
    assert witness.square > 100.0 * MAX_DISAGREEMENT
    expected = misalignment(mine.solution.R.T, other.solution.R.T)
    assert witness.phi[2] == pytest.approx(expected[2], abs=0.05 * DEG)
    assert abs(witness.phi[2]) == pytest.approx(3.0 * DEG, rel=0.03)


def test_a_solution_that_was_misled_does_not_agree() -> None:
    """Heading turned by 20 sigma."""
    filtered = runs("pitch")[0]
    sigma = filtered.heading_sigma(filtered.filter)
    up = filtered.solution.R[:, 2]
    R = exp_rotation(20.0 * sigma * up) @ filtered.solution.R
    witness = compare(fit_of(filtered), filtered, replace(filtered.solution, R=R), sigma)
    assert witness.square > 50.0 * MAX_DISAGREEMENT


def short(options: SwingOptions, latitude_deg: float = LATITUDE_DEG) -> Witness | None:
    filtered = filter_run(options, latitude_deg)
    return fit_of(filtered).compare(filtered.solution, filtered.prior, filtered.epochs, 1.0, 1e-6)


@pytest.mark.parametrize("turn_deg", [10.0, 30.0])
def test_none_once_the_base_has_turned(turn_deg: float) -> None:
    """A swing is no turn, however large."""
    options = replace(OPTIONS, scenario="pitch", seed=1, duration_s=70.0)
    turned = replace(options, turn_deg=turn_deg, turn_start_s=30.0, turn_duration_s=5.0)
    assert (short(turned) is None) == (turn_deg > 20.0)


def test_none_in_the_first_half_minute_and_at_the_pole() -> None:
    still = replace(OPTIONS, scenario="still", seed=1)
    assert short(replace(still, duration_s=29.0)) is None
    assert short(replace(still, duration_s=31.0)) is not None
    assert short(replace(still, latitude_deg=90.0), 90.0) is None
