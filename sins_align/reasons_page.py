"""The operators' page: states, reasons and remedies, from the code's own tables.

    python -m sins_align.reasons_page README.md

writes it between the two marks of the file.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Sequence
from pathlib import Path

from sins_align.reasons import REASONS, Kind, Reason
from sins_align.types import State

BEGIN, END = "<!-- reasons: begin -->", "<!-- reasons: end -->"

STATES = {
    State.WAITING: "something is missing: IMU, position, odometer, levels, or a base at rest",
    State.COARSE: "the levels are known; heading is not, or no better than 2 deg",
    State.FINE: "heading is known to 2 deg, and is being refined",
    State.ALIGNED: "sigma below both thresholds, no doubt standing, and both for `hold_s`",
    State.FAILED: "nothing can be made of the data, and it begins anew with the first that can; or"
    " the latitude is wrong, with latitude_check: fail",
}
# What a reason of a kind does, in the order of the page.
KINDS = {
    Kind.WAIT: "Waiting: nothing is estimated",
    Kind.FAULT: "Failed: the data cannot be used",
    Kind.PROGRESS: "On its way: nothing to be done",
    Kind.HINT: "Why it takes so long: said while a sigma is above its threshold",
    Kind.LIMIT: "Out of reach without other motion, place or settings: aligned is not claimed",
    Kind.DOUBT: "Doubts: aligned is not claimed while one stands",
    Kind.NOTE: "Said beside any state",
}


def operators_page() -> str:
    """The page in Markdown."""
    lines = ["| state | |", "| --- | --- |"]
    lines += [f"| `{state.value}` | {what} |" for state, what in STATES.items()]
    for kind, what in KINDS.items():
        lines += ["", f"**{what}**", "", "| reason | says | remedy | when it ends |"]
        lines += ["| --- | --- | --- | --- |"]
        lines += [_row(reason) for reason in REASONS if reason.kind is kind]
    return "\n".join(lines) + "\n"


def _row(reason: Reason) -> str:
    node = "" if reason.nodes == "both" else f" ({reason.nodes})"
    cells = (f"`{reason.key}`{node}", *map(_plain, (reason.says, reason.remedy)), reason.ends)
    return f"| {' | '.join(cells)} |"


def _plain(text: str) -> str:
    """With the figures left out."""
    return re.sub(r"\{\w+(:[^}]*)?\}", "…", text)


def with_page(text: str) -> str:
    """A document with the page between its marks.

    Raises
    ------
    ValueError : it does not have both marks
    """
    before, begin, rest = text.partition(BEGIN)
    _, end, after = rest.partition(END)
    if not begin or not end:
        raise ValueError(f"{BEGIN} and {END} are expected")
    return f"{before}{BEGIN}\n\n{operators_page()}\n{END}{after}"


def main(arguments: Sequence[str]) -> int:
    """Write the page into the files named; the exit status."""
    for name in arguments:
        path = Path(name)
        path.write_text(with_page(path.read_text(encoding="utf-8")), encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
