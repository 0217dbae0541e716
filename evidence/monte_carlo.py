"""Runs of the simulator through the session, and the statistics of what came out."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from joblib import Parallel, delayed

from sins_align.config import swing_config
from sins_align.rotation import dcm_from_quaternion, log_rotation
from sins_align.session import Session
from sins_align.simulate import SwingOptions, simulate_swing
from sins_align.types import Array, Estimate


@dataclass(frozen=True)
class Outcome:
    """One run: errors, estimate minus truth, with what the filter claimed.

    misalignment : (3,) phi east, north, up [rad]; sigma, covariance of it
    lever_error : (3,) in b [m]; lever_sigma, observable
    """

    seed: int
    misalignment: Array
    covariance: Array
    lever_error: Array
    lever_sigma: Array
    lever_observable: tuple[bool, bool, bool]
    consistency: float
    aligned_at_s: float | None

    @property
    def sigma(self) -> Array:
        """(3,) claimed 1 sigma [rad]."""
        return np.sqrt(self.covariance.diagonal())

    @property
    def nees(self) -> float:
        """Normalised squared error of the attitude, 3 degrees of freedom."""
        return float(self.misalignment @ np.linalg.solve(self.covariance, self.misalignment))


def misalignment_of(estimate: Estimate, C_nb_true: Array) -> Array:
    """phi with C_estimated = (I - [phi x]) C_true: (3,) [rad]."""
    return -log_rotation(dcm_from_quaternion(estimate.q_nb) @ C_nb_true.T)


def run(options: SwingOptions, parameters: Mapping[str, Any]) -> Outcome:
    """One simulated alignment."""
    simulated = simulate_swing(options)
    grade = {} if not isinstance(options.grade, str) else {"imu_grade": options.grade}
    config = swing_config(
        {
            "latitude_deg": options.latitude_deg,
            "altitude_m": options.altitude_m,
            "imu_sampling": options.imu_sampling.value,
            **grade,
            **parameters,
        }
    )
    session = Session(config)
    session.add_imu(simulated.imu)
    estimate = session.conclusion
    if estimate is None or estimate.lever_arm is None:
        raise RuntimeError(f"no estimate: {session.status}")
    C_true = simulated.truth.C_nb_at(estimate.stamp_ns)
    lever = estimate.lever_arm
    return Outcome(
        seed=options.seed,
        misalignment=misalignment_of(estimate, C_true),
        covariance=estimate.misalignment_covariance,
        lever_error=lever.r_b - np.asarray(simulated.truth.lever_arm_m),
        lever_sigma=np.sqrt(lever.covariance.diagonal()),
        lever_observable=lever.observable,
        consistency=estimate.consistency,
        aligned_at_s=session.status.aligned_at_s,
    )


def monte_carlo(
    options: SwingOptions,
    parameters: Mapping[str, Any],
    seeds: Iterable[int],
    jobs: int = 2,
) -> list[Outcome]:
    """The same scenario with every seed, on `jobs` cores."""
    tasks = (delayed(run)(replace(options, seed=seed), parameters) for seed in seeds)
    return list(Parallel(n_jobs=jobs)(tasks))


def heading_nees(outcomes: list[Outcome]) -> float:
    """Mean of (heading error / sigma)^2, 1 when sigma is honest."""
    return float(np.mean([(o.misalignment[2] / o.sigma[2]) ** 2 for o in outcomes]))


def row(name: str, outcomes: list[Outcome]) -> str:
    """One line of figures: attitude in 1e-3 deg, lever arm in mm."""
    phi = np.degrees(np.array([o.misalignment for o in outcomes])) * 1e3
    sigma = np.degrees(np.array([o.sigma for o in outcomes])).mean(axis=0) * 1e3
    lever = np.array([o.lever_error for o in outcomes]) * 1e3
    lever_sigma = np.array([o.lever_sigma for o in outcomes]).mean(axis=0) * 1e3

    def text(values: Array) -> str:
        return " ".join(f"{v:9.4g}" for v in values)

    rms = np.sqrt((phi**2).mean(axis=0))
    nees = np.mean([o.nees for o in outcomes]) / 3.0
    return (
        f"{name:26s} phi rms {text(rms)} sigma {text(sigma)} max {np.abs(phi[:, 2]).max():8.4g}"
        f" NEES/3 {nees:.2f} head {heading_nees(outcomes):.2f} | lever mean"
        f" {text(lever.mean(axis=0))} sd {text(lever.std(axis=0))} sigma {text(lever_sigma)}"
        f" | {np.mean([o.consistency for o in outcomes]):.2f}"
    )
