"""Re-make the figures of the README and of the papers' tables, and check their bounds.

    python evidence/run.py [--seeds N] [--only SECTION ...]

Exits 1 where a bound is broken.
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from evidence import odo, odo_data, odo_methods, odo_paper, status, swing

SECTIONS = (
    *swing.SECTIONS,
    *odo.SECTIONS,
    *odo_methods.SECTIONS,
    *odo_paper.SECTIONS,
    *odo_data.SECTIONS,
    *status.SECTIONS,
)


def main() -> int:
    """Print every row as it comes; the exit status."""
    names = [section.__name__ for section in SECTIONS]
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=30, help="runs of each case (30)")
    parser.add_argument("--only", choices=names, action="append", help="this section alone")
    arguments = parser.parse_args()
    broken = 0
    for section in SECTIONS:
        if arguments.only and section.__name__ not in arguments.only:
            continue
        print(f"{section.__name__}: {section.__doc__}", flush=True)
        begin = time.monotonic()
        for case in section(arguments.seeds):
            print(f"  {case.name}, {case.runs} runs, {time.monotonic() - begin:.0f} s")
            print("\n".join([*case.lines, *map(str, case.checks)]), flush=True)
            broken += sum(not check.kept for check in case.checks)
    print(f"{broken} bounds broken")
    return 1 if broken else 0


if __name__ == "__main__":
    sys.exit(main())
