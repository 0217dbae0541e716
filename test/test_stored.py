"""What of a result file is gone on from, and what is refused."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from sins_align.config import ConfigError, odo_config, swing_config
from sins_align.stored import COVARIANCE, QUATERNION, read_stored_alignment, stored_alignment

P = [[1e-9, 2e-10, 0.0], [2e-10, 1e-9, 3e-10], [0.0, 3e-10, 1e-6]]
GOOD = {"schema": 1, "aligned": True, QUATERNION: [0.5, -0.5, 0.5, 0.5], COVARIANCE: P}


def test_what_is_taken() -> None:
    stored = stored_alignment({**GOOD, "gyro_bias_rad_s": None, "anything": "else"})
    assert stored.q_nb.tolist() == [0.5, -0.5, 0.5, 0.5]
    assert stored.misalignment_covariance.tolist() == P


def test_rounding_is_forgiven() -> None:
    q = [0.5 + 1e-8, -0.5, 0.5, 0.5]
    stored = stored_alignment({**GOOD, QUATERNION: q})
    assert np.linalg.norm(stored.q_nb) == pytest.approx(1.0, abs=1e-15)


def changed(row: int, column: int, value: object) -> list[list[Any]]:
    table: list[list[Any]] = [list(line) for line in P]
    table[row][column] = value
    return table


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("schema", 2),
        ("schema", "1"),
        ("schema", True),
        ("schema", None),
        ("aligned", False),
        ("aligned", "true"),
        ("aligned", 1),
        ("aligned", None),
        (QUATERNION, None),
        (QUATERNION, [0.5, 0.5, 0.5]),
        (QUATERNION, [[0.5, 0.5], [0.5, 0.5]]),
        (QUATERNION, [0.5, 0.5, 0.5, "0.5"]),
        (QUATERNION, [1.0, 0.0, 0.0, False]),
        (QUATERNION, [0.5, 0.5, 0.5, None]),
        (QUATERNION, [0.5, 0.5, 0.5, math.nan]),
        (QUATERNION, [0.5, 0.5, 0.5, 10**400]),
        (QUATERNION, [0.5, 0.5, 0.5, 0.6]),
        (QUATERNION, [0.0, 0.0, 0.0, 0.0]),
        (COVARIANCE, None),
        (COVARIANCE, P[:2]),
        (COVARIANCE, [[1.0], [1.0, 2.0], [3.0]]),
        (COVARIANCE, changed(0, 1, None)),
        (COVARIANCE, changed(0, 1, math.inf)),
        (COVARIANCE, changed(0, 1, -2e-10)),  # not symmetric
        (COVARIANCE, changed(2, 2, 0.0)),
        (COVARIANCE, changed(2, 2, -1e-6)),
        (COVARIANCE, changed(2, 2, 50.0)),
        (COVARIANCE, [[1e-9, 1.1e-9, 0.0], [1.1e-9, 1e-9, 0.0], [0.0, 0.0, 1e-6]]),
    ],
)
def test_what_is_not_usable_is_refused_by_name(key: str, value: object) -> None:
    with pytest.raises(ConfigError, match=f"^{key}: ") as refused:
        stored_alignment({**GOOD, key: value})
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize("key", list(GOOD))
def test_what_is_missing_is_named(key: str) -> None:
    with pytest.raises(ConfigError, match=f"^{key}: "):
        stored_alignment({name: value for name, value in GOOD.items() if name != key})


@pytest.mark.parametrize("config", [swing_config, odo_config])
def test_the_parameter_reads_the_file(config: Callable[..., Any], tmp_path: Path) -> None:
    path = tmp_path / "result.json"
    path.write_text(json.dumps(GOOD))
    assert config({"initial_result_file": str(path)}).initial.q_nb[1] == -0.5
    assert config({"initial_result_file": ""}).initial is None


@pytest.mark.parametrize(
    ("content", "word"),
    [
        (b"{", "JSON"),
        (b"\xff\xfe", "JSON"),
        (b"[" * 100_000, "JSON"),
        (b"[1, 2]", "map"),
        (b"{}", "schema"),
        (json.dumps({**GOOD, "aligned": False}).encode(), "aligned"),
    ],
)
def test_a_bad_file_is_one_line_that_names_it(content: bytes, word: str, tmp_path: Path) -> None:
    path = tmp_path / "result.json"
    path.write_bytes(content)
    with pytest.raises(ConfigError) as refused:
        swing_config({"initial_result_file": str(path)})
    line = str(refused.value)
    assert line.startswith(f"initial_result_file: {path}: ")
    assert word in line and "\n" not in line


def test_a_missing_file_and_a_folder(tmp_path: Path) -> None:
    for path in (tmp_path / "none.json", tmp_path):
        with pytest.raises(ConfigError, match="cannot be read"):
            read_stored_alignment(path)
