"""`align_replay` over a bag in whose middle the vehicle drives off and stops again."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("rosbags")

from sins_align.ros import replay_command, simulate_command
from sins_align.ros.bags import open_bag
from sins_align.rotation import dcm_from_quaternion, log_rotation

SETTINGS = [
    "-p", "heading_threshold_arcmin:=30", "-p", "level_threshold_arcsec:=400", "-p", "hold_s:=2",
]  # fmt: skip
SECOND = 1_000_000_000


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """30 m between 60 and 70 s."""
    path = tmp_path_factory.mktemp("bags") / "drive"
    words = "swing --scenario level --grade rlg --seed 1 --rate 50 --duration 130 --quiet"
    drive = "--drive-m 30 --drive-start 60 --drive-duration 10"
    assert simulate_command.main([*f"{words} {drive}".split(), "--out", str(path)]) == 0
    return path


def test_the_drive_is_waited_for_and_the_base_aligned_again(bag: Path, tmp_path: Path) -> None:
    assert replay_command.main(["swing", str(bag), "--out", str(tmp_path), "--bag", *SETTINGS]) == 0
    rows = list(csv.DictReader((tmp_path / "estimates.csv").open()))
    times = np.array([float(row["elapsed_s"]) for row in rows])
    states = np.array([row["state"] for row in rows])
    assert states[times < 60.0][-1] == "aligned"
    moving = (times > 65.0) & (times < 80.0)
    assert moving.sum() >= 10 and set(states[moving]) == {"waiting"}
    assert {row["heading_deg"] for row, moves in zip(rows, moving, strict=True) if moves} == {""}
    with open_bag([tmp_path / "aligned.mcap"]) as aligned:
        stamps = [m.header.stamp for _, m in aligned.read_messages("/swing_align/attitude")]
    document, truth = (
        json.loads(path.read_text()) for path in (tmp_path / "result.json", bag / "truth.json")
    )
    given = np.array([s.sec * SECOND + s.nanosec for s in stamps]) - truth["stamp_ns"]
    assert (given < -70 * SECOND).any() and (given > -10 * SECOND).any()
    assert not ((given > -65 * SECOND) & (given < -50 * SECOND)).any()
    assert document["aligned"] and document["aligned_at_s"] > 80.0
    C_nb, C_true = (dcm_from_quaternion(np.array(d["q_nb_wxyz"])) for d in (document, truth))
    sigma = np.sqrt(np.diag(document["misalignment_covariance_rad2"]))
    assert (np.abs(log_rotation(C_nb @ C_true.T)) < 4.0 * sigma).all()


def test_a_bag_that_ends_in_the_drive_says_so(
    bag: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    words = ["swing", str(bag), "--duration", "68", "--out", str(tmp_path), *SETTINGS]
    assert replay_command.main(words) == 3
    assert "not aligned (waiting): the vehicle moves" in capfd.readouterr().out
    document = json.loads((tmp_path / "result.json").read_text())
    assert (document["aligned"], document["q_nb_wxyz"]) == (False, None)
