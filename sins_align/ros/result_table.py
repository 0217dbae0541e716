"""The result for people: rows of values beside their sigma and, where known, the truth."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np

from sins_align.ros.result import roll_pitch_heading, roll_pitch_heading_sigma
from sins_align.ros.truth import Truth
from sins_align.types import Array, Estimate
from sins_align.units import ARCMIN, DEG, DEG_PER_H, MICRO_G

HEAD = ("", "estimate", "1 sigma", "truth", "error", "error/sigma")
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
    rows += _lever_arm_rows(estimate, truth)
    rows += _vector_rows(
        "gyro bias", "deg/h", estimate.gyro_bias / DEG_PER_H, estimate.gyro_bias_sigma / DEG_PER_H
    )
    rows += _vector_rows(
        "accel bias", "ug", estimate.accel_bias / MICRO_G, estimate.accel_bias_sigma / MICRO_G
    )
    return rows


def _attitude_rows(estimate: Estimate, truth: Truth | None) -> Iterator[Row]:
    angles = roll_pitch_heading(estimate.q_nb)
    sigmas = roll_pitch_heading_sigma(estimate)
    known = truth is not None and truth.is_at(estimate.stamp_ns)
    true = roll_pitch_heading(truth.q_nb) if truth is not None and known else (None,) * 3
    for k, name in enumerate(("roll", "pitch", "heading")):
        sigma = float(sigmas[k])
        row = Row(name, f"{angles[k] / DEG:.5f} deg", f"{sigma / ARCMIN:.4f}'")
        true_angle = true[k]
        if true_angle is not None:
            error = math.remainder(angles[k] - true_angle, 2.0 * math.pi)
            row = row._replace(
                truth=f"{true_angle / DEG:.5f} deg",
                error=f"{error / ARCMIN:+.4f}'",
                ratio=_ratio(error, sigma),
            )
        yield row


def _lever_arm_rows(estimate: Estimate, truth: Truth | None) -> Iterator[Row]:
    lever_arm = estimate.lever_arm
    if lever_arm is None:
        return
    for k, axis in enumerate("xyz"):
        value, sigma = float(lever_arm.r_b[k]), math.sqrt(lever_arm.covariance[k, k])
        row = Row(f"lever arm {axis}", f"{value:.6f} m", f"{sigma:.6f} m")
        if not lever_arm.observable[k]:
            row = Row(f"lever arm {axis}", _UNOBSERVABLE, "")
        if truth is not None and truth.lever_arm is not None:
            true = float(truth.lever_arm[k])
            row = row._replace(truth=f"{true:.6f} m")
            if lever_arm.observable[k]:
                error = value - true
                row = row._replace(error=f"{error:+.6f} m", ratio=_ratio(error, sigma))
        yield row


def _vector_rows(name: str, unit: str, values: Array, sigmas: Array) -> Iterator[Row]:
    for axis, value, sigma in zip("xyz", values.tolist(), sigmas.tolist(), strict=True):
        yield Row(f"{name} {axis}", f"{value:.5g} {unit}", f"{sigma:.3g} {unit}")


def _ratio(error: float, sigma: float) -> str:
    return f"{error / sigma:+.2f}" if sigma > 0.0 else ""


def outcome(document: dict[str, Any]) -> str:
    """One line: aligned when, or not and why."""
    if document["aligned"]:
        return f"aligned after {document['aligned_at_s']:.1f} s"
    return f"not aligned ({document['state']}): {document['reason']}"


def footer(document: dict[str, Any]) -> list[str]:
    """Lines on how far the result can be trusted, what went in and how long it took."""
    counts, timing = document["input"], document["timing"]
    lines = []
    if document["heading_limit_arcmin"] is not None:
        lines.append(
            "heading limit of the declared gyro at this latitude"
            f" {document['heading_limit_arcmin']:.4f}'"
        )
    if document["consistency"] is not None:
        lines.append(f"consistency of the innovations {document['consistency']:.3f} (1 is perfect)")
    lines.append(
        f"{counts['imu_samples']} samples over {counts['duration_s']:.3f} s,"
        f" {counts['imu_rejected']} rejected, {counts['imu_gaps']} gaps"
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
    lines = [f"{document['node']}, method {document['method']}: {outcome(document)}"]
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
