"""The alignment's state as diagnostics: every key, every time, as text."""

from __future__ import annotations

import math

from diagnostic_msgs.msg import DiagnosticStatus, KeyValue

from sins_align.reasons import Finding, texts
from sins_align.session import Session
from sins_align.types import Estimate, State, Status
from sins_align.units import ARCMIN, DEG

UNKNOWN = "unknown"
ODOMETER_KEYS = (
    "odometer_scale_error", "odometer_scale_sigma", "odometer_latency_s", "odometer_latency_sigma_s"
)  # fmt: skip
_AXES = ("x", "y", "z")


def number_text(value: float | None, digits: int = 3) -> str:
    """Plain decimal text, `unknown` where there is no finite value."""
    if value is None or not math.isfinite(value):
        return UNKNOWN
    return f"{value:.{digits}f}"


def diagnostic_status(
    session: Session,
    name: str,
    estimate: Estimate | None,
    eta_s: float,
    inputs: tuple[Finding, ...] = (),
) -> DiagnosticStatus:
    """Level, message and the keys that every node has.

    Parameters
    ----------
    session : as it stands now
    name : of the node, with its namespace
    estimate : of the session
    eta_s : predicted time to go [s]
    inputs : what only the node knows of its inputs; comes before what the session says
    """
    status = session.status
    inputs = tuple(f for f in inputs if f.reason.key not in status.keys)
    findings = (*inputs, *status.findings)
    reason, remedy = texts(findings)
    level = _level(status, inputs)
    counts = session.counts
    values = {
        "state": status.state.value,
        "reason": reason,
        "reason_keys": " ".join(dict.fromkeys(f.reason.key for f in findings)),
        "remedy": remedy,
        "elapsed_s": number_text(status.elapsed_s),
        **_estimate_texts(estimate),
        "heading_limit_arcmin": number_text(status.heading_limit / ARCMIN, 4),
        "eta_s": number_text(eta_s, 0),
        "imu_rate_hz": number_text(session.imu_rate_hz),
        "imu_gaps": str(counts.imu_gaps),
        "imu_rejected": str(counts.imu_rejected),
        "odom_rejected": str(counts.odom_rejected),
    }
    return DiagnosticStatus(
        level=level,
        name=f"{name}: alignment",
        message=reason or status.state.value,
        hardware_id=name,
        values=key_values(values),
    )


def _estimate_texts(estimate: Estimate | None) -> dict[str, str]:
    """What the estimate is worth, and what else it tells."""
    sigma = (None,) * 3 if estimate is None else (estimate.sigma / ARCMIN).tolist()
    latitude = None if estimate is None else estimate.latitude
    return {
        "sigma_east_arcmin": number_text(sigma[0], 4),
        "sigma_north_arcmin": number_text(sigma[1], 4),
        "sigma_heading_arcmin": number_text(sigma[2], 4),
        "consistency": number_text(None if estimate is None else estimate.consistency),
        "latitude_deg": number_text(None if latitude is None else latitude.latitude / DEG, 4),
        "latitude_sigma_deg": number_text(None if latitude is None else latitude.sigma / DEG, 4),
    }


def key_values(texts: dict[str, str]) -> list[KeyValue]:
    """The texts as they go into a DiagnosticStatus."""
    return [KeyValue(key=key, value=text) for key, text in texts.items()]


def lever_arm_texts(estimate: Estimate | None) -> dict[str, str]:
    """The keys of the lever arm; an axis that the motion does not excite is unknown."""
    lever_arm = None if estimate is None else estimate.lever_arm
    texts = {}
    for k, axis in enumerate(_AXES):
        value = sigma = None
        if lever_arm is not None and lever_arm.observable[k]:
            value = float(lever_arm.r_b[k])
            sigma = math.sqrt(lever_arm.covariance[k, k])
        texts[f"lever_{axis}_m"] = number_text(value, 6)
        texts[f"lever_{axis}_sigma_m"] = number_text(sigma, 6)
    return texts


def odometer_texts(estimate: Estimate | None) -> dict[str, str]:
    """The keys of the odometer."""
    odometer = None if estimate is None else estimate.odometer
    if odometer is None:
        return dict.fromkeys(ODOMETER_KEYS, UNKNOWN)
    numbers = (
        odometer.scale_error, odometer.scale_sigma, odometer.latency_s, odometer.latency_sigma_s
    )  # fmt: skip
    return {key: number_text(x, 6) for key, x in zip(ODOMETER_KEYS, numbers, strict=True)}


def _level(status: Status, inputs: tuple[Finding, ...]) -> bytes:
    if inputs or status.state in (State.WAITING, State.FAILED):
        return DiagnosticStatus.ERROR
    aligned = status.state is State.ALIGNED and not status.findings
    return DiagnosticStatus.OK if aligned else DiagnosticStatus.WARN
