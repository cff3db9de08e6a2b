"""Clips left out for judges: whole takes where there are several, the same ones every time."""

from __future__ import annotations

from typing import Any

from kinegraph_training.data.clips import read_jsonl
from kinegraph_training.data.left_out import FEWEST, left_out_clips, take_of
from support.shared import shared_path


def rows(action: str, takes: dict[str, int], split: str = "train", **more: Any) -> dict[str, dict[str, Any]]:
    return {
        f"{action}-{take}-{window}": {
            "id": f"{action}-{take}-{window}", "split": split, "content": action, "take": take, **more,
        }
        for take, windows in takes.items()
        for window in range(windows)
    }  # fmt: skip


def test_whole_takes_are_left_out_of_actions_that_have_none_elsewhere() -> None:
    index = rows("kick", {"a": 3, "b": 3, "c": 3, "d": 3}) | rows("walk", {"a": 9}) | rows("walk", {"z": 1}, "dev_test")
    chosen = left_out_clips(index)
    assert chosen and all(name.startswith("kick") for name in chosen) and all(chosen.values())
    takes = {take_of(index[name]) for name in chosen}
    kept = {take_of(row) for name, row in index.items() if name.startswith("kick") and name not in chosen}
    assert len(chosen) == 3 and not takes & kept
    assert left_out_clips(dict(reversed(index.items()))) == chosen


def test_a_single_take_loses_its_last_windows_and_says_so() -> None:
    assert left_out_clips(rows("jab", {"a": 10})) == {"jab-a-8": False, "jab-a-9": False}


def test_few_clips_are_kept() -> None:
    assert left_out_clips(rows("spin", {"a": 2, "b": 3})) == {}
    index = rows("spin", {"a": 5, "b": 1, "c": 1, "d": 1})
    assert len(index) - len(left_out_clips(index)) >= FEWEST


def test_clips_without_a_label_or_not_clean_do_not_count() -> None:
    assert left_out_clips(rows("", {"a": 9}) | rows("kick", {"a": 4, "b": 5}, clean=False)) == {}


def test_clips_without_a_take_are_takes_of_their_own() -> None:
    assert take_of({"id": "x"}) == "x"
    assert take_of({"id": "x", "take": 8, "source_file": "a.bvh"}) != take_of(
        {"id": "y", "take": 8, "source_file": "b.bvh"}
    )


def test_of_the_open_clips_every_common_action_has_some() -> None:
    index = read_jsonl(shared_path("data", "open", "index.jsonl"))
    chosen = left_out_clips(index)
    for action in ("jab-left", "jump-in-place", "fall-down", "kick-high-right", "stage-fight"):
        count = sum(index[name]["content"] == action for name in chosen)
        total = sum(row["content"] == action and row["split"] == "train" for row in index.values())
        assert 1 <= count <= total / 2, action
