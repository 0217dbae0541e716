"""The command `align_simulate`: a synthetic bag and its truth file."""

from __future__ import annotations

import argparse
import json
import os
import sys
from collections.abc import Iterator, Sequence
from itertools import pairwise
from pathlib import Path

# Small matrices: threads cost more than they bring. It counts before numpy is imported.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

from sins_align.ros.command import Parser, run_command, say
from sins_align.ros.simulation_options import (
    SIMULATIONS,
    Run,
    add_options,
    odometer_of,
    position_of,
)
from sins_align.types import ImuSamples, OdometerSamples

NAME = "align_simulate"
_NS = 1_000_000_000


def main(args: Sequence[str] | None = None) -> int:
    """Run the command; returns its exit status: 0 done, 2 bad usage or target, 1 a bug."""
    options = _parser().parse_args(args)
    return run_command(NAME, lambda: _simulate(options))


def _parser() -> argparse.ArgumentParser:
    parser = Parser(prog=NAME, description="Write a synthetic bag and its truth file.")
    kinds = parser.add_subparsers(dest="kind", required=True, metavar="|".join(SIMULATIONS))
    for name, simulation in SIMULATIONS.items():
        topics = "/imu, /odom and /fix" if simulation.extra else "/imu and /fix"
        kind = kinds.add_parser(
            name, help=simulation.what,
            description=f"Simulate {simulation.what}. DIR becomes a rosbag2 folder with topics"
            f" {topics}, and with truth.json in it.",
        )  # fmt: skip
        kind.add_argument("--out", type=Path, required=True, metavar="DIR", help="must not exist")
        kind.add_argument("--storage", choices=("mcap", "sqlite3"), default="mcap")
        kind.add_argument("--compression", choices=("none", "zstd"), default="none")
        kind.add_argument("--quiet", action="store_true", help="say nothing")
        add_options(kind, simulation)
    return parser


def _simulate(options: argparse.Namespace) -> int:
    from sins_align.ros.bags_merge import BagError
    from sins_align.ros.bags_topics import odometer_type
    from sins_align.ros.bags_write import ImuBagWriter
    from sins_align.ros.whole_file import write_text_whole

    simulation = SIMULATIONS[options.kind]
    values = vars(options)
    # Both are known before the work, not after it.
    checked = {p.name: p.check(values[p.name]) for p in simulation.extra}
    simulation.options(values)
    if options.out.exists():
        raise BagError(options.out, "exists already and is not overwritten")
    run = simulation.run(values)
    position = position_of(run)
    with ImuBagWriter(options.out, storage=options.storage, compression=options.compression) as bag:
        for imu, odometer in _seconds(run):
            bag.write_fix(position, int(imu.stamp_ns[0]))
            if odometer is not None:
                message_type = odometer_type(str(checked["odom_type"]))
                bag.write_odometer(odometer, odometer.stamp_ns, message_type)
            bag.write_samples(imu)
    truth = options.out / "truth.json"
    write_text_whole(truth, json.dumps(run.truth.truth_dict(), indent=1) + "\n")
    if not options.quiet:
        say(f"{options.out}: {len(run.imu)} samples, truth in {truth}")
    return 0


def _seconds(run: Run) -> Iterator[tuple[ImuSamples, OdometerSamples | None]]:
    """The samples in pieces of a second with something of the IMU in each."""
    imu, odometer = run.imu, odometer_of(run)
    second = (imu.stamp_ns - imu.stamp_ns[0]) // _NS
    edges = [*np.flatnonzero(np.diff(second, prepend=-1)).tolist(), len(imu)]
    begin = 0
    for first, last in pairwise(edges):
        piece = imu.select(slice(first, last))
        if odometer is None:
            yield piece, None
            continue
        end = len(odometer)
        if last < len(imu):  # those that come after the last IMU sample go with it
            end = int(np.searchsorted(odometer.stamp_ns, imu.stamp_ns[last]))
        yield piece, odometer.select(slice(begin, max(begin, end)))
        begin = max(begin, end)


if __name__ == "__main__":
    sys.exit(main())
