"""Nodes that go on from the result of an earlier one, from outside; swaying and turned, too."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("rclpy")

from node_harness import ODO, SWING
from reason_cases import LOOSE, PLACE, Live, Nodes, Stage, nodes_in
from reason_drives import Drive, Rocking, swing, vehicle

pytestmark = [pytest.mark.ros, pytest.mark.slow]

BESIDE = {"stored_check", "stored_confirm", "stored_dropped"}
DROPPED = frozenset({"stored_dropped"})


def base(duration_s: float, seed: int, **changes: Any) -> Drive:
    return swing(duration_s, scenario="still", seed=seed, **changes)


def parked(duration_s: float, seed: int) -> Drive:
    place = {"heading_deg": 70.0, "ground_roll_deg": 1.0, "ground_pitch_deg": 0.5}
    return vehicle("static", duration_s, seed=seed, **place)


SETTINGS: dict[str, dict[str, Any]] = {
    SWING: {"heading_threshold_arcmin": 6.0},
    ODO: {"heading_threshold_arcmin": 12.0, "imu_grade": "fog"},
}
DRIVES: dict[str, Callable[[float, int], Drive]] = {SWING: base, ODO: parked}


@dataclass
class Runs:
    """Nodes, and for each kind the result of one that has ended."""

    nodes: Nodes
    folder: Path
    results: dict[str, Path] = field(default_factory=dict)

    def start(self, module: str, **parameters: object) -> Live:
        return self.nodes.start(module, {**PLACE, **LOOSE, **SETTINGS[module], **parameters})

    def result(self, module: str) -> Path:
        """From nothing to aligned."""
        if module not in self.results:
            path = self.results[module] = self.folder / f"{module}.json"
            live = self.start(module, result_file=path)
            live.align(DRIVES[module](80.0, 1))
            live.end()
        return self.results[module]


def read(path: Path) -> dict[str, Any]:
    document: dict[str, Any] = json.loads(path.read_text())
    return document


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Runs]:
    folder = tmp_path_factory.mktemp("stored")
    with nodes_in(tmp_path_factory.mktemp("logs")) as nodes:
        yield Runs(nodes, folder)


@pytest.mark.parametrize("module", [SWING, ODO])
def test_a_node_that_goes_on_from_its_own_result_is_aligned_far_sooner(
    module: str, runs: Runs, tmp_path: Path
) -> None:
    """It ends in the middle of the check first: what it went on from is still there."""
    first = read(runs.result(module))
    path = Path(shutil.copy(runs.result(module), tmp_path))
    again = DRIVES[module](45.0, 2)
    own = {"result_file": path, "initial_result_file": path}
    stopped = runs.start(module, **own)
    stopped.wait_for(Stage(("stored_check",), lambda: again.part(0.0, 15.0)))
    stopped.end()
    assert f"{path} keeps the alignment that was complete" in stopped.log
    assert read(path) == first
    live = runs.start(module, **own)
    live.align(again)
    live.end()
    second = read(path)
    assert first["aligned"] and first["aligned_at_s"] > 50.0
    assert second["aligned"] and second["aligned_at_s"] < 40.0
    assert second["heading_deg"] == pytest.approx(first["heading_deg"], abs=0.02)


def test_a_base_that_sways_has_to_wait_for_the_new_alignment(runs: Runs) -> None:
    """Which a centre that is said to move keeps from knowing heading in the same half minute."""
    live = runs.start(SWING, initial_result_file=runs.result(SWING), position_noise_m=0.01)
    drive = swing(80.0, scenario=Rocking(angle_deg=0.2, until_s=40.0), seed=2)
    live.wait_for(Stage(("stored_confirm",), lambda: drive.part(0.0, 37.0)))
    live.align(drive.part(37.0))  # still from 40 s on


def test_a_base_that_has_been_turned_is_aligned_by_itself(runs: Runs) -> None:
    live = runs.start(SWING, initial_result_file=runs.result(SWING))
    drive = base(75.0, 2, heading_deg=2.0)
    live.wait_for(Stage(("stored_dropped",), lambda: drive.part(0.0, 40.0)))
    live.align(drive.part(40.0), noted=DROPPED)
    # And with what the remedy says nothing is left to be said.
    cleared = runs.start(SWING)
    cleared.align(drive)
