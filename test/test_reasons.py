"""The table of reasons, and the operators' page that is made from it."""

from __future__ import annotations

import ast
import string
from pathlib import Path

import pytest

from sins_align.reasons import REASONS, Finding, Kind, Reason, texts
from sins_align.reasons_page import BEGIN, END, KINDS, STATES, operators_page, with_page
from sins_align.types import State

ROOT = Path(__file__).resolve().parent.parent
README = ROOT / "README.md"


def test_readme_has_the_page_of_this_code() -> None:
    text = README.read_text(encoding="utf-8")
    assert with_page(text) == text, "run: python -m sins_align.reasons_page README.md"


def test_the_page_has_every_state_and_every_reason_once() -> None:
    page = operators_page()
    assert set(STATES) == set(State) and set(KINDS) == set(Kind)
    for reason in REASONS:
        assert page.count(f"| `{reason.key}`") == 1
    assert "{" not in page


def test_a_page_needs_both_marks() -> None:
    assert with_page(f"a{BEGIN}old{END}b").startswith(f"a{BEGIN}\n\n| state")
    for text in ("nothing", BEGIN, f"{END}{BEGIN}"):
        with pytest.raises(ValueError, match="expected"):
            with_page(text)


def test_keys_are_unique_words() -> None:
    keys = [reason.key for reason in REASONS]
    assert len(set(keys)) == len(keys)
    assert all(key.replace("_", "").isalpha() and key.islower() for key in keys)


@pytest.mark.parametrize("reason", REASONS, ids=lambda r: r.key)
def test_what_stops_an_alignment_has_a_remedy(reason: Reason) -> None:
    assert reason.says and reason.ends and reason.nodes in ("both", "swing", "odo")
    if reason.kind in (Kind.FAULT, Kind.LIMIT, Kind.DOUBT, Kind.HINT):
        assert reason.remedy


def test_somebody_gives_each_of_them() -> None:
    """A row that no module uses is a promise that nobody keeps."""
    used = set()
    for package in ("sins_align", "swing_align_ros", "odo_align_ros"):
        for path in (ROOT / package).rglob("*.py"):
            if path.name != "reasons.py":
                tree = ast.parse(path.read_text(encoding="utf-8"))
                used |= {node.id for node in ast.walk(tree) if isinstance(node, ast.Name)}
    assert {reason.key.upper() for reason in REASONS} <= used


def figures(reason: Reason) -> dict[str, float]:
    fields = [*string.Formatter().parse(reason.says), *string.Formatter().parse(reason.remedy)]
    return {name: 1.0 for _, name, _, _ in fields if name}


@pytest.mark.parametrize("reason", REASONS, ids=lambda r: r.key)
def test_a_finding_has_its_figures(reason: Reason) -> None:
    finding = reason(**figures(reason))
    assert finding.reason is reason
    assert "{" not in finding.text + finding.remedy
    for name in figures(reason):
        with pytest.raises(KeyError):
            reason(**{k: v for k, v in figures(reason).items() if k != name})


def test_what_is_said_twice_is_said_once() -> None:
    a = Finding(REASONS[0], "one", "do this")
    b = Finding(REASONS[1], "two", "do this")
    c = Finding(REASONS[2], "three", "")
    assert texts((a, b, a, c)) == ("one; two; three", "do this")
    assert texts(()) == ("", "")
