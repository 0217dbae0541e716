"""Reasons through real nodes: data that lead to one, data or parameters that mend it."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from pathlib import Path

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
    stamp_ns,
    stop,
)
from rclpy.publisher import Publisher
from reason_drives import Drive
from std_msgs.msg import Bool

from sins_align.reasons import REASONS, Kind
from sins_align.ros.bags_topics import odometer_type
from sins_align.ros.portable_messages import ros_types
from sins_align.types import Position

BY_KEY = {reason.key: reason for reason in REASONS}
# Between two cases on one node: the second one begins anew.
PAUSE_NS = 2_000_000_000
PLACE = {"latitude_deg": 40.0, "longitude_deg": 116.0, "altitude_m": 50.0}
LOOSE = {
    "heading_threshold_arcmin": 30.0,
    "level_threshold_arcsec": 400.0,
    "hold_s": 2.0,
    "publish_rate_hz": 1.0,
}
# Of the data that have ended, where a busy machine lets time pass.
SILENT = {"imu_silent"}
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
    """A node that runs, in a namespace of its own, and what it says.

    said : diagnostics of all nodes, by their names, with their stamps
    """

    def __init__(
        self, nodes: Nodes, module: str, parameters: Mapping[str, object], space: str
    ) -> None:
        self.observer = nodes.observer
        self.name = f"{space}/{NAMES[module]}"
        self._said = nodes.said[self.name]
        self._topics = f"/{space}/imu", f"/{space}/odom"
        self._odom_type = "TwistStamped" if module == ODO else None
        self._log = nodes.folder / space
        self.observer.listen(Bool, f"/{self.name}/aligned", LATCHED)
        words = [*arguments(dict(parameters)), "-r", f"__ns:=/{space}", "-r", "fix:=/fix"]
        self._process = nodes.stack.enter_context(running(module, *words, log=self._log))
        self._player: Player | None = None
        self.shift_ns = 0
        self._end_ns: int | None = None

    @property
    def log(self) -> str:
        """What it has written so far."""
        return self._log.read_text()

    def end(self) -> None:
        """As with Ctrl-C."""
        assert stop(self._process) == 0, self.log
        assert "Traceback" not in self.log

    def player(self, position: Position | None = None) -> Player:
        """A new one."""
        return Player(self.observer, self.name, *self._topics, self._odom_type, position)

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
    def is_aligned(self) -> bool:
        said = self.observer.received[f"/{self.name}/aligned"]
        return bool(said) and said[-1].data

    def wait_for(self, stage: Stage) -> None:
        """Play a stage and wait until its reasons are said, with their remedies."""
        log_begin = len(self.log)
        if stage.drive is not None:
            self.play(stage.drive())
        texts = [BY_KEY[key].says.partition("{")[0] for key in stage.keys]
        if stage.in_log:
            self.observer.wait(
                lambda: all(text in self.log[log_begin:] for text in texts),
                f"{stage.keys} in the log",
            )
            return
        status = self._said_now(lambda s: set(stage.keys) <= keys_of(s), f"{stage.keys}")
        assert status.level != DiagnosticStatus.OK
        values = values_of(status)
        for key, text in zip(stage.keys, texts, strict=True):
            reason = BY_KEY[key]
            assert text in values["reason"]
            assert reason.remedy.partition("{")[0] in values["remedy"]
            assert values["remedy"] or not reason.remedy
            if reason.kind is not Kind.NOTE:  # another topic, which may come later
                self.observer.wait(lambda: not self.is_aligned, f"not aligned for {key}")

    def align(
        self, drive: Drive, player: Player | None = None, noted: frozenset[str] = frozenset()
    ) -> None:
        """Play what leads to aligned, and wait until that is said everywhere.

        noted : the reasons that are said all the same
        """
        self.play(drive, player)

        def is_it(status: DiagnosticStatus) -> bool:
            keys = keys_of(status)
            return (
                self.is_aligned
                and values_of(status)["state"] == "aligned"
                and keys - SILENT == noted
                and (status.level == DiagnosticStatus.OK) == (not keys)
            )

        self._said_now(is_it, "to be aligned")

    def _said_now(self, is_it: Callable[[DiagnosticStatus], bool], what: str) -> DiagnosticStatus:
        """Diagnostics from now on that are as wanted: what was said before is of old data."""
        now_ns = self.observer.node.get_clock().now().nanoseconds
        found: list[DiagnosticStatus] = []

        def is_said() -> bool:
            found[:] = [s for stamp, s in self._said if stamp >= now_ns and is_it(s)]
            return bool(found)

        try:
            self.observer.wait(is_said, what)
        except AssertionError as error:
            last = [(s.message, values_of(s)["reason_keys"]) for _, s in self._said[-3:]]
            raise AssertionError(f"{error}; {self.name} said {last}") from None
        return found[-1]


def values_of(status: DiagnosticStatus) -> dict[str, str]:
    return diagnostic_values(DiagnosticArray(status=[status]))


def keys_of(status: DiagnosticStatus) -> set[str]:
    """Of the reasons."""
    return set(values_of(status)["reason_keys"].split())


class Nodes:
    """Nodes that run, by their parameters: one is started where there is none."""

    def __init__(self, stack: ExitStack, folder: Path) -> None:
        self.stack, self.folder = stack, folder
        self.observer: Observer = stack.enter_context(observing())
        self.said: dict[str, list[tuple[int, DiagnosticStatus]]] = defaultdict(list)
        self._running: dict[object, Live] = {}
        self._count = 0
        self.observer.node.create_subscription(
            DiagnosticArray, "/diagnostics", self._on_diagnostics, RELIABLE
        )

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        (status,) = message.status
        self.said[status.hardware_id].append((stamp_ns(message), status))

    def start(self, module: str, parameters: Mapping[str, object]) -> Live:
        """A new one with just these parameters."""
        self._count += 1
        return Live(self, module, parameters, f"n{self._count}")

    def get(self, module: str, **parameters: object) -> Live:
        """The one with `PLACE`, `LOOSE` and these."""
        parameters = {**PLACE, **LOOSE, **parameters}
        key = (module, *sorted(parameters.items()))
        if key not in self._running:
            self._running[key] = self.start(module, parameters)
        return self._running[key]

    def check(self, cases: Sequence[Case], number: int) -> None:
        """Every stage of a case, and the way to aligned; the next one's nodes start meanwhile."""
        pairs = [self._nodes_of(case) for case in cases[number : number + 2]]
        case, (live, mending) = cases[number], pairs[0]
        drives = [*(stage.drive for stage in case.stages), case.mended]
        live.begin(next(drive for drive in drives if drive is not None)())
        for stage in case.stages:
            live.wait_for(stage)
        if case.mended is None:
            return
        mended = case.mended()
        if mending is not live:
            mending.begin(mended)
        mending.align(mended)

    def _nodes_of(self, case: Case) -> tuple[Live, Live]:
        """For its stages, and for what mends it."""
        remedied = {**case.parameters, **case.remedy}
        return self.get(case.module, **case.parameters), self.get(case.module, **remedied)


@contextmanager
def nodes_in(folder: Path) -> Iterator[Nodes]:
    with ExitStack() as stack:
        yield Nodes(stack, folder)
