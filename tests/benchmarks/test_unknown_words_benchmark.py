"""The benchmark of unknown words: halves by turns, what counts as told, and totals alone of the held-out half."""

from __future__ import annotations

import json
from pathlib import Path

from kinegraph import Unknown
from kinegraph_benchmarks.quality.unknown_words import (
    DATA,
    KNOWN,
    UNKNOWN,
    Sentence,
    all_named,
    count_told,
    markdown_table,
    read_sentences,
    summarise,
)

JUGGLES = Sentence("a person walks and juggles hats", ("juggles", "hats"), "mixed", "dev")


def span(text: str, start: int) -> Unknown:
    return Unknown(text, start, start + len(text))


def test_lines_belong_to_the_halves_by_turns(tmp_path: Path) -> None:
    rows = [
        {"text": "a", "unknown": ["a"], "kind": "action"},
        {"text": "b", "source": "own", "kind": "pace"},
        {"text": "c", "source": "bandai"},
    ]
    (tmp_path / "x.jsonl").write_text("".join(json.dumps(row) + "\n" for row in rows))
    assert read_sentences(tmp_path / "x.jsonl") == [
        Sentence("a", ("a",), "action", "dev"),
        Sentence("b", (), "known, own", "held out"),
        Sentence("c", (), "known, bandai", "dev"),
    ]


def test_every_listed_phrase_must_be_touched() -> None:
    assert all_named(JUGGLES, [span("juggles hats", 19)])
    assert all_named(JUGGLES, [span("jugg", 19), span("ts", 29)])
    assert not all_named(JUGGLES, [span("juggles", 19)])
    assert not all_named(JUGGLES, [span("a person walks", 0)])


def test_what_is_told_is_counted_and_the_held_out_half_stays_unseen() -> None:
    told = {
        "a person walks and juggles hats": [span("juggles", 19)],
        "held": [],
        "a person walks": [span("walks", 9)],
        "a person strolls": [],
    }
    sentences = [
        JUGGLES,
        Sentence("held", ("held",), "mixed", "held out"),
        Sentence("a person walks", (), "known, own", "dev"),
        Sentence("a person strolls", (), "paraphrase", "dev"),
    ]
    rows, wrong = count_told(sentences, lambda text: told[text])
    assert {(row["half"], row["kind"]): (row["sentences"], row["told"], row["all_named"]) for row in rows} == {
        ("dev", "mixed"): (1, 1, 0), ("held out", "mixed"): (1, 0, 0), ("dev", "known, own"): (1, 1, 0),
        ("dev", "paraphrase"): (1, 0, 0),
    }  # fmt: skip
    assert [case["text"] for case in wrong] == ["a person walks and juggles hats", "a person walks"]
    assert summarise(rows, "dev")["unknown"] == (1, 1, 0) and summarise(rows, "dev")["known"] == (1, 1, 0)
    times = {"known sentence": {"median": 0.04, "p95": 0.1, "longest": 0.2}}
    table = markdown_table({"bundle": "edge 1", "counts": rows, "wrong": wrong, "milliseconds": times})
    assert "| dev | mixed | 1 | 1 (1.000) | 0 (0.000) |" in table and "| dev | known, own | 1 | 1 (1.000) |  |" in table
    assert "- 'a person walks' (known, own): told walks" in table and "| known sentence | 0.04 | 0.10 | 0.20 |" in table


def test_the_sentences_list_phrases_of_their_own_and_are_enough() -> None:
    unknown = [sentence for name in UNKNOWN for sentence in read_sentences(DATA / name)]
    assert all(phrase in sentence.text for sentence in unknown for phrase in sentence.unknown)
    assert sum(bool(sentence.unknown) for sentence in unknown) >= 150 and len(read_sentences(DATA / KNOWN)) >= 500
