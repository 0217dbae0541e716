"""Parameters of a running node: descriptions, changes, refusals."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("rclpy")

from geometry_msgs.msg import PoseWithCovarianceStamped
from node_harness import (
    LATCHED,
    RELIABLE,
    SWING,
    Observer,
    Player,
    arguments,
    observing,
    pitching,
    running,
    stamp_ns,
)
from rcl_interfaces.msg import SetParametersResult
from rcl_interfaces.srv import (
    DescribeParameters,
    GetParameters,
    ListParameters,
    SetParameters,
    SetParametersAtomically,
)
from rclpy.parameter import Parameter
from sensor_msgs.msg import Imu
from std_msgs.msg import Bool

from sins_align.config_path import shipped_config
from sins_align.parameters import parameters_of

pytestmark = [pytest.mark.ros, pytest.mark.slow]

TABLE = parameters_of("swing_align")
RUNTIME = {
    "heading_threshold_arcmin", "level_threshold_arcsec", "hold_s", "publish_rate_hz",
    "nav_frame", "result_file", "latitude_check",
}  # fmt: skip


def messages(changes: dict[str, Any]) -> list[Any]:
    return [Parameter(name, value=value).to_parameter_msg() for name, value in changes.items()]


def set_each(observer: Observer, **changes: Any) -> list[SetParametersResult]:
    """One result for each, in their order."""
    request = SetParameters.Request(parameters=messages(changes))
    return observer.call(SetParameters, "/swing_align/set_parameters", request).results


def set_all(observer: Observer, **changes: Any) -> SetParametersResult:
    """All or none."""
    request = SetParametersAtomically.Request(parameters=messages(changes))
    name = "/swing_align/set_parameters_atomically"
    return observer.call(SetParametersAtomically, name, request).result


def get(observer: Observer, *names: str) -> list[Any]:
    request = GetParameters.Request(names=names)
    found = observer.call(GetParameters, "/swing_align/get_parameters", request).values
    return [Parameter.from_parameter_msg(_named(value)).value for value in found]


def _named(value: Any) -> Any:
    message = Parameter("any", value=0).to_parameter_msg()
    message.value = value
    return message


# This one first: the idle node of the others has the same name.


def test_changes_take_effect_in_the_running_alignment_and_lose_nothing(tmp_path: Path) -> None:
    """Thresholds out of reach, then within; rate, frame and file, too."""
    imu = pitching(56.0)
    parameters = {
        "latitude_deg": 40.0, "imu_grade": "perfect", "publish_rate_hz": 10.0, "hold_s": 2.0,
        "heading_threshold_arcmin": 1e-5,
    }  # fmt: skip
    log, result = tmp_path / "log", tmp_path / "result.json"
    with observing() as observer, running(SWING, *arguments(parameters), log=log):
        observer.listen(Imu, "/swing_align/attitude", RELIABLE, "attitude")
        observer.listen(
            PoseWithCovarianceStamped, "/swing_align/misalignment", RELIABLE, "misalignment"
        )
        observer.listen(Bool, "/swing_align/aligned", LATCHED, "aligned")
        player = Player(observer)
        player.play(imu.select(slice(0, 1500)))
        aligned = observer.received["aligned"]
        observer.wait(lambda: aligned, "aligned")
        assert [message.data for message in aligned] == [False]
        changes = {
            "heading_threshold_arcmin": 90.0, "level_threshold_arcsec": 300, "hold_s": 1,
            "publish_rate_hz": 5.0, "nav_frame": "enu", "result_file": str(result),
        }  # fmt: skip
        answer = set_all(observer, **changes)
        assert answer.successful, answer.reason
        assert not result.exists()
        player.play(imu.select(slice(1500, 2201)))
        observer.wait(lambda: result.exists(), "the result")
        last_ns = int(imu.stamp_ns[2200])
        for name in ("attitude", "misalignment"):
            observer.wait_for_stamp(name, last_ns)
        observer.wait(lambda: aligned[-1].data, "aligned")
        document = json.loads(result.read_text())
        assert document["aligned"]
        # Two estimates later: all that came before counts on.
        assert 30.0 < document["aligned_at_s"] < 38.0
        assert document["input"]["imu_samples"] > 1500
        stamps = [stamp_ns(message) for message in observer.received["attitude"]]
        steps = {b - a for a, b in pairwise(stamps) if a > stamps[-20]}
        assert steps == {200_000_000}
        frames = [message.header.frame_id for message in observer.received["misalignment"]]
        assert frames == sorted(frames, reverse=True) and set(frames) == {"map", "enu"}
        # Out of reach again.
        assert set_all(observer, heading_threshold_arcmin=1e-5).successful
        player.play(imu.select(slice(2201, None)))
        observer.wait(lambda: not aligned[-1].data, "aligned taken back")
    text = log.read_text()
    assert text.count("parameters set: ") == 2
    assert "anew" not in text and "Traceback" not in text


@pytest.fixture(scope="module")
def idle(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Observer]:
    """An idle node, started from the shipped parameter file."""
    log = tmp_path_factory.mktemp("parameters") / "log"
    file = str(shipped_config("swing_align.yaml"))
    with observing() as observer, running(SWING, "--ros-args", "--params-file", file, log=log):
        observer.wait_for_diagnostics()
        yield observer
        assert "Traceback" not in log.read_text()


def test_parameters_are_described_and_read_only_where_they_cannot_change(idle: Observer) -> None:
    listed = idle.call(ListParameters, "/swing_align/list_parameters")
    assert set(TABLE) <= set(listed.result.names)
    names = [name for name in listed.result.names if name in TABLE]
    answer = idle.call(
        DescribeParameters,
        "/swing_align/describe_parameters",
        DescribeParameters.Request(names=names),
    )
    for descriptor in answer.descriptors:
        entry = TABLE[descriptor.name]
        assert descriptor.description == entry.description
        assert descriptor.read_only == (descriptor.name not in RUNTIME)
        assert descriptor.additional_constraints == entry.range_text()
        number = isinstance(entry.default, float) and not math.isnan(entry.default)
        if number and math.isfinite(entry.low):
            (bounds,) = descriptor.floating_point_range
            assert (bounds.from_value, bounds.to_value) == (entry.low, entry.high)


def test_a_change_of_what_cannot_change_is_refused_with_the_remedy(idle: Observer) -> None:
    for name in sorted(set(TABLE) - RUNTIME):
        default = TABLE[name].default
        (result,) = set_each(idle, **{name: default})
        assert not result.successful
        assert result.reason.startswith(f"{name}: cannot change while the node runs")
        assert "restart the node" in result.reason


@pytest.mark.parametrize(
    ("name", "value", "words"),
    [
        ("hold_s", -1.0, ["-1.0 is outside [0, 3600]"]),
        ("hold_s", math.nan, ["nan is outside"]),
        ("hold_s", "soon", ["'soon'", "number"]),
        ("hold_s", True, ["True", "number"]),
        ("hold_s", [1.0, 2.0], ["number"]),
        ("hold_s", None, ["None", "number"]),
        ("publish_rate_hz", 0, ["0 is outside [0.1, 1000]"]),
        ("nav_frame", 7, ["7 is not a text"]),
        ("result_file", "/dev/null/result.json", ["/dev/null/result.json: Not a directory"]),
        ("result_file", "/", ["/: Is a directory"]),
        ("holds_s", 3.0, ["unknown parameter of swing_align"]),
    ],
)
def test_a_wrong_value_is_refused_in_the_words_of_the_start(
    idle: Observer, name: str, value: Any, words: list[str]
) -> None:
    before = get(idle, *RUNTIME)
    (result,) = set_each(idle, **{name: value})
    assert not result.successful
    assert name in result.reason or "result_file" in name
    assert all(word in result.reason for word in words), result.reason
    assert get(idle, *RUNTIME) == before


def test_a_whole_number_is_good_for_a_real_one_as_at_the_start(idle: Observer) -> None:
    """rclpy by itself refuses an integer for a parameter of type double."""
    (result,) = set_each(idle, hold_s=3)
    assert result.successful, result.reason
    (value,) = get(idle, "hold_s")
    assert (value, type(value)) == (3.0, float)


def test_off_may_be_set_without_quotes_as_at_the_start(idle: Observer) -> None:
    """`ros2 param set` reads it as YAML does: false."""
    (result,) = set_each(idle, latitude_check=False)
    assert result.successful, result.reason
    assert get(idle, "latitude_check") == ["off"]


def test_several_change_all_or_none_and_each_by_itself_where_ros_says_so(idle: Observer) -> None:
    before = get(idle, "hold_s", "nav_frame")
    result = set_all(idle, hold_s=7.5, nav_frame="enu", level_threshold_arcsec=-3.0)
    assert not result.successful and "level_threshold_arcsec" in result.reason
    result = set_all(idle, hold_s=7.5, use_sim_time="yes")  # refused by rclpy
    assert not result.successful
    assert get(idle, "hold_s", "nav_frame") == before
    assert set_all(idle, hold_s=7.5, nav_frame="enu").successful
    assert get(idle, "hold_s", "nav_frame") == [7.5, "enu"]
    results = set_each(idle, hold_s=8.5, executor="events", nav_frame="map")
    assert [result.successful for result in results] == [True, False, True]
    assert get(idle, "hold_s", "nav_frame", "executor") == [8.5, "map", "single"]
