"""Settings of the estimators: frozen, SI, made once from parameters."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from sins_align.grades import ConfigError, ImuGrade, grade_from_values, load_grade
from sins_align.parameters import GRADE_OVERRIDES, check_values
from sins_align.types import Array, ImuSampling, Position
from sins_align.units import ARCMIN, ARCSEC, DEG

__all__ = ["ConfigError", "ImuGrade", "PaperConfig", "SwingConfig", "load_grade"]


@dataclass(frozen=True)
class Completion:
    """When the alignment is complete: 1-sigma thresholds [rad], held for hold_s [s]."""

    heading_threshold: float
    level_threshold: float
    hold_s: float


@dataclass(frozen=True)
class PaperConfig:
    """Settings of the method of Mu and Fang.

    differentiator : 'eso' or 'central'
    regression : 'ls' or 'epls'
    eso_bandwidth : [rad/s], None: 1 / sampling interval, which at 1 kHz is the paper's
    switch_times_s : from the end of the level phase [s]
    initial_rpy : (3,) roll, pitch, yaw of b (FLU) in n (ENU), REP-103 [rad]
    """

    differentiator: str
    regression: str
    eso_bandwidth: float | None
    switch_times_s: tuple[float, ...]
    level_phase_s: float
    initial_rpy: tuple[float, float, float]


@dataclass(frozen=True)
class SwingConfig:
    """Settings of `swing_align`, for both methods.

    position : None until a fix has come
    lever_arm_prior : (3,) in b [m], with lever_arm_prior_sigma [m] per axis
    position_noise : floor, 1 sigma of the swing centre at a filter step [m]
    position_walk : random walk of the swing centre [m/sqrt(s)]
    """

    method: str
    position: Position | None
    grade: ImuGrade
    sampling: ImuSampling
    completion: Completion
    passes: int
    lever_arm_prior: Array
    lever_arm_prior_sigma: float
    position_noise: float
    position_walk: float
    paper: PaperConfig


def _position(values: Mapping[str, Any]) -> Position | None:
    latitude, longitude, altitude = (
        values[key] for key in ("latitude_deg", "longitude_deg", "altitude_m")
    )
    if math.isnan(latitude):
        return None
    return Position(
        latitude * DEG,
        0.0 if math.isnan(longitude) else longitude * DEG,
        0.0 if math.isnan(altitude) else altitude,
    )


def _grade(values: Mapping[str, Any]) -> ImuGrade:
    overrides = {k: values[k] for k in GRADE_OVERRIDES if not math.isnan(values[k])}
    return grade_from_values(overrides, load_grade(values["imu_grade"]))


def swing_config(parameters: Mapping[str, object] | None = None) -> SwingConfig:
    """Settings of `swing_align` from parameter values in YAML units, over the defaults.

    Raises
    ------
    ConfigError : unknown parameter, wrong type, out of range; names the key
    """
    values: dict[str, Any] = check_values("swing_align", parameters or {})
    noise = values["position_noise_m"]
    walk = values["position_walk_m_sqrt_s"]
    bandwidth = values["eso_bandwidth_rad_s"]
    roll, pitch, yaw = (angle * DEG for angle in values["initial_rpy_deg"])
    return SwingConfig(
        method=values["method"],
        position=_position(values),
        grade=_grade(values),
        sampling=ImuSampling(values["imu_sampling"]),
        completion=Completion(
            values["heading_threshold_arcmin"] * ARCMIN,
            values["level_threshold_arcsec"] * ARCSEC,
            values["hold_s"],
        ),
        passes=values["passes"],
        lever_arm_prior=np.array(values["lever_arm_prior_m"]),
        lever_arm_prior_sigma=values["lever_arm_prior_sigma_m"],
        position_noise=noise,
        position_walk=0.4 * noise if math.isnan(walk) else walk,
        paper=PaperConfig(
            differentiator=values["differentiator"],
            regression=values["regression"],
            eso_bandwidth=None if math.isnan(bandwidth) else bandwidth,
            switch_times_s=tuple(values["switch_times_s"]),
            level_phase_s=values["level_phase_s"],
            initial_rpy=(roll, pitch, yaw),
        ),
    )
