"""A stored alignment: what of a result file can be gone on from.

Only the attitude and its covariance are taken. The gyro bias is not: a gyro that was switched
off between the runs has another one, and sigma in the file says nothing of that. What the
grade declares covers both, so that the file's bias would add nothing honest.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from sins_align.grades import ConfigError
from sins_align.types import Array

SCHEMA = 1  # of result.json
# A quaternion that has gone through text has a length of 1 to 1e-15; one that was typed, less.
UNIT_TOLERANCE = 1e-6
# Covariances: of rounding where they should be symmetric, and of any sigma at all [rad].
SYMMETRY_TOLERANCE = 1e-9
LEAST_SIGMA, GREATEST_SIGMA = 1e-12, 1.0

QUATERNION = "q_nb_wxyz"
COVARIANCE = "misalignment_covariance_rad2"


@dataclass(frozen=True, eq=False)
class StoredAlignment:
    """The attitude that an earlier run ended with.

    q_nb : (4,) Hamilton, scalar first, of unit length
    misalignment_covariance : (3, 3) of phi, axes east, north, up [rad^2]
    """

    q_nb: Array
    misalignment_covariance: Array


def read_stored_alignment(path: Path) -> StoredAlignment:
    """The alignment in a result file.

    Raises
    ------
    ConfigError : no such file, no JSON, or as `stored_alignment`; names the file
    """
    try:
        document: object = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read: {error.strerror}") from None
    except (ValueError, RecursionError):  # no UTF-8, no JSON, or brackets without end
        raise ConfigError(f"{path}: no valid JSON: a result.json is expected") from None
    if not isinstance(document, dict):
        raise ConfigError(f"{path}: not a result.json (a map of keys is expected)")
    try:
        return stored_alignment(document)
    except ConfigError as error:
        raise ConfigError(f"{path}: {error}") from None


def stored_alignment(document: Mapping[str, Any]) -> StoredAlignment:
    """The alignment in the content of a result.json.

    Raises
    ------
    ConfigError : another schema, not aligned, or no attitude with a covariance; names the key
    """
    schema = document.get("schema")
    if isinstance(schema, bool) or schema != SCHEMA:
        raise ConfigError(f"schema: {schema!r} is not {SCHEMA}: another version wrote the file")
    if document.get("aligned") is not True:
        raise ConfigError(f"aligned: {document.get('aligned')!r}: the run did not get that far")
    q_nb = _numbers(document, QUATERNION, (4,))
    length = float(np.linalg.norm(q_nb))
    if not abs(length - 1.0) < UNIT_TOLERANCE:
        raise ConfigError(f"{QUATERNION}: a length of {length:.9g} is not that of a rotation")
    return StoredAlignment(q_nb / length, _covariance(document))


def _covariance(document: Mapping[str, Any]) -> Array:
    P = _numbers(document, COVARIANCE, (3, 3))
    sigma = np.sqrt(P.diagonal().clip(min=0.0))
    if not (sigma.min() >= LEAST_SIGMA and sigma.max() <= GREATEST_SIGMA):
        raise ConfigError(f"{COVARIANCE}: no variances of angles on its diagonal")
    correlation = P / np.outer(sigma, sigma)
    if np.abs(correlation - correlation.T).max() > SYMMETRY_TOLERANCE:
        raise ConfigError(f"{COVARIANCE}: not symmetric")
    if not np.linalg.eigvalsh(correlation).min() > 0.0:
        raise ConfigError(f"{COVARIANCE}: not positive definite")
    symmetric: Array = 0.5 * (P + P.T)
    return symmetric


def _numbers(document: Mapping[str, Any], key: str, shape: tuple[int, ...]) -> Array:
    """The numbers under `key`: no texts, no booleans, none that is missing or not finite."""
    form = " x ".join(map(str, shape))
    try:
        values = np.array(document.get(key), dtype=object)
    except ValueError:  # rows of several lengths
        values = np.empty(0, dtype=object)
    plain = all(isinstance(x, int | float) and not isinstance(x, bool) for x in values.flat)
    if values.shape != shape or not plain:
        raise ConfigError(f"{key}: {form} numbers are expected")
    try:
        numbers = values.astype(np.float64)
    except OverflowError:
        numbers = np.full(shape, np.inf)
    if not np.isfinite(numbers).all():
        raise ConfigError(f"{key}: not all of the {form} numbers are finite")
    return numbers
