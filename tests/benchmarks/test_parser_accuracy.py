"""The harder sentences are well formed, and folds keep captions together that are alike."""

from __future__ import annotations

import json
from pathlib import Path
from types import SimpleNamespace

import pytest

pytest.importorskip("torch")
pytest.importorskip("spacy")

from kinegraph.graph import ARGUMENT_ROLES
from kinegraph_benchmarks.quality.parser_accuracy import HARD, assign_folds


def rows(half: str) -> list[dict]:
    path: Path = HARD / f"hard_sentences_{half}.jsonl"
    return [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()]


@pytest.mark.parametrize("half", ["dev", "held_out"])
def test_offsets_and_roles_of_the_harder_sentences_hold(half: str) -> None:
    for row in rows(half):
        assert row["checked"] is True
        assert row["actions"]
        for action in row["actions"]:
            assert row["caption"][action["start"] : action["end"]] == action["text"]
            for part in action["arguments"]:
                assert row["caption"][part["start"] : part["end"]] == part["text"]
                assert {part["role"], *part.get("also", ())} <= set(ARGUMENT_ROLES)


def test_the_halves_share_no_sentence() -> None:
    dev, held_out = ({row["caption"] for row in rows(half)} for half in ("dev", "held_out"))
    assert min(len(dev), len(held_out)) >= 30
    assert not dev & held_out


def test_captions_alike_but_for_case_are_in_one_fold() -> None:
    scorer = SimpleNamespace(normal=lambda caption: caption.lower().rstrip("."))
    captions = [f"Person {number} walks." for number in range(20)] + [f"person {number} walks" for number in range(20)]
    folds = assign_folds(captions, 5, 0, scorer)
    assert sorted(set(folds.values())) == [0, 1, 2, 3, 4]
    assert all(folds[f"Person {number} walks."] == folds[f"person {number} walks"] for number in range(20))
