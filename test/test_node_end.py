"""End of the nodes: signals in every state, and what stands in the result file then."""

from __future__ import annotations

import json
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("rclpy")

from node_harness import (
    DEADLINE_S,
    ENVIRONMENT,
    ODO,
    SWING,
    SYNTH,
    THRESHOLDS,
    Player,
    arguments,
    observing,
    pitching,
    running,
    stop,
)
from std_srvs.srv import Trigger

pytestmark = [pytest.mark.ros, pytest.mark.slow]

BOTH = pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
EXECUTORS = pytest.mark.parametrize("executor", ["single", "events"])

# A node with five things to wait for; the signal comes when its executor asks the fifth what it
# is, so that some of the node's own are taken up by then, and some are not.
TAKEN_UP = """
import os, signal, sys, time
import rclpy
from rclpy.waitable import NumberOfEntities, Waitable
from sins_align.ros.run_node import prepare_aligner, run_node
from swing_align_ros.node import SwingAlignNode

asked = []

class Signalling(Waitable):
    def get_num_entities(self):
        asked.append(self)
        if len(asked) == 5:
            os.kill(os.getpid(), signal.SIGTERM)
            end = time.monotonic() + 0.5
            while rclpy.ok() and time.monotonic() < end:
                time.sleep(0.01)
        return NumberOfEntities()

    def add_to_wait_set(self, wait_set):
        pass

def make_node():
    node = SwingAlignNode()
    for _ in range(5):
        node.add_waitable(Signalling(node.default_callback_group))
    return node

status = run_node("swing_align", make_node, prepare_aligner)
assert len(asked) == 5, asked
sys.exit(status)
"""


def stop_twice(process: subprocess.Popen[bytes], number: int) -> int:
    """As an impatient operator does."""
    process.send_signal(number)
    return stop(process, number)


def wait_for_the_mask(process: subprocess.Popen[bytes]) -> None:
    """Until the process has got so far that a signal no longer simply ends it."""
    end = time.monotonic() + DEADLINE_S
    while not holds_sigterm(process):
        assert process.poll() is None and time.monotonic() < end
        time.sleep(0.001)


def holds_sigterm(process: subprocess.Popen[bytes]) -> bool:
    """Whether it waits, or is caught where the process is up already."""
    status = Path(f"/proc/{process.pid}/status").read_text()
    masks = dict(line.split(":") for line in status.splitlines() if line.startswith("Sig"))
    return bool((int(masks["SigBlk"], 16) | int(masks["SigCgt"], 16)) >> (signal.SIGTERM - 1) & 1)


def check_log(log: Path) -> None:
    """Nothing that an operator would wonder at."""
    text = log.read_text()
    assert not any(word in text for word in ("Traceback", "Exception", "Failed to publish")), text


@BOTH
@EXECUTORS
@pytest.mark.parametrize("ending", [stop, stop_twice])
@pytest.mark.parametrize("module", [SWING, ODO])
def test_a_signal_at_once_after_the_start(
    tmp_path: Path, module: str, ending: Any, executor: str, number: int
) -> None:
    """Before there is a node, and before its modules are read: it is made, and ends."""
    result, log = tmp_path / "result.json", tmp_path / "log"
    words = arguments({"executor": executor, "result_file": result})
    with running(module, *words, log=log) as process:
        wait_for_the_mask(process)
        assert ending(process, number) == 0
    check_log(log)
    assert json.loads(result.read_text())["state"] == "waiting"


@BOTH
@pytest.mark.parametrize("ending", [stop, stop_twice])
def test_a_signal_at_once_after_the_start_of_the_synthetic_imu(
    tmp_path: Path, ending: Any, number: int
) -> None:
    log = tmp_path / "log"
    with running(SYNTH, *arguments({"duration_s": 1.0}), log=log) as process:
        wait_for_the_mask(process)
        assert ending(process, number) == 0
    check_log(log)


