"""The harder sentences are well formed, and folds keep captions together that are alike."""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from types import SimpleNamespace

import pytest

pytest.importorskip("torch")
pytest.importorskip("spacy")

from kinegraph.bundle.reader import text_files_folder
from kinegraph.graph import ARGUMENT_ROLES, Action, SemanticGraph
from kinegraph_benchmarks.quality.parser_accuracy import (
    HALVES,
    HARD,
    assign_folds,
    compare_weights,
    count_negations,
    markdown_table,
    read_scorer,
    score_by_kind,
)
from support.shared import shared_path


def rows(half: str) -> list[dict]:
    path: Path = HARD / f"hard_sentences_{half}.jsonl"
    return [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()]


@pytest.mark.parametrize("half", ["dev", "held_out", "2_dev", "2_held_out"])
def test_offsets_and_roles_of_the_harder_sentences_hold(half: str) -> None:
    for row in rows(half):
        assert row["checked"] is True
        assert row["actions"]
        for action in row["actions"]:
            assert row["caption"][action["start"] : action["end"]] == action["text"]
            for part in action["arguments"]:
                assert row["caption"][part["start"] : part["end"]] == part["text"]
                assert {part["role"], *part.get("also", ())} <= set(ARGUMENT_ROLES)


@pytest.mark.parametrize("number", ["", "2_"])
def test_the_halves_share_no_sentence(number: str) -> None:
    dev, held_out = ({row["caption"] for row in rows(f"{number}{half}")} for half in ("dev", "held_out"))
    assert min(len(dev), len(held_out)) >= 30
    assert not dev & held_out


def test_every_half_is_measured() -> None:
    assert {half.path for half in HALVES} == set(HARD.glob("*.jsonl"))
    assert {half.is_dev for half in HALVES if half.is_typed} == {True, False}


def test_kinds_and_negations_are_counted(tmp_path: Path) -> None:
    file = tmp_path / "typed.jsonl"
    sentences = {"he walks": "order", "do not run": "negation", "never jump": "negation"}
    file.write_text(
        "\n".join(
            json.dumps(
                {"caption": caption, "kind": kind, "actions": [{"start": 3, "end": 6, "negated": kind != "order"}]}
            )
            for caption, kind in sentences.items()
        )
    )
    scorer = SimpleNamespace(score=lambda gold, graphs: [caption for caption, *_ in gold if caption in graphs])
    gold = [(caption, None, None) for caption in sentences]
    kinds = score_by_kind(file, gold, {"he walks": 0, "do not run": 0}, scorer)  # type: ignore[arg-type]
    assert kinds == {"order": ["he walks"], "negation": ["do not run"]}

    class Parser:
        """Marks the same characters of every caption but one as negated."""

        def parse(self, caption: str) -> SemanticGraph:
            negated = caption != "never jump"
            return SemanticGraph(caption, (Action(caption[3:6], 3, 6, 0, negated=negated),))

    assert count_negations(Parser(), file) == {"marked": 1, "missed": 1, "in vain": 1}  # type: ignore[arg-type]


def test_captions_alike_but_for_case_are_in_one_fold() -> None:
    scorer = SimpleNamespace(normal=lambda caption: caption.lower().rstrip("."))
    captions = [f"Person {number} walks." for number in range(20)] + [f"person {number} walks" for number in range(20)]
    folds = assign_folds(captions, 5, 0, scorer)
    assert sorted(set(folds.values())) == [0, 1, 2, 3, 4]
    assert all(folds[f"Person {number} walks."] == folds[f"person {number} walks"] for number in range(20))


def test_weights_are_compared_with_one_another_and_the_rules() -> None:
    scorer, text = read_scorer(shared_path("graphs", "score_graphs.py")), text_files_folder()
    options = argparse.Namespace(parser=text / "parser.bin", weights=[text / "arguments.npz"], gold=HALVES[0].path)
    scores = compare_weights(options, scorer)["scores"]
    assert len(scores) == 6 and all("dev" not in name for name in scores)
    learnt, rules = (scores[f"hard sentences, held out: {name}"] for name in (text / "arguments.npz", "rules alone"))
    assert learnt["argument_exact"]["f1"] > rules["argument_exact"]["f1"] > 0.9
    assert len(markdown_table({"scores": scores}).splitlines()) == 8
