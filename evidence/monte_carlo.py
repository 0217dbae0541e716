"""Runs of the simulator through the session, and the statistics of what came out."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Any, TypeVar

import numpy as np
from joblib import Parallel, delayed

from sins_align.config import SwingConfig, swing_config
from sins_align.rotation import (
    dcm_from_quaternion,
    exp_rotation,
    log_rotation,
    rpy_from_dcm,
)
from sins_align.session import Session
from sins_align.simulate import SwingOptions, SwingRun, simulate_swing
from sins_align.types import Array, Estimate

Result = TypeVar("Result")


@dataclass(frozen=True)
class Outcome:
    """One run: errors, estimate minus truth, with what the filter claimed.

    misalignment : (3,) phi east, north, up [rad]; covariance of it
    lever_error : (3,) in b [m], with its covariance; C_paper_b maps b to the paper's axes
    """

    seed: int
    misalignment: Array
    covariance: Array
    lever_error: Array
    lever_covariance: Array
    lever_observable: tuple[bool, bool, bool]
    C_paper_b: Array
    consistency: float
    aligned_at_s: float | None

    @property
    def lever_error_paper(self) -> Array:
        """(3,) in the axes of the paper's tables [m]."""
        return self.C_paper_b @ self.lever_error

    @property
    def lever_sigma_paper(self) -> Array:
        """(3,) claimed 1 sigma in the axes of the paper's tables [m]."""
        return np.sqrt((self.C_paper_b @ self.lever_covariance @ self.C_paper_b.T).diagonal())

    @property
    def sigma(self) -> Array:
        """(3,) claimed 1 sigma [rad]."""
        return np.sqrt(self.covariance.diagonal())

    @property
    def nees(self) -> float:
        """Normalised squared error of the attitude, 3 degrees of freedom."""
        return float(self.misalignment @ np.linalg.solve(self.covariance, self.misalignment))


def misalignment(C_nb: Array, C_nb_true: Array) -> Array:
    """phi with C_nb = (I - [phi x]) C_nb_true: (3,) [rad]."""
    return -log_rotation(C_nb @ C_nb_true.T)


def misalignment_of(estimate: Estimate, C_nb_true: Array) -> Array:
    """phi of an estimate: (3,) [rad]."""
    return misalignment(dcm_from_quaternion(estimate.q_nb), C_nb_true)


def rms(values: Array, axis: int | None = None) -> Any:
    """Root of the mean square."""
    return np.sqrt(np.mean(np.square(values), axis=axis))


def every_seed(
    run_one: Callable[..., Result],
    options: Any,
    seeds: Iterable[int],
    *arguments: Any,
    jobs: int = 2,
) -> list[Result]:
    """`run_one(options with the seed, *arguments)` for every seed, on `jobs` cores."""
    tasks = (delayed(run_one)(replace(options, seed=seed), *arguments) for seed in seeds)
    return list(Parallel(n_jobs=jobs)(tasks))


def _start_attitude(simulated: SwingRun, error_deg: float) -> list[float]:
    """roll, pitch, yaw [deg] of the true start, turned by a rotation vector of equal parts."""
    C_true = simulated.truth.C_nb_at(int(simulated.imu.stamp_ns[0]))
    C_wrong = exp_rotation(np.full(3, np.radians(error_deg))) @ C_true
    return list(np.degrees(rpy_from_dcm(C_wrong)))


def make_config(
    simulated: SwingRun, parameters: Mapping[str, Any], start_error_deg: float | None = None
) -> SwingConfig:
    """Settings that fit the run; the paper's method starts wrong by `start_error_deg`."""
    options = simulated.options
    values = {
        "latitude_deg": options.latitude_deg,
        "altitude_m": options.altitude_m,
        "imu_sampling": options.imu_sampling.value,
        "imu_grade": options.grade,
        **parameters,
    }
    if start_error_deg is not None:
        values["initial_rpy_deg"] = _start_attitude(simulated, start_error_deg)
    return swing_config(values)


def run(
    options: SwingOptions, parameters: Mapping[str, Any], start_error_deg: float | None = None
) -> Outcome:
    """One simulated alignment."""
    simulated = simulate_swing(options)
    session = Session(make_config(simulated, parameters, start_error_deg))
    session.add_imu(simulated.imu)
    estimate = session.conclusion
    if estimate is None or estimate.lever_arm is None:
        raise RuntimeError(f"no estimate: {session.status}")
    lever = estimate.lever_arm
    return Outcome(
        seed=options.seed,
        misalignment=misalignment_of(estimate, simulated.truth.C_nb_at(estimate.stamp_ns)),
        covariance=estimate.misalignment_covariance,
        lever_error=lever.r_b - np.asarray(simulated.truth.lever_arm_m),
        lever_covariance=lever.covariance,
        lever_observable=lever.observable,
        C_paper_b=simulated.truth.C_paper_b,
        consistency=estimate.consistency,
        aligned_at_s=session.status.aligned_at_s,
    )


def monte_carlo(
    options: SwingOptions,
    parameters: Mapping[str, Any],
    seeds: Iterable[int],
    *,
    start_error_deg: float | None = None,
    jobs: int = 2,
) -> list[Outcome]:
    """The same scenario with every seed, on `jobs` cores."""
    return every_seed(run, options, seeds, parameters, start_error_deg, jobs=jobs)


def heading_nees(outcomes: list[Outcome]) -> float:
    """Mean of (heading error / sigma)^2, 1 when sigma is honest."""
    return float(np.mean([(o.misalignment[2] / o.sigma[2]) ** 2 for o in outcomes]))