def test_a_signal_while_the_events_executor_takes_the_node_up(tmp_path: Path) -> None:
    """A shutdown in the middle of that made it end by abort()."""
    result = tmp_path / "result.json"
    done = subprocess.run(
        [sys.executable, "-c", TAKEN_UP, *arguments({"executor": "events", "result_file": result})],
        env=ENVIRONMENT, timeout=DEADLINE_S, text=True, capture_output=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert json.loads(result.read_text())["state"] == "waiting"


@BOTH
@EXECUTORS
def test_a_signal_while_it_waits(tmp_path: Path, executor: str, number: int) -> None:
    result, log = tmp_path / "result.json", tmp_path / "log"
    words = arguments({"executor": executor, "result_file": result})
    with observing() as observer, running(SWING, *words, log=log) as process:
        observer.wait_for_diagnostics()
        assert stop_twice(process, number) == 0
    check_log(log)
    document = json.loads(result.read_text())
    assert (document["schema"], document["state"]) == (1, "waiting")
    assert "latitude" in document["reason"]


@BOTH
@EXECUTORS
def test_a_signal_in_the_middle_of_a_burst(tmp_path: Path, executor: str, number: int) -> None:
    """Samples under way, in the queue and half taken in; best effort, so some may get lost."""
    samples = pitching(16.0)
    result, log = tmp_path / "result.json", tmp_path / "log"
    words = arguments({"executor": executor, "result_file": result, "latitude_deg": 40.0})
    with observing() as observer, running(SWING, *words, log=log) as process:
        player = Player(observer)
        player.play(samples.select(slice(0, 500)))
        player.burst(samples.select(slice(500, None)))
        assert stop_twice(process, number) == 0
    check_log(log)
    document = json.loads(result.read_text())
    assert 500 <= document["input"]["imu_samples"] <= len(samples)
    assert document["state"] == "coarse"


def test_signal_while_samples_come_with_the_events_executor(tmp_path: Path) -> None:
    node = {
        "executor": "events", "latitude_deg": 40, "result_file": tmp_path / "result.json",
        "qos_overrides./imu.subscription.depth": 5000,
    }  # fmt: skip
    synth = {
        "rate": 200.0, "duration_s": 60.0, "grade": "perfect", "wait_timeout_s": DEADLINE_S
    }  # fmt: skip
    with (
        observing() as observer,
        running(SWING, *arguments(node), log=tmp_path / "node") as process,
        running(SYNTH, *arguments(synth), log=tmp_path / "synth") as player,
    ):
        observer.wait_for_diagnostics()
        observer.wait(lambda: float(observer.diagnostics()["elapsed_s"]) >= 2.0, "samples")
        assert stop(process, signal.SIGTERM) == 0
        assert stop(player, signal.SIGINT) == 0
    for name in ("node", "synth"):
        assert "Traceback" not in (tmp_path / name).read_text()
    document = json.loads((tmp_path / "result.json").read_text())
    assert document["input"]["imu_samples"] > 400
    assert document["input"]["imu_gaps"] == 0


@pytest.mark.parametrize("saved", [False, True])
def test_a_restart_does_not_throw_a_complete_alignment_away(tmp_path: Path, saved: bool) -> None:
    """Unless the operator has asked for what there is now."""
    result, log = tmp_path / "result.json", tmp_path / "log"
    parameters = {
        **THRESHOLDS, "latitude_deg": 40.0, "imu_grade": "perfect", "result_file": result
    }  # fmt: skip
    with observing() as observer, running(SWING, *arguments(parameters), log=log) as process:
        Player(observer).play(pitching(25.0))
        observer.wait(result.exists, "the result")
        assert observer.call(Trigger, "/swing_align/restart").success
        aligned = json.loads(result.read_text())
        assert aligned["aligned"]
        assert aligned["input"]["imu_samples"] == 1251  # all of them, not those until it was
        if saved:
            assert observer.call(Trigger, "/swing_align/save").success
        assert stop(process, signal.SIGTERM) == 0
    found = json.loads(result.read_text())
    if saved:
        assert (found["aligned"], found["state"], found["q_nb_wxyz"]) == (False, "waiting", None)
    else:
        assert found == aligned
    check_log(log)
    kept = f"{result} keeps the alignment that was complete; the state is waiting"
    assert (kept in log.read_text()) == (not saved)


def test_a_result_that_cannot_be_written_at_the_end_is_no_success(tmp_path: Path) -> None:
    folder, log = tmp_path / "folder", tmp_path / "log"
    folder.mkdir()
    words = arguments({"result_file": folder / "result.json"})
    with observing() as observer, running(SWING, *words, log=log) as process:
        observer.wait_for_diagnostics()
        shutil.rmtree(folder)
        assert stop(process, signal.SIGTERM) == 1
    check_log(log)
    assert (
        log.read_text().splitlines()[-1]
        == f"swing_align: {folder}/result.json: No such file or directory"
    )
