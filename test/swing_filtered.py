"""A simulated swing through the two-stage filter alone, linearised about the truth."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import chi2

from sins_align.earth import EARTH_RATE, normal_gravity
from sins_align.grades import ImuGrade
from sins_align.simulate import SwingOptions, SwingRun, simulate_swing
from sins_align.swing.epochs import Epochs
from sins_align.swing.excitation import LeverDirections, LeverExcitation
from sins_align.swing.solution import KAPPA, Prior, Solution, Solver, make_prior
from sins_align.swing.two_stage import GravityModel, Linearisation, NoiseModel, build_steps
from sins_align.swing.two_stage_filter import TwoStageFilter
from sins_align.types import ImuBlock, ImuSampling
from sins_align.windows import integrate_windows

LATITUDE_DEG, ALTITUDE_M = 40.0, 50.0
EPOCH_S = 0.5
OPTIONS = SwingOptions(
    grade="rlg", rate_hz=50.0, duration_s=60.0, latitude_deg=LATITUDE_DEG, altitude_m=ALTITUDE_M
)


def still_grade(grade: ImuGrade) -> ImuGrade:
    """Without what makes further columns: scale errors and misalignments."""
    return replace(grade, gyro_scale=0.0, accel_scale=0.0, misalignment=0.0)


def gravity_model(latitude_deg: float = LATITUDE_DEG) -> GravityModel:
    latitude = math.radians(latitude_deg)
    return GravityModel(normal_gravity(latitude, ALTITUDE_M), latitude, EARTH_RATE)


def noise_model(grade: ImuGrade) -> NoiseModel:
    return NoiseModel(
        gyro=grade.gyro_arw,
        accel=grade.accel_vrw,
        drift=grade.gyro_bias_instability,
        drift_time_s=grade.gyro_bias_correlation_s,
        position=5e-4,
        walk=2e-4,
    )


def epochs_of(run: SwingRun) -> Epochs:
    epochs = Epochs()
    count = round(run.options.duration_s / EPOCH_S)
    epochs.append(integrate_windows(ImuBlock(*run.imu), ImuSampling.INSTANTANEOUS, count))
    return epochs


@dataclass
class Filtered:
    """What came out.

    truth : attitude R at the first sample, and lever arm
    """

    run: SwingRun
    epochs: Epochs
    gravity: GravityModel
    noise: NoiseModel
    prior: Prior
    lever: LeverDirections
    truth: Linearisation
    filter: TwoStageFilter
    solver: Solver
    solution: Solution

    def heading_sigma(self, filter_: TwoStageFilter) -> float:
        """1 sigma at the first sample, with the information of a filter [rad]."""
        covariance = self.solver.covariance(filter_.normal, self.solution)
        up = self.solution.R[:, 2]
        return math.sqrt(float(up @ covariance[KAPPA, KAPPA] @ up))

    def heading_error(self) -> float:
        """phi_up of the solution at the first sample [rad]."""
        turned = self.solution.R.T @ self.truth.R
        return float(-0.5 * (turned[1, 0] - turned[0, 1]))


def filter_run(
    options: SwingOptions = OPTIONS,
    latitude_deg: float = LATITUDE_DEG,
    lever_sigma: float = 1.0,
    declared: ImuGrade | None = None,
) -> Filtered:
    """Simulate and filter; `latitude_deg` is what the filter believes."""
    run = simulate_swing(options)
    epochs, gravity = epochs_of(run), gravity_model(latitude_deg)
    grade = still_grade(declared or options.imu_grade)
    noise = noise_model(grade)
    prior = make_prior(np.zeros(3), lever_sigma, grade, 1e-3, calibration=False)
    excitation = LeverExcitation(noise.gyro)
    excitation.update(epochs)
    lever = excitation.directions()
    R = run.truth.C_nb_at(int(run.imu.stamp_ns[0])).T
    truth = Linearisation(R, np.asarray(run.truth.lever_arm_m))
    filter_ = TwoStageFilter(noise)
    filter_.run(build_steps(epochs, 0, truth, gravity, noise), None)
    solver = Solver(prior, lever, R)
    start = Solution(R, prior.mean, np.zeros((prior.mean.size,) * 2))
    solution = solver.solve(filter_.normal, start)
    return Filtered(run, epochs, gravity, noise, prior, lever, truth, filter_, solver, solution)


def mean_square_bounds(count: int) -> tuple[float, float]:
    """Two-sided 99.9 % bounds of the mean of `count` squared standard normals."""
    low, high = chi2.ppf([0.0005, 0.9995], count) / count
    return float(low), float(high)
