"""The result file: one JSON document for the live node and the replay."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from sins_align.ros.whole_file import write_text_whole
from sins_align.session import Session
from sins_align.stored import SCHEMA
from sins_align.types import Array, Estimate, InputCounts, OdometerEstimate, State
from sins_align.units import ARCMIN, DEG


@dataclass(frozen=True)
class Timing:
    """Wall time of a run [s]: in all, for reading, and for the estimation."""

    wall_s: float = 0.0
    read_s: float = 0.0
    estimate_s: float = 0.0


def roll_pitch_heading(q_nb: Array) -> tuple[float, float, float]:
    """Roll, pitch and heading [rad] of a body attitude (4,); heading in [0, 2 pi).

    C_nb = Rz(yaw) Ry(pitch) Rx(roll), yaw = pi/2 - heading.
    """
    w, x, y, z = (float(value) for value in q_nb)
    roll = math.atan2(2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y))
    pitch = math.asin(min(1.0, max(-1.0, 2.0 * (w * y - x * z))))
    yaw = math.atan2(2.0 * (x * y + w * z), 1.0 - 2.0 * (y * y + z * z))
    return roll, pitch, (0.5 * math.pi - yaw) % (2.0 * math.pi)


def roll_pitch_heading_sigma(estimate: Estimate) -> Array:
    """(3,) 1 sigma of roll, pitch and heading [rad], from the misalignment covariance.

    A small rotation theta = -phi in n has the covariance of phi.
    """
    _, pitch, heading = roll_pitch_heading(estimate.q_nb)
    return rpy_sigma(pitch, 0.5 * math.pi - heading, estimate.misalignment_covariance)


def rpy_sigma(pitch: float, yaw: float, covariance: Array) -> Array:
    """(3,) 1 sigma of roll, pitch and yaw [rad] of C_ab = Rz(yaw) Ry(pitch) Rx(roll).

    A small rotation theta in a, C_ab + dC = (I + [theta x]) C_ab, changes
        d roll  = (cos yaw theta_x + sin yaw theta_y) / cos pitch
        d pitch = -sin yaw theta_x + cos yaw theta_y
        d yaw   = theta_z + tan pitch (cos yaw theta_x + sin yaw theta_y)

    covariance : (3, 3) of theta [rad^2]
    """
    cos_yaw, sin_yaw = math.cos(yaw), math.sin(yaw)
    cos_pitch = max(math.cos(pitch), 1e-9)
    tan_pitch = math.sin(pitch) / cos_pitch
    J = np.array(
        [
            [cos_yaw / cos_pitch, sin_yaw / cos_pitch, 0.0],
            [-sin_yaw, cos_yaw, 0.0],
            [tan_pitch * cos_yaw, tan_pitch * sin_yaw, 1.0],
        ]
    )
    sigma: Array = np.sqrt(np.diag(J @ covariance @ J.T))
    return sigma


def mounting_sigma(odometer: OdometerEstimate) -> Array:
    """(3,) 1 sigma of the mounting's roll, pitch and yaw [rad]."""
    _, pitch, yaw = odometer.mounting_rpy.tolist()
    return rpy_sigma(pitch, yaw, odometer.mounting_covariance)


def odometer_lever_sigma(odometer: OdometerEstimate) -> Array:
    """(3,) 1 sigma of the odometer's lever arm [m]."""
    sigma: Array = np.sqrt(np.diag(odometer.lever_arm_covariance))
    return sigma


def result_document(
    node: str, session: Session, estimate: Estimate | None, timing: Timing
) -> dict[str, Any]:
    """The content of result.json; what has no value is None.

    Parameters
    ----------
    node : `swing_align` or `odo_align`
    session : as it stands now
    estimate : its conclusion
    timing : of the run so far
    """
    status = session.status
    counts = session.counts
    return {
        "schema": SCHEMA,
        "node": node,
        "method": session.config.method,
        "aligned": status.state is State.ALIGNED,
        "aligned_at_s": status.aligned_at_s,
        "state": status.state.value,
        "reason": status.reason,
        "stamp_ns": counts.last_stamp_ns,
        **_estimate_part(estimate, status.heading_limit),
        "input": _input_part(counts),
        "timing": {
            "wall_s": timing.wall_s,
            "read_s": timing.read_s,
            "estimate_s": timing.estimate_s,
            "samples_per_s": (
                counts.imu_samples / timing.estimate_s if timing.estimate_s > 0.0 else None
            ),
        },
    }


