"""What a replay prints and writes."""

from __future__ import annotations

from pathlib import Path

from sins_align.ros.command import say
from sins_align.ros.replay import Outcome
from sins_align.ros.result import result_text, write_result
from sins_align.ros.result_table import describe_result

CHART_RATE_HZ = 1.0  # shows a swing, and takes a fifth of a second for seven minutes


def print_outcome(outcome: Outcome, *, as_json: bool, quiet: bool) -> None:
    """The result on standard output: result.json and nothing else, or a table, or nothing."""
    if as_json:
        say(result_text(outcome.document).rstrip())
    elif not quiet:
        say(describe_result(outcome.document, outcome.estimate, outcome.truth))


def write_outcome(folder: Path, outcome: Outcome, *, with_bag: bool) -> None:
    """Write result.json, estimates.csv, report.html and, with_bag, aligned.mcap.

    Raises
    ------
    OSError, BagError : a file cannot be written; it is then as it was before
    """
    from sins_align.ros.report import write_estimates, write_report

    document = outcome.document
    write_result(folder / "result.json", document)
    write_estimates(folder / "estimates.csv", outcome.replay.updates)
    write_report(folder / "report.html", outcome)
    if with_bag:
        from sins_align.ros.attitude_bag import write_attitude_bag

        write_attitude_bag(
            folder / "aligned.mcap", outcome.replay, document["node"], outcome.frame_id
        )
