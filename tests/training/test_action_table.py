"""The action table: wordings of every label, well formed, distinct, read by the parser, none of them a test prompt."""

from __future__ import annotations

import json
import re
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from kinegraph.bundle.reader import text_files_folder
from support.shared import shared_path

ROOT = Path(__file__).resolve().parents[2]
TABLE = ROOT / "training" / "kinegraph_training" / "synthetic" / "actions.toml"
PARSER = text_files_folder() / "parser.bin"
SIDES = (("left", "right"), ("right", "left"))
FIELDS = {"finite", "participle", "noun", "parts", "steady", "aliases"}
SUBJECT = re.compile(r"^((a|the) \w+|someone|somebody|he|she) ")
"""What a caption or a prompt starts with: its subject."""


@pytest.fixture(scope="module")
def actions() -> dict[str, dict[str, Any]]:
    return tomllib.loads(TABLE.read_text(encoding="utf-8"))


def sided(text: str) -> Iterator[str]:
    """List a text with its placeholders filled in, for either side if it has any."""
    return iter(dict.fromkeys(text.format(side=side, other=other) for side, other in SIDES))


def finite_phrases(actions: dict[str, dict[str, Any]]) -> list[str]:
    return [text for action in actions.values() for phrase in action["finite"] for text in sided(phrase)]


def test_every_table_is_well_formed(actions: dict[str, dict[str, Any]]) -> None:
    for name, action in actions.items():
        assert set(action) == FIELDS, name
        assert len(action["finite"]) >= 5, name
        assert len(action["finite"]) == len(action["participle"]), name
        assert action["parts"] in ("legs", "arms", "arm", "body"), name
        assert isinstance(action["steady"], bool), name
        if action["parts"] == "arm":
            assert "{side}" in name, f"{name} moves one arm but does not say which"


def test_every_wording_is_lower_case_and_has_no_side_its_label_lacks(actions: dict[str, dict[str, Any]]) -> None:
    for name, action in actions.items():
        for text in [name, *action["finite"], *action["participle"], *action["noun"], *action["aliases"]]:
            placeholders = set(re.findall(r"[{}][^{}]*[{}]?", text))
            assert placeholders <= ({"{side}", "{other}"} if "{side}" in name else set()), f"{name}: {text}"
            assert text == text.lower().strip() and "  " not in text, text
            assert not text.endswith((".", ",")), text


def test_a_sided_action_names_its_side_in_most_wordings_and_the_pair_alike(actions: dict[str, dict[str, Any]]) -> None:
    for name, action in actions.items():
        pairs = list(zip(action["finite"], action["participle"], strict=True))
        assert all(("{" in finite) == ("{" in participle) for finite, participle in pairs), name
        if "{side}" in name:
            assert sum("{" in finite for finite, _ in pairs) >= 5, name
            assert all("{side}" in alias for alias in action["aliases"]), name


def test_no_wording_belongs_to_two_actions_or_twice_to_one(actions: dict[str, dict[str, Any]]) -> None:
    for field in ("finite", "participle"):
        texts = [text for action in actions.values() for phrase in action[field] for text in sided(phrase)]
        assert sorted(texts) == sorted(set(texts)), field
    labels = [text for name, action in actions.items() for label in (name, *action["aliases"]) for text in sided(label)]
    assert sorted(labels) == sorted(set(labels))


@pytest.mark.parametrize("data", ["bandai", "open"])
def test_every_label_has_an_action(actions: dict[str, dict[str, Any]], data: str) -> None:
    covered = {t for name, action in actions.items() for label in (name, *action["aliases"]) for t in sided(label)}
    index = shared_path("data", data, "index.jsonl").read_text(encoding="utf-8")
    assert {json.loads(line)["content"] for line in index.splitlines()} <= covered


def test_aliases_are_labels_of_the_data_sets(actions: dict[str, dict[str, Any]]) -> None:
    labels = set()
    for data, field in (("bandai", "content"), ("open", "content"), ("cmu", "label")):
        index = shared_path("data", data, "index.jsonl").read_text(encoding="utf-8")
        labels |= {json.loads(line)[field].lower() for line in index.splitlines()}
    for action in actions.values():
        for alias in action["aliases"]:
            assert labels & set(sided(alias)), alias


def test_no_wording_is_a_prompt_of_the_tests(actions: dict[str, dict[str, Any]]) -> None:
    prompts = shared_path("prompts", "everyday.jsonl").read_text(encoding="utf-8").splitlines()
    asked = {SUBJECT.sub("", json.loads(line)["text"]) for line in prompts}
    said = set(finite_phrases(actions))
    for action in actions.values():
        said |= {f"is {text}" for phrase in action["participle"] for text in sided(phrase)}
    assert not asked & said


def test_the_parser_finds_an_action_in_each_wording(actions: dict[str, dict[str, Any]]) -> None:
    pytest.importorskip("spacy")
    from kinegraph.text.parser import GraphParser

    parser = GraphParser(PARSER.read_bytes())
    phrases = finite_phrases(actions)
    chosen = np.random.default_rng(0).choice(len(phrases), 60, replace=False)
    assert [phrases[i] for i in chosen if not parser.parse(f"a person {phrases[i]}").actions] == []