def _estimate_part(estimate: Estimate | None, heading_limit: float) -> dict[str, Any]:
    """The keys from the attitude on, in the order of the file; heading_limit [rad]."""
    part: dict[str, Any] = dict.fromkeys(
        (
            "q_nb_wxyz", "roll_deg", "pitch_deg", "heading_deg",
            "misalignment_covariance_rad2", "sigma_arcmin", "heading_limit_arcmin",
            "gyro_bias_rad_s", "gyro_bias_sigma_rad_s", "accel_bias_m_s2", "accel_bias_sigma_m_s2",
            "lever_arm_m", "lever_arm_sigma_m", "lever_arm_observable",
            "odometer_scale_error", "odometer_scale_sigma", "mounting_rpy_deg",
            "mounting_sigma_deg", "odometer_latency_s", "odometer_latency_sigma_s",
            "odometer_lever_arm_m", "odometer_lever_arm_sigma_m", "consistency",
        )
    )  # fmt: skip
    part["heading_limit_arcmin"] = _number(heading_limit / ARCMIN)
    if estimate is None:
        return part
    roll, pitch, heading = (angle / DEG for angle in roll_pitch_heading(estimate.q_nb))
    sigma = (estimate.sigma / ARCMIN).tolist()
    part.update(
        stamp_ns=estimate.stamp_ns,
        q_nb_wxyz=_numbers(estimate.q_nb),
        roll_deg=roll,
        pitch_deg=pitch,
        heading_deg=heading,
        misalignment_covariance_rad2=_numbers(estimate.misalignment_covariance),
        sigma_arcmin=dict(zip(("east", "north", "heading"), _numbers(sigma), strict=True)),
        gyro_bias_rad_s=_numbers(estimate.gyro_bias),
        gyro_bias_sigma_rad_s=_numbers(estimate.gyro_bias_sigma),
        accel_bias_m_s2=_numbers(estimate.accel_bias),
        accel_bias_sigma_m_s2=_numbers(estimate.accel_bias_sigma),
        consistency=_number(estimate.consistency),
    )
    if estimate.lever_arm is not None:
        lever_arm = estimate.lever_arm
        part.update(
            lever_arm_m=_numbers(lever_arm.r_b),
            lever_arm_sigma_m=_numbers(np.sqrt(np.diag(lever_arm.covariance))),
            lever_arm_observable=list(lever_arm.observable),
        )
    if estimate.odometer is not None:
        part.update(_odometer_part(estimate.odometer))
    return part


def _odometer_part(odometer: OdometerEstimate) -> dict[str, Any]:
    return {
        "odometer_scale_error": _number(odometer.scale_error),
        "odometer_scale_sigma": _number(odometer.scale_sigma),
        "mounting_rpy_deg": _numbers(odometer.mounting_rpy / DEG),
        "mounting_sigma_deg": _numbers(mounting_sigma(odometer) / DEG),
        "odometer_latency_s": _number(odometer.latency_s),
        "odometer_latency_sigma_s": _number(odometer.latency_sigma_s),
        "odometer_lever_arm_m": _numbers(odometer.lever_arm_b),
        "odometer_lever_arm_sigma_m": _numbers(odometer_lever_sigma(odometer)),
    }


def _input_part(counts: InputCounts) -> dict[str, Any]:
    return {
        "imu_samples": counts.imu_samples,
        "imu_rejected": counts.imu_rejected,
        "imu_gaps": counts.imu_gaps,
        "odom_samples": counts.odom_samples,
        "odom_rejected": counts.odom_rejected,
        "duration_s": counts.duration_s,
    }


def _number(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None


def _numbers(values: Any) -> list[Any]:
    """Nested lists of numbers, None where a value is not finite."""
    array = np.asarray(values, dtype=float)
    if array.ndim > 1:
        return [_numbers(row) for row in array]
    return [_number(value) for value in array.tolist()]


def result_text(document: dict[str, Any]) -> str:
    """The document as the text of result.json."""
    return json.dumps(document, indent=1, allow_nan=False) + "\n"


def write_result(path: Path, document: dict[str, Any]) -> None:
    """Write result.json whole or not at all; OSError as `write_whole`."""
    write_text_whole(path, result_text(document))
