"""The command `align_simulate`."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rosbags")

from sins_align.ros import simulate_command
from sins_align.ros.bags import open_bag
from sins_align.ros.simulation_options import SIMULATION_PARAMETERS, swing_options
from sins_align.simulate import SwingOptions, simulate_swing

SHORT = ["swing", "--rate", "50", "--duration", "3"]


@pytest.fixture
def simulate(capfd: pytest.CaptureFixture[str]) -> Any:
    def run(*words: object) -> tuple[int, str, str]:
        try:
            status = simulate_command.main([str(word) for word in words])
        except SystemExit as leaving:  # argparse
            status = int(leaving.code or 0)
        return status, *capfd.readouterr()

    return run


def test_bag_and_truth(simulate: Any, tmp_path: Path) -> None:
    out = tmp_path / "bag"
    options = ["--grade", "fog", "--seed", 7, "--lever-arm", 1, -2, 3, "--latitude-deg", -33]
    status, said, complaint = simulate(*SHORT, *options, "--out", out)
    assert (status, complaint) == (0, "")
    assert str(out) in said
    expected = simulate_swing(
        SwingOptions(
            grade="fog", seed=7, rate_hz=50.0, duration_s=3.0, lever_arm_m=(1.0, -2.0, 3.0),
            latitude_deg=-33.0,
        )
    )  # fmt: skip
    with open_bag([out]) as bag:
        (samples,) = bag.read_imu("/imu")
        position = bag.read_fix("/fix")
    for found, made in zip(samples, expected.imu, strict=True):
        np.testing.assert_array_equal(found, made)
    assert position is not None
    assert np.degrees(position.latitude) == pytest.approx(-33.0)
    assert json.loads((out / "truth.json").read_text()) == expected.truth.truth_dict()


def test_every_setting_of_the_simulator_is_an_option() -> None:
    defaults = {name: entry.default for name, entry in SIMULATION_PARAMETERS.items()}
    options = swing_options(defaults)
    assert dataclasses.replace(options, grade="paper_swing") == SwingOptions()
    # The stamp of the first sample has no option.
    assert len(defaults) == len(dataclasses.fields(SwingOptions)) - 1


@pytest.mark.parametrize(
    ("words", "says"),
    [
        ([], "required"),
        (["odo", "--out", "OUT"], "odo"),
        (["swing"], "--out"),
        ([*SHORT, "--out", "OUT", "--scenario", "storm"], "pitch, erect"),
        ([*SHORT, "--out", "OUT", "--grade", "gold"], "tactical"),
        ([*SHORT, "--out", "OUT", "--latitude-deg", "91"], "latitude_deg"),
        ([*SHORT, "--out", "OUT", "--seed", "1.5"], "seed"),
        (["swing", "--rate", "1e5", "--duration", "1e6", "--out", "OUT"], "1e+11 samples"),
        ([*SHORT, "--out", "OUT", "--jitter", "0.5"], "stamp_jitter_s"),
        ([*SHORT, "--out", "OUT", "--storage", "tape"], "tape"),
        ([*SHORT, "--out", "."], "exists"),
        ([*SHORT, "--out", "/dev/null/x"], "/dev/null/x"),
    ],
)
def test_unusable_is_one_line_and_status_2(
    simulate: Any, tmp_path: Path, words: list[str], says: str
) -> None:
    out = tmp_path / "out"
    status, said, complaint = simulate(*(word.replace("OUT", str(out)) for word in words))
    assert (status, said) == (2, "")
    (line,) = complaint.splitlines()
    assert says in line
    assert not out.exists()
