"""The command `align_replay`: align over a bag, as fast as the machine goes."""

from __future__ import annotations

import argparse
import os
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

# Small matrices: threads cost more than they bring. It counts before numpy is imported.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from sins_align.ros.command import ALIGNED, NOT_ALIGNED, Parser, run_command, say

NAME = "align_replay"
NODES = {"swing": "swing_align", "odo": "odo_align"}
_MAX_SECONDS = 1e9  # in nanoseconds it must fit into 64 bits
POSITION = ("latitude_deg", "longitude_deg", "altitude_m")

EPILOG = """\
exit status: 0 aligned, 3 the bag ended before the alignment was complete (the results so
far are written), 2 bad usage, configuration or input, 1 a bug"""


def main(args: Sequence[str] | None = None) -> int:
    """Run the command; returns its exit status."""
    begin = time.perf_counter()
    parser = _parser()
    options = parser.parse_args(args)
    if options.bag and options.out is None:
        parser.error("--bag needs --out DIR")
    return run_command(NAME, lambda: _replay(options, begin))


def _parser() -> argparse.ArgumentParser:
    parser = Parser(
        prog=NAME, description="Align over recorded data: the same estimation as the live node.",
        epilog=EPILOG, formatter_class=argparse.RawDescriptionHelpFormatter,
    )  # fmt: skip
    kinds = parser.add_subparsers(dest="kind", required=True, metavar="|".join(NODES))
    for name, what in (
        ("swing", "on a swinging or still base"),
        ("odo", "on a vehicle with an odometer"),
    ):
        kind = kinds.add_parser(
            name, help=f"{what}, as the node {NODES[name]}", epilog=EPILOG,
            description=f"Align {what}, as the node {NODES[name]} does.",
            formatter_class=argparse.RawDescriptionHelpFormatter,
        )  # fmt: skip
        _add_input_options(kind)
        if name == "odo":
            kind.add_argument("--odom-topic", metavar="T", help="needed where there are several")
        kind.set_defaults(odom_topic=None)
        _add_output_options(kind)
    return parser


def _add_input_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "bags", nargs="+", type=Path, metavar="BAG",
        help="rosbag2 folder, .mcap, .db3 or ROS 1 .bag; several are read as one",
    )  # fmt: skip
    parser.add_argument("--params", type=Path, metavar="FILE.yaml", help="ROS 2 parameter file")
    parser.add_argument(
        "-p", "--param", dest="overrides", action="append", default=[], metavar="NAME:=VALUE",
        help="one parameter, over those of the file; may be repeated",
    )  # fmt: skip
    parser.add_argument("--imu-topic", metavar="T", help="needed where there are several")
    parser.add_argument("--fix-topic", metavar="T", help="needed where there are several")
    for name, help_text in zip(
        POSITION, ("else parameter latitude_deg, else the first valid fix", "", ""), strict=True
    ):
        unit = name.rpartition("_")[2].upper()
        option = "--" + name.replace("_", "-")
        parser.add_argument(option, type=float, metavar=unit, help=help_text)
    parser.add_argument(
        "--start", type=_seconds, default=0.0, metavar="S", help="skip so much of the bag [s]"
    )
    parser.add_argument("--duration", type=_seconds, metavar="S", help="use so much of it [s]")


def _add_output_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--out", type=Path, metavar="DIR",
        help="write result.json, estimates.csv and report.html there",
    )  # fmt: skip
    parser.add_argument("--bag", action="store_true", help="and aligned.mcap, with the attitude")
    parser.add_argument("--truth", type=Path, metavar="FILE", help="truth.json to compare with")
    parser.add_argument("--json", metavar="FILE", help="write result.json there; -: to stdout")
    parser.add_argument("--quiet", action="store_true", help="neither result nor progress bar")


def _seconds(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = -1.0
    if not 0.0 <= value <= _MAX_SECONDS:
        raise argparse.ArgumentTypeError(f"{text} is not a time >= 0 s")
    return value


def _replay(options: argparse.Namespace, begin: float) -> int:
    from sins_align.config import odo_config, swing_config
    from sins_align.parameters import check_values
    from sins_align.ros.bags import Part, open_bag
    from sins_align.ros.parameter_values import read_values
    from sins_align.ros.replay import Outcome, open_session, run_replay
    from sins_align.ros.replay_output import CHART_RATE_HZ, print_outcome, write_outcome
    from sins_align.ros.result import Timing, result_document, write_result
    from sins_align.ros.truth import read_truth

    node = NODES[options.kind]
    values = read_values(node, options.params, options.overrides)
    given = {key: getattr(options, key) for key in POSITION}
    values.update({key: value for key, value in given.items() if value is not None})
    config = odo_config(values) if options.kind == "odo" else swing_config(values)
    truth = read_truth(options.truth) if options.truth else None
    if options.out:
        options.out.mkdir(parents=True, exist_ok=True)  # a bad one is known before the work
    rate: Any = CHART_RATE_HZ if options.out else None
    if options.bag:
        rate = check_values(node, values)["publish_rate_hz"]
    with open_bag(options.bags) as bag, _progress(options.quiet) as progress:
        replay = run_replay(
            bag, open_session(config, bag, options.fix_topic),
            options.imu_topic, options.odom_topic, part=Part(options.start, options.duration),
            progress=progress, record_rate_hz=rate,
        )  # fmt: skip
    for warning in bag.warnings:
        print(f"{NAME}: warning: {warning}", file=sys.stderr)
    estimate = replay.session.conclusion
    timing = Timing(time.perf_counter() - begin, bag.report.read_s, replay.estimate_s)
    document = result_document(node, replay.session, estimate, timing)
    outcome = Outcome(
        ", ".join(map(str, options.bags)), replay, estimate, document, truth,
        min(bag.report.frame_ids, default=""),
    )  # fmt: skip
    # Printed first: what was computed is not lost when something cannot be written.
    print_outcome(outcome, as_json=options.json == "-", quiet=options.quiet)
    if options.json and options.json != "-":
        write_result(Path(options.json), document)
    if options.out:
        write_outcome(options.out, outcome, with_bag=options.bag)
        if not options.quiet and options.json != "-":
            say(f"written to {options.out}")
    return ALIGNED if document["aligned"] else NOT_ALIGNED


@contextmanager
def _progress(quiet: bool) -> Iterator[Callable[[float], None] | None]:
    """A progress bar on a terminal, None elsewhere."""
    if quiet or not sys.stderr.isatty():
        yield None
        return
    from tqdm import tqdm

    bar_format = "{l_bar}{bar}| {elapsed} < {remaining}"
    with tqdm(total=1.0, desc="replay", leave=False, bar_format=bar_format) as bar:

        def show(done: float) -> None:
            bar.update(done - bar.n)

        yield show


if __name__ == "__main__":
    sys.exit(main())
