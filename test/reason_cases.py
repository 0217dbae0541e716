"""Reasons through real nodes: data that lead to one, data or parameters that mend it."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from node_harness import (
    LATCHED,
    ODO,
    RELIABLE,
    SWING,
    Observer,
    Player,
    arguments,
    diagnostic_values,
    observing,
    running,
)
from rclpy.publisher import Publisher
from reason_drives import Drive
from std_msgs.msg import Bool

from sins_align.reasons import REASONS, Kind
from sins_align.ros.bags_topics import odometer_type
from sins_align.ros.portable_messages import ros_types
from sins_align.types import ImuSamples, Position

BY_KEY = {reason.key: reason for reason in REASONS}
# Between two cases on one node: the second one begins anew.
PAUSE_NS = 2_000_000_000
PLACE = {"latitude_deg": 40.0, "longitude_deg": 116.0, "altitude_m": 50.0}
LOOSE = {"heading_threshold_arcmin": 30.0, "level_threshold_arcsec": 400.0, "hold_s": 2.0}
# One that is refused.
NO_SAMPLE = ImuSamples(np.zeros(1, np.int64), np.full((3, 1), np.nan), np.zeros((3, 1)))
NAMES = {SWING: "swing_align", ODO: "odo_align"}


@dataclass(frozen=True)
class Stage:
    """Data, and the keys of the reasons that stand at their end.

    drive : None: nothing is published
    in_log : they pass while data come, and are looked for in the log
    """

    keys: tuple[str, ...]
    drive: Callable[[], Drive] | None
    in_log: bool = False


@dataclass(frozen=True)
class Case:
    """A few reasons, and what mends them.

    module : of the node; parameters : beside `PLACE` and `LOOSE`
    stages : one after the other
    mended : what is played then, and leads to aligned; None: nothing can
    remedy : parameters by which the node differs that it is played to; none: it is the same node
    """

    name: str
    module: str
    stages: tuple[Stage, ...]
    mended: Callable[[], Drive] | None
    parameters: Mapping[str, object] = field(default_factory=dict)
    remedy: Mapping[str, object] = field(default_factory=dict)

    @property
    def keys(self) -> set[str]:
        return {key for stage in self.stages for key in stage.keys}


class Live:
    """A node that runs, in a namespace of its own, and what it says."""

    def __init__(
        self, stack: ExitStack, module: str, parameters: Mapping[str, object], space: str, log: Path
    ) -> None:
        self.observer: Observer = stack.enter_context(observing())
        self._log = log
        self.name = f"{space}/{NAMES[module]}"
        self._topics = f"/{space}/imu", f"/{space}/odom"
        self._odom_type = "TwistStamped" if module == ODO else None
        self.observer.listen(DiagnosticArray, "/diagnostics", RELIABLE)
        self.observer.listen(Bool, f"/{self.name}/aligned", LATCHED)
        words = [*arguments(dict(parameters)), "-r", f"__ns:=/{space}", "-r", "fix:=/fix"]
        stack.enter_context(running(module, *words, log=log))
        self._player: Player | None = None
        self.shift_ns = 0
        self._end_ns: int | None = None

    def player(self, position: Position | None = None) -> Player:
        """A new one, once the node has answered it: it may know of the node before that of it."""
        player = Player(self.observer, self.name, *self._topics, self._odom_type, position)
        answers: list[Time] = []
        node = self.observer.node
        node.create_subscription(Time, f"/{self.name}/processed", answers.append, RELIABLE)

        def is_answered() -> bool:
            player.burst(NO_SAMPLE)
            return bool(answers)

        self.observer.wait(is_answered, f"{self.name} to answer")
        return player

    def announce(self, odom_type: str) -> Publisher:
        """A publisher of the odometer's topic."""
        message_type = ros_types(odometer_type(odom_type))
        return self.observer.node.create_publisher(message_type, self._topics[1], 10)

    def begin(self, drive: Drive) -> None:
        """The next data are of another time."""
        if self._end_ns is not None:
            self.shift_ns = self._end_ns + PAUSE_NS - int(drive.imu.stamp_ns[0])

    def play(self, drive: Drive, player: Player | None = None) -> None:
        """Publish; returns when the node has taken all of it."""
        if self._player is None:
            self._player = self.player()
        shifted = drive.shifted(self.shift_ns)
        self._end_ns = int(shifted.imu.stamp_ns[-1])
        (player or self._player).play(shifted.imu, shifted.odometer)

    @property
    def seen(self) -> list[DiagnosticStatus]:
        """Its diagnostics so far."""
        found = [message.status[0] for message in self.observer.received["/diagnostics"]]
        return [status for status in found if status.hardware_id == self.name]

    @property
    def is_aligned(self) -> bool:
        said = self.observer.received[f"/{self.name}/aligned"]
        return bool(said) and said[-1].data

    def wait_for(self, stage: Stage) -> None:
        """Play a stage and wait until its reasons are said, with their remedies."""
        begin, log_begin = len(self.seen), len(self._log.read_text())
        if stage.drive is not None:
            self.play(stage.drive())
        texts = [BY_KEY[key].says.partition("{")[0] for key in stage.keys]
        if stage.in_log:
            self.observer.wait(
                lambda: all(text in self._log.read_text()[log_begin:] for text in texts),
                f"{stage.keys} in the log",
            )
            return
        self.observer.wait(lambda: self._saying(begin, stage.keys), f"{stage.keys}")
        status = self._saying(begin, stage.keys)[-1]
        assert status.level != DiagnosticStatus.OK
        values = {entry.key: entry.value for entry in status.values}
        for key, text in zip(stage.keys, texts, strict=True):
            reason = BY_KEY[key]
            assert text in values["reason"]
            assert reason.remedy.partition("{")[0] in values["remedy"]
            assert values["remedy"] or not reason.remedy
            assert reason.kind is Kind.NOTE or not self.is_aligned

    def _saying(self, begin: int, keys: tuple[str, ...]) -> list[DiagnosticStatus]:
        """Diagnostics with all of the keys."""
        found = self.seen[begin:]
        return [s for s in found if set(keys) <= set(_value(s, "reason_keys").split())]

    def align(self, drive: Drive, player: Player | None = None) -> None:
        """Play what leads to aligned, and wait until that is said everywhere."""
        begin = len(self.seen)
        self.play(drive, player)
        self.observer.wait(
            lambda: (
                self.is_aligned
                and any(
                    s.level == DiagnosticStatus.OK and _value(s, "state") == "aligned"
                    for s in self.seen[begin:]
                )
            ),
            f"{self.name} to be aligned; it said {[s.message for s in self.seen[-3:]]}",
        )


