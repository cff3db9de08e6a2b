"""The sentences that the parser and the detection of unknown words are measured on are well formed."""

from __future__ import annotations

import json
from collections import Counter
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest

from kinegraph.graph import ARGUMENT_ROLES

BENCHMARKS = Path(__file__).parents[2] / "benchmarks"
HALVES = ("dev", "held_out")
UNKNOWN_KINDS = {"action": 20, "mixed": 20, "object": 20, "two people": 20, "language": 10, "nonsense": 10, "style": 10}


def rows(name: str) -> list[dict[str, Any]]:
    return [json.loads(line) for line in (BENCHMARKS / name).read_text(encoding="utf-8").splitlines()]


def typed(half: str) -> list[dict[str, Any]]:
    return rows(f"parser/hard_sentences_2_{half}.jsonl")


@pytest.mark.parametrize("half", HALVES)
def test_graphs_of_typed_sentences_hold(half: str) -> None:
    for row in typed(half):
        caption = row["caption"]
        assert row["checked"] is True
        assert row["actions"]
        for action in row["actions"]:
            assert caption[action["start"] : action["end"]] == action["text"]
            assert action.get("negated", True) is True
            for part in action["arguments"]:
                assert caption[part["start"] : part["end"]] == part["text"]
                assert {part["role"], *part.get("also", ())} <= set(ARGUMENT_ROLES)
                assert part["end"] <= action["start"] or part["start"] >= action["end"], caption
            firm = [part for part in action["arguments"] if not part.get("optional")]
            assert all(first["end"] <= second["start"] for first, second in pairwise(firm)), caption


def test_typed_sentences_are_halved_by_kind() -> None:
    dev, held_out = (Counter(row["kind"] for row in typed(half)) for half in HALVES)
    assert dev == held_out
    assert min((dev + held_out).values()) >= 10
    assert (dev + held_out).total() >= 150
    assert not {row["caption"].lower() for row in typed("dev")} & {row["caption"].lower() for row in typed("held_out")}


@pytest.mark.parametrize("half", HALVES)
def test_negations_are_marked_except_standing_still(half: str) -> None:
    for row in typed(half):
        negated = any(action.get("negated") for action in row["actions"])
        if row["kind"] == "negation":
            assert negated == (row["form"] != "still"), row["caption"]


def test_unknown_phrases_are_in_their_sentences() -> None:
    sentences = rows("data/unknown_sentences.jsonl")
    assert len({row["text"].lower() for row in sentences}) == len(sentences) >= 180
    for row in sentences:
        assert row["unknown"]
        assert all(phrase in row["text"] for phrase in row["unknown"])
    kinds = Counter(row["kind"] for row in sentences)
    assert kinds.keys() == UNKNOWN_KINDS.keys()
    assert all(kinds[kind] >= least for kind, least in UNKNOWN_KINDS.items())


def test_known_sentences_are_half_recorded_and_never_unknown() -> None:
    sentences = rows("data/known_sentences.jsonl")
    texts = {row["text"] for row in sentences}
    assert len(texts) == len(sentences) >= 550
    sources = Counter(row["source"] for row in sentences)
    assert sources["bandai"] == sources["own"]
    assert not texts & {row["text"] for row in rows("data/unknown_sentences.jsonl")}
