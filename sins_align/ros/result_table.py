"""The result for people: rows of values beside their sigma and, where known, the truth."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np

from sins_align.ros.result import (
    mounting_sigma,
    odometer_lever_sigma,
    roll_pitch_heading,
    roll_pitch_heading_sigma,
)
from sins_align.ros.truth import Truth
from sins_align.types import Array, Estimate, OdometerEstimate
from sins_align.units import ARCMIN, DEG, DEG_PER_H, MICRO_G

HEAD = ("", "estimate", "1 sigma", "truth", "error", "error/sigma")
_CONVENTIONS = "pitch positive nose down, heading clockwise from north, x forward, y left, z up"
_UNOBSERVABLE = "unobservable"


class Row(NamedTuple):
    """The cells of one quantity, as text; '' where there is nothing to say."""

    name: str
    estimate: str
    sigma: str
    truth: str = ""
    error: str = ""
    ratio: str = ""


def result_rows(estimate: Estimate, truth: Truth | None) -> list[Row]:
    """One row each for roll, pitch, heading, lever arm and biases."""
    rows = list(_attitude_rows(estimate, truth))
    lever_arm = estimate.lever_arm
    if lever_arm is not None:
        rows += _vector_rows(
            "lever arm", "m", lever_arm.r_b, np.sqrt(np.diag(lever_arm.covariance)),
            None if truth is None else truth.lever_arm, lever_arm.observable,
        )  # fmt: skip
    rows += _vector_rows(
        "gyro bias", "deg/h", estimate.gyro_bias / DEG_PER_H, estimate.gyro_bias_sigma / DEG_PER_H,
        None if truth is None or truth.gyro_bias is None else truth.gyro_bias / DEG_PER_H,
    )  # fmt: skip
    rows += _vector_rows(
        "accel bias", "µg", estimate.accel_bias / MICRO_G, estimate.accel_bias_sigma / MICRO_G,
        None if truth is None or truth.accel_bias is None else truth.accel_bias / MICRO_G,
    )  # fmt: skip
    if estimate.odometer is not None:
        rows += _odometer_rows(estimate.odometer, truth)
    return rows


def _odometer_rows(odometer: OdometerEstimate, truth: Truth | None) -> Iterator[Row]:
    truth = truth or Truth(0, np.empty(4))
    scale = truth.odometer_scale_error
    yield from _vector_rows(
        "odometer scale error", "%", np.array([100.0 * odometer.scale_error]),
        np.array([100.0 * odometer.scale_sigma]), None if scale is None else 100.0 * scale,
        axes=("",),
    )  # fmt: skip
    yield from _vector_rows(
        "odometer latency", "s", np.array([odometer.latency_s]),
        np.array([odometer.latency_sigma_s]), truth.odometer_latency, axes=("",),
    )  # fmt: skip
    yield from _vector_rows(
        "odometer lever", "m", odometer.lever_arm_b, odometer_lever_sigma(odometer),
        truth.odometer_lever_arm,
    )  # fmt: skip
    yield from _vector_rows(
        "mounting", "deg", odometer.mounting_rpy[1:] / DEG, mounting_sigma(odometer)[1:] / DEG,
        None if truth.mounting_rpy_deg is None else truth.mounting_rpy_deg[1:],
        axes=("pitch", "yaw"),  # a forward speed does not tell the roll
    )  # fmt: skip


def _attitude_rows(estimate: Estimate, truth: Truth | None) -> Iterator[Row]:
    angles = roll_pitch_heading(estimate.q_nb)
    sigmas = roll_pitch_heading_sigma(estimate)
    known = truth is not None and truth.is_at(estimate.stamp_ns)
    true = roll_pitch_heading(truth.q_nb) if truth is not None and known else (None,) * 3
    in_deg = max(_decimals(sigmas / DEG), 5)
    in_arcmin = max(_decimals(sigmas / ARCMIN), 4)
    for k, name in enumerate(("roll", "pitch", "heading")):
        sigma = float(sigmas[k])
        row = Row(
            name,
            f"{_fixed(angles[k] / DEG, in_deg)} deg",
            f"{_fixed(sigma / ARCMIN, in_arcmin)}'",
        )
        true_angle = true[k]
        if true_angle is not None:
            error = math.remainder(angles[k] - true_angle, 2.0 * math.pi)
            row = row._replace(
                truth=f"{_fixed(true_angle / DEG, in_deg)} deg",
                error=f"{_fixed(error / ARCMIN, in_arcmin, '+')}'",
                ratio=_ratio(error, sigma),
            )
        yield row


def _vector_rows(
    name: str,
    unit: str,
    values: Array,
    sigmas: Array,
    true: Array | None,
    observable: Sequence[bool] | None = None,
    axes: Sequence[str] = ("x", "y", "z"),
) -> Iterator[Row]:
    """One row an axis, in `unit`; an axis that is not observable has no estimate."""
    observable = observable or [True] * len(axes)
    decimals = _decimals(sigmas[list(observable)])
    for k, axis in enumerate(axes):
        value, sigma = float(values[k]), float(sigmas[k])
        row = Row(f"{name} {axis}".rstrip(), _UNOBSERVABLE, "")
        if observable[k]:
            row = row._replace(
                estimate=f"{_fixed(value, decimals)} {unit}",
                sigma=f"{_fixed(sigma, decimals)} {unit}",
            )
        if true is not None:
            error = value - float(true[k])
            row = row._replace(truth=f"{_fixed(float(true[k]), decimals)} {unit}")
            if observable[k]:
                row = row._replace(
                    error=f"{_fixed(error, decimals, '+')} {unit}", ratio=_ratio(error, sigma)
                )
        yield row


def _decimals(sigmas: Array) -> int:
    """Decimals that show the smallest 1 sigma with three digits; 6 where there is none."""
    known = sigmas[sigmas > 0.0]
    return min(max(2 - math.floor(math.log10(known.min())), 0), 9) if known.size else 6


def _fixed(value: float, decimals: int, sign: str = "") -> str:
    """Plain decimal text; no minus before what is rounded to zero."""
    return f"{round(value, decimals) + 0.0:{sign}.{decimals}f}"


def _ratio(error: float, sigma: float) -> str:
    return _fixed(error / sigma, 2, "+") if sigma > 0.0 else ""


def verdict(document: dict[str, Any]) -> str:
    """One line: aligned when, or not and why."""
    if document["aligned"]:
        return f"aligned after {document['aligned_at_s']:.1f} s"
    return f"not aligned ({document['state']}): {document['reason']}"


def footer(document: dict[str, Any]) -> list[str]:
    """Lines on how far the result can be trusted, what went in and how long it took."""
    counts, timing = document["input"], document["timing"]
    lines = []
    if document["q_nb_wxyz"] is not None:
        seconds, nanoseconds = divmod(document["stamp_ns"], 1_000_000_000)
        lines += [_CONVENTIONS, f"attitude at stamp {seconds}.{nanoseconds:09d}"]
    if document["heading_limit_arcmin"] is not None:
        lines.append(
            "heading limit of the declared gyro at this latitude"
            f" {document['heading_limit_arcmin']:.4f}'"
        )
    if document["consistency"] is not None:
        lines.append(
            f"consistency of the innovations {document['consistency']:.3f}"
            " (1: as noisy as declared; below: less)"
        )
    lines.append(
        f"{counts['imu_samples']} samples over {counts['duration_s']:.3f} s,"
        f" {counts['imu_rejected']} rejected, {counts['imu_gaps']} gaps"
    )
    if counts["odom_samples"] or counts["odom_rejected"]:
        lines.append(
            f"{counts['odom_samples']} samples of the odometer, {counts['odom_rejected']} rejected"
        )
    lines.append(
        f"{timing['wall_s']:.2f} s in all, reading {timing['read_s']:.2f} s,"
        f" estimation {timing['estimate_s']:.2f} s"
    )
    return lines


def describe_result(
    document: dict[str, Any], estimate: Estimate | None, truth: Truth | None
) -> str:
    """The result as a text of some 20 lines.

    document : the content of result.json
    estimate : what it was made from
    """
    lines = [f"{document['node']}, method {document['method']}: {verdict(document)}"]
    if estimate is not None:
        rows = result_rows(estimate, truth)
        table = [HEAD, *rows] if truth else [HEAD[:3], *(row[:3] for row in rows)]
        widths = np.max([[len(cell) for cell in row] for row in table], axis=0).tolist()
        for name, *cells in table:
            aligned = "  ".join(
                cell.rjust(width) for cell, width in zip(cells, widths[1:], strict=True)
            )
            lines.append(f"{name.ljust(widths[0])}  {aligned}".rstrip())
        if truth is not None and not truth.is_at(estimate.stamp_ns):
            lines.append("the truth is that of another time: its attitude is not compared")
    return "\n".join(lines + footer(document))
