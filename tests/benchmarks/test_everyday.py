"""The everyday prompts are well formed and new to training; their rates are those of the clips."""

from __future__ import annotations

import json
import re
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from kinegraph.errors import InvalidInputError
from kinegraph_benchmarks.quality import everyday
from kinegraph_benchmarks.quality.everyday import PARAPHRASES, Prompt, read_prompts
from support.motions import t_pose, walk
from support.shared import shared_path

PROMPTS = read_prompts(PARAPHRASES)


def words(text: str) -> str:
    return " ".join(re.findall(r"[a-z0-9]+", text.lower()))


def test_prompts_are_many_and_of_every_kind() -> None:
    assert len({words(prompt.text) for prompt in PROMPTS}) == len(PROMPTS) >= 120
    asked = Counter(rule for prompt in PROMPTS for rule in prompt.rules)
    wanted = {"still", "forward", "backward", "leftward", "rightward", "around", "circle", "stops", "fast", "slow",
              "jumps", "kicks", "kicks_left", "kicks_right", "punches", "crouches", "down", "gets_up", "reaches_down",
              "both_up", "left_up", "right_up", "waves_left", "waves_right", "bows", "turn_left",
              "turn_right"}  # fmt: skip
    assert all(asked[rule] >= 3 for rule in wanted)
    assert all(2 <= prompt.seconds <= 9 for prompt in PROMPTS)


def test_no_prompt_is_a_training_caption() -> None:
    seen: set[str] = set()
    for name in ("bandai", "cmu", "open"):
        for line in shared_path("data", name, "captions.jsonl").read_text(encoding="utf-8").splitlines():
            seen |= {words(caption) for caption in json.loads(line)["captions"]}
    assert not [prompt.text for prompt in PROMPTS if words(prompt.text) in seen]


def test_no_prompt_is_in_the_other_file() -> None:
    theirs = {words(prompt.text) for prompt in read_prompts(shared_path("prompts", "everyday.jsonl"))}
    assert len(theirs) == 35 and not theirs & {words(prompt.text) for prompt in PROMPTS}


@pytest.mark.parametrize("line", ["{}", "no", '{"text": "a", "seconds": "x", "rules": []}'])
def test_a_line_that_is_no_prompt_is_named(line: str, tmp_path: Path) -> None:
    path = tmp_path / "prompts.jsonl"
    path.write_text('{"text": "a person walks", "seconds": 3, "rules": ["forward"]}\n' + line)
    with pytest.raises(InvalidInputError, match="line 2"):
        read_prompts(path)


def test_a_rule_of_a_prompt_must_exist(tmp_path: Path) -> None:
    path = tmp_path / "prompts.jsonl"
    path.write_text('{"text": "a person flies", "seconds": 3, "rules": ["flies"]}')
    with pytest.raises(InvalidInputError, match="flies"):
        read_prompts(path)


class Fake:
    """Walks with even seeds and stands with odd ones."""

    def generate(self, text: str, *, seconds: float, seed: int, **options: Any) -> Any:
        return type("Clip", (), {"joints": t_pose(40) if seed % 2 else walk(40)})


def test_rates_are_those_of_the_clips() -> None:
    pipe: Any = Fake()
    prompts = [Prompt("walk", 2, ("forward",)), Prompt("fall", 2, ("down",)), Prompt("stand", 2, ("stays", "still"))]
    judge = {"forward": lambda joints: True, "stays": lambda joints: True}
    rows = everyday.measure_prompts(pipe, prompts, 3, judge)
    assert [row["rate"] for row in rows] == pytest.approx([2 / 3, 0.0, 1 / 3])
    assert [row["judge"] for row in rows] == [1.0, None, None]
    assert everyday.summarise(rows) == {"mean": pytest.approx(1 / 3), "prompts": 3, "at_zero": 1}
    assert everyday.summarise(rows, "judge") == {"mean": 1.0, "prompts": 1, "at_zero": 0}
    assert everyday.summarise(rows[1:], "judge") is None
    assert everyday.rates_by_rule(rows)["still"] == {"prompts": 1, "mean": pytest.approx(1 / 3)}
    result = {"bundles": ["a", "b"], "seeds": 3, "files": {"p.jsonl": {"a": rows, "b": rows}}}
    table = everyday.markdown_table(result)
    assert "| walk | forward | 0.67 | 0.67 |" in table and "| a | 0.333 | 1 | 3 | 1.000 | 0 |" in table


def test_bundles_of_one_name_are_told_apart() -> None:
    pipe: Any = type("Pipe", (), {"manifest": type("Manifest", (), {"name": "open", "version": "1"})})
    assert everyday.bundle_name(pipe, []) == "open 1"
    assert everyday.bundle_name(pipe, ["open 1"]) == "open 1 (2)"
    assert everyday.bundle_name(pipe, ["open 1", "open 1 (2)", "studio 1"]) == "open 1 (3)"


def test_seeds_are_those_of_the_number() -> None:
    pipe: Any = Fake()
    clips = everyday.generate_all(pipe, PROMPTS[0], 4)
    assert [bool(np.ptp(clip[:, 0, 2]) > 1) for clip in clips] == [True, False, True, False]
