"""Settings of the estimators: frozen, SI, made once from parameters."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from sins_align.grades import ConfigError, ImuGrade, grade_from_values, load_grade
from sins_align.parameters import GRADE_OVERRIDES, check_values
from sins_align.stored import StoredAlignment, read_stored_alignment
from sins_align.types import Array, ImuSampling, Position
from sins_align.units import ARCMIN, ARCSEC, DEG

__all__ = [
    "ConfigError",
    "ImuGrade",
    "OdoConfig",
    "OdometerConfig",
    "PaperConfig",
    "SwingConfig",
    "load_grade",
]


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
    latitude_check : 'warn', 'fail' or 'off'
    initial : an alignment to go on from, None: there is none
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
    latitude_check: str = "warn"
    initial: StoredAlignment | None = None


@dataclass(frozen=True)
class OdometerConfig:
    """What is known of the odometer beforehand; SI, axes of b (FLU), 1 sigma.

    timeout_s : how long the IMU waits for it
    latency, latency_sigma [s], latency_walk [s/sqrt(s)] : by how much its stamps are late
    lever_arm, lever_arm_sigma : (3,) from the IMU to its reference point [m]
    scale_sigma, scale_walk : [1], [1/sqrt(s)]
    quantum : distance of one count [m], None: found from the data
    noise : (3,) of the displacement in a second, forward, left, up [m], and noise_per_m :
        (3,) what it grows by with the distance travelled in it [1]
    direction_sigma : slow part of the direction of travel, lateral and vertical [rad]
    mounting_rpy, mounting_sigma : vehicle's axes in b: roll, pitch, yaw, REP-103 [rad]
    """

    timeout_s: float
    latency: float
    latency_sigma: float
    latency_walk: float
    lever_arm: Array
    lever_arm_sigma: Array
    scale_sigma: float
    scale_walk: float
    quantum: float | None
    noise: Array
    noise_per_m: Array
    direction_sigma: float
    mounting_rpy: Array
    mounting_sigma: float


@dataclass(frozen=True)
class OdoConfig:
    """Settings of `odo_align`.

    position : None until a fix has come
    stationary : the vehicle stands, and needs no odometer
    coarse, fading, nodes : of the methods with a large azimuth error: what they start from,
        strong tracking, nodes of the Gauss-Hermite rule
    latitude_check : 'warn', 'fail' or 'off'
    initial : an alignment to go on from, None: there is none
    """

    method: str
    position: Position | None
    grade: ImuGrade
    sampling: ImuSampling
    completion: Completion
    stationary: bool
    odometer: OdometerConfig
    coarse: str
    fading: str
    nodes: int
    latitude_check: str = "warn"
    initial: StoredAlignment | None = None


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


def completion_of(values: Mapping[str, Any]) -> Completion:
    """When the alignment is complete, from checked parameter values in YAML units."""
    return Completion(
        values["heading_threshold_arcmin"] * ARCMIN,
        values["level_threshold_arcsec"] * ARCSEC,
        values["hold_s"],
    )


def _initial(values: Mapping[str, Any]) -> StoredAlignment | None:
    """The stored alignment that the parameter names.

    Raises
    ------
    ConfigError : there is none in that file; names parameter, file and key
    """
    name = values["initial_result_file"]
    try:
        return read_stored_alignment(Path(name)) if name else None
    except ConfigError as error:
        raise ConfigError(f"initial_result_file: {error}") from None


def _none_if_nan(value: float) -> float | None:
    return None if math.isnan(value) else value


def odo_config(parameters: Mapping[str, object] | None = None) -> OdoConfig:
    """Settings of `odo_align` from parameter values in YAML units, over the defaults.

    Raises
    ------
    ConfigError : unknown parameter, wrong type, out of range; names the key
    """
    values: dict[str, Any] = check_values("odo_align", parameters or {})
    return OdoConfig(
        method=values["method"],
        position=_position(values),
        grade=_grade(values),
        sampling=ImuSampling(values["imu_sampling"]),
        completion=completion_of(values),
        stationary=values["aiding"] == "stationary",
        coarse=values["coarse"],
        fading=values["fading"],
        nodes=values["gauss_hermite_nodes"],
        latitude_check=values["latitude_check"],
        initial=_initial(values),
        odometer=OdometerConfig(
            timeout_s=values["odom_timeout_s"],
            latency=values["odometer_latency_s"],
            latency_sigma=values["odometer_latency_sigma_s"],
            latency_walk=values["odometer_latency_walk_s_sqrt_s"],
            lever_arm=np.array(values["odometer_lever_arm_m"]),
            lever_arm_sigma=np.array(values["odometer_lever_arm_sigma_m"]),
            scale_sigma=values["odometer_scale_sigma"],
            scale_walk=values["odometer_scale_walk_sqrt_s"],
            quantum=_none_if_nan(values["odometer_quantum_m"]),
            noise=np.array(values["odometer_noise_m"]),
            noise_per_m=np.array(values["odometer_noise_per_m"]),
            direction_sigma=values["odometer_direction_sigma_deg"] * DEG,
            mounting_rpy=np.array(values["mounting_rpy_deg"]) * DEG,
            mounting_sigma=values["mounting_sigma_deg"] * DEG,
        ),
    )


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
        completion=completion_of(values),
        passes=values["passes"],
        latitude_check=values["latitude_check"],
        lever_arm_prior=np.array(values["lever_arm_prior_m"]),
        lever_arm_prior_sigma=values["lever_arm_prior_sigma_m"],
        position_noise=noise,
        position_walk=0.4 * noise if math.isnan(walk) else walk,
        initial=_initial(values),
        paper=PaperConfig(
            differentiator=values["differentiator"],
            regression=values["regression"],
            eso_bandwidth=_none_if_nan(bandwidth),
            switch_times_s=tuple(values["switch_times_s"]),
            level_phase_s=values["level_phase_s"],
            initial_rpy=(roll, pitch, yaw),
        ),
    )
