"""The command `align_simulate`: a synthetic bag and its truth file."""

from __future__ import annotations

import argparse
import json
import os
import sys
from collections.abc import Sequence
from pathlib import Path

# Small matrices: threads cost more than they bring. It counts before numpy is imported.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from sins_align.ros.command import Parser, run_command, say
from sins_align.ros.simulation_options import add_options, swing_options

NAME = "align_simulate"


def main(args: Sequence[str] | None = None) -> int:
    """Run the command; returns its exit status: 0 done, 2 bad usage or target, 1 a bug."""
    parser = _parser()
    options = parser.parse_args(args)
    return run_command(NAME, lambda: _simulate_swing(options))


def _parser() -> argparse.ArgumentParser:
    parser = Parser(prog=NAME, description="Write a synthetic bag and its truth file.")
    kinds = parser.add_subparsers(dest="kind", required=True, metavar="swing")
    swing = kinds.add_parser(
        "swing", help="an IMU on a swinging or still base",
        description="Simulate an IMU on a swinging or still base. DIR becomes a rosbag2 folder"
        " with topics /imu and /fix, and with truth.json in it.",
    )  # fmt: skip
    swing.add_argument("--out", type=Path, required=True, metavar="DIR", help="must not exist")
    swing.add_argument("--storage", choices=("mcap", "sqlite3"), default="mcap")
    swing.add_argument("--compression", choices=("none", "zstd"), default="none")
    swing.add_argument("--quiet", action="store_true", help="say nothing")
    add_options(swing)
    return parser


def _simulate_swing(options: argparse.Namespace) -> int:
    from sins_align.ros.bags_merge import BagError
    from sins_align.ros.bags_write import ImuBagWriter
    from sins_align.ros.result import write_text_whole
    from sins_align.simulate import simulate_swing
    from sins_align.types import Position
    from sins_align.units import DEG

    what = swing_options(vars(options))
    if options.out.exists():  # known before the work, not after it
        raise BagError(options.out, "exists already and is not overwritten")
    run = simulate_swing(what)
    position = Position(what.latitude_deg * DEG, what.longitude_deg * DEG, what.altitude_m)
    with ImuBagWriter(options.out, storage=options.storage, compression=options.compression) as bag:
        for samples in run.chunks(1.0):
            bag.write_fix(position, int(samples.stamp_ns[0]))
            bag.write_samples(samples)
    truth = options.out / "truth.json"
    write_text_whole(truth, json.dumps(run.truth.truth_dict(), indent=1) + "\n")
    if not options.quiet:
        say(f"{options.out}: {len(run.imu)} samples, truth in {truth}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
