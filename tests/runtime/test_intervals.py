"""Intervals of a timeline and the text files that hold them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from kinegraph.errors import InvalidInputError
from kinegraph.intervals import Interval, check_intervals, groups_at_once, parse_intervals, read_intervals

FILE = """\
walks in a circle # 0.0 # 6.0 # legs # spine

raises the right hand # 2.0 # 5.25 # right arm
"""


def test_a_file_has_an_interval_a_line(tmp_path: Path) -> None:
    path = tmp_path / "timeline.txt"
    path.write_text(FILE, encoding="utf-8")
    walk, raised = read_intervals(path)
    assert walk == Interval("walks in a circle", 0, 6, ("legs", "torso"))
    assert raised == Interval("raises the right hand", 2, 5.25, ("right arm",))
    assert parse_intervals("walks # 0 # 4", "f") == (Interval("walks", 0, 4),)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("walks # 0", "line 1: a line is: text # start # end"),
        ("walks # 0 # 4\nruns # x # 4", "line 2: 'x' is no number of seconds"),
        ("walks # 4 # 0", "line 1: an interval goes from a moment to a later one"),
        ("walks # 0 # nan", "line 1: an interval"),
        (" # 0 # 4", "line 1"),
        ("walks # 0 # 4 # left tentacle", "no part of the body is called 'left tentacle'"),
        ("", "1 to 256 intervals"),
        ("walks # 1 # 4", "nothing happens from 0 to 1 s"),
        ("walks # 0 # 4\nruns # 5 # 8", "nothing happens from 4 to 5 s"),
    ],
)
def test_what_is_no_timeline_is_told_with_its_place(text: str, message: str) -> None:
    with pytest.raises(InvalidInputError, match=message) as told:
        parse_intervals(text, "mine.txt")
    assert "mine.txt" in str(told.value)


def test_a_file_that_cannot_be_read(tmp_path: Path) -> None:
    with pytest.raises(InvalidInputError, match="cannot read"):
        read_intervals(tmp_path / "none.txt")
    (tmp_path / "binary").write_bytes(b"\xff\xfe\x00 # 0 # 4")
    with pytest.raises(InvalidInputError, match="cannot read"):
        read_intervals(tmp_path / "binary")
    (tmp_path / "huge").write_bytes(b"\n" * (1 << 20) + b"x")
    with pytest.raises(InvalidInputError, match="larger"):
        read_intervals(tmp_path / "huge")


@pytest.mark.parametrize("wrong", [None, "walks", [], [("walks", 0, 4)], {Interval("walks", 0, 4)}])
def test_a_timeline_is_a_list_of_intervals(wrong: Any) -> None:
    with pytest.raises(InvalidInputError, match="timeline"):
        check_intervals(wrong)


def test_intervals_are_sorted_and_too_many_at_once_are_refused() -> None:
    late, early = Interval("runs", 3, 6), Interval("walks", 0, 4)
    assert check_intervals([late, early]) == (early, late)
    with pytest.raises(InvalidInputError, match="9 intervals hold at 0 s"):
        check_intervals([early] * 9)


@pytest.mark.parametrize("parts", [3, ("legs", 4), "wings", [None]])
def test_parts_of_the_body_have_names(parts: Any) -> None:
    with pytest.raises(InvalidInputError, match="part"):
        Interval("walks", 0, 4, parts)
    assert Interval("walks", 0, 4, "legs").parts == ("legs",)  # type: ignore[arg-type]


def test_what_coincides_is_composed_and_what_overlaps_is_not() -> None:
    walk, wave, run = Interval("walks", 0, 4), Interval("waves", 0, 4), Interval("runs", 4, 8)
    assert groups_at_once([walk, wave, run]) == [[walk, wave], [run]]
    assert groups_at_once([walk, Interval("waves", 2, 4)]) is None
    assert groups_at_once([walk, Interval("waves", 0, 3)]) is None
    assert groups_at_once([Interval("walks", 0, 4, ("legs",))]) is None
