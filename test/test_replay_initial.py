"""`align_replay` with `initial_result_file`: from one bag's result into the next bag."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("rosbags")

from sins_align.ros import replay_command, simulate_command

SWING = ["-p", "heading_threshold_arcmin:=2", "-p", "hold_s:=5"]
ODO = [
    "-p", "imu_grade:=fog", "-p", "heading_threshold_arcmin:=10", "-p", "hold_s:=5",
    "-p", "level_threshold_arcsec:=60", "-p", "aiding:=stationary",
]  # fmt: skip
KINDS = {"swing": (["--scenario", "still"], SWING), "odo": (["--scenario", "static"], ODO)}

Run = Callable[..., dict[str, Any]]


@pytest.fixture(scope="module", params=KINDS)
def bags(request: Any, tmp_path_factory: pytest.TempPathFactory) -> tuple[str, Path, Path]:
    """The kind, and two bags of a base in one place: 200 s, and 60 s on another day."""
    folder = tmp_path_factory.mktemp(request.param)
    words = [request.param, *KINDS[request.param][0], "--rate", "50", "--quiet"]
    if request.param == "swing":
        words += ["--grade", "rlg"]
    else:
        words += ["--heading-deg", "70", "--ground-roll-deg", "1", "--ground-pitch-deg", "0.5"]
    for seed, duration in ((1, 200), (2, 60)):
        out = ["--seed", seed, "--duration", duration, "--out", folder / str(seed)]
        assert simulate_command.main([*words, *map(str, out)]) == 0
    return request.param, folder / "1", folder / "2"


def run(kind: str, bag: Path, out: Path, *words: str) -> tuple[int, dict[str, Any]]:
    arguments = [kind, bag, "--out", out, "--bag", "--quiet", *KINDS[kind][1], *words]
    status = replay_command.main([str(word) for word in arguments])
    return status, json.loads((out / "result.json").read_text())


def test_a_stored_alignment_is_aligned_far_sooner(
    bags: tuple[str, Path, Path], tmp_path: Path
) -> None:
    kind, first, second = bags
    status, stored = run(kind, first, tmp_path / "first")
    assert status == 0 and stored["aligned_at_s"] > 70.0
    status, fresh = run(kind, second, tmp_path / "fresh")
    assert status == 3 and not fresh["aligned"]
    initial = f"initial_result_file:={tmp_path / 'first' / 'result.json'}"
    status, resumed = run(kind, second, tmp_path / "resumed", "-p", initial)
    assert status == 0 and resumed["aligned_at_s"] < 40.0
    rows = (tmp_path / "resumed" / "estimates.csv").read_text().splitlines()
    assert len(rows) > 30
    status, again = run(  # what it wrote can be gone on from in its turn
        kind, second, tmp_path / "again", "-p",
        f"initial_result_file:={tmp_path / 'resumed' / 'result.json'}",
    )  # fmt: skip
    assert status == 0 and again["heading_deg"] == pytest.approx(stored["heading_deg"], abs=0.02)


def test_a_result_that_is_not_aligned_is_one_line_and_status_2(
    bags: tuple[str, Path, Path], tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    kind, _, second = bags
    run(kind, second, tmp_path / "fresh")
    result = tmp_path / "fresh" / "result.json"
    words = [kind, str(second), "-p", f"initial_result_file:={result}", *KINDS[kind][1]]
    capfd.readouterr()
    assert replay_command.main(words) == 2
    (line,) = capfd.readouterr().err.splitlines()
    assert f"initial_result_file: {result}: aligned" in line