def _value(status: DiagnosticStatus, key: str) -> str:
    return diagnostic_values(DiagnosticArray(status=[status]))[key]


class Nodes:
    """Nodes that run, by their parameters: one is started where there is none."""

    def __init__(self, stack: ExitStack, folder: Path) -> None:
        self._stack, self._folder = stack, folder
        self._running: dict[object, Live] = {}

    def start(self, module: str, parameters: Mapping[str, object]) -> Live:
        """A new one with just these parameters."""
        count = len(list(self._folder.iterdir()))
        return Live(self._stack, module, parameters, f"n{count}", self._folder / f"log{count}")

    def get(self, module: str, **parameters: object) -> Live:
        """The one with `PLACE`, `LOOSE` and these."""
        key = (module, *sorted(parameters.items()))
        if key not in self._running:
            self._running[key] = self.start(module, {**PLACE, **LOOSE, **parameters})
        return self._running[key]

    def check(self, case: Case) -> None:
        """Every stage of a case, and the way to aligned."""
        live = self.get(case.module, **case.parameters)
        drives = [*(stage.drive for stage in case.stages), case.mended]
        live.begin(next(drive for drive in drives if drive is not None)())
        for stage in case.stages:
            live.wait_for(stage)
        if case.mended is None:
            return
        mended = case.mended()
        if case.remedy:
            live = self.get(case.module, **{**case.parameters, **case.remedy})
            live.begin(mended)
        live.align(mended)


@contextmanager
def nodes_in(folder: Path) -> Iterator[Nodes]:
    with ExitStack() as stack:
        yield Nodes(stack, folder)
