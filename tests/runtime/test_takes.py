"""Several takes of one sentence: each is the clip of its seed."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from kinegraph import InvalidInputError, MotionPipeline, StepInfo, cli
from kinegraph.edits import with_weight
from kinegraph.limits import MAX_TAKES
from support.cli_runs import fails

pytest.importorskip("spacy")

FEW: dict[str, Any] = {"steps": (2, 2, 3), "seconds": 1.5}
WALK = "a person walks forward"


def test_a_take_is_the_clip_of_its_seed(toy: MotionPipeline) -> None:
    clips = toy.takes(WALK, 4, seed=11, **FEW)
    assert [clip.seed for clip in clips] == [11, 12, 13, 14]
    for clip in clips:
        alone = toy.generate(WALK, seed=clip.seed, **FEW)
        np.testing.assert_array_equal(clip.joints, alone.joints)
        assert (clip.text, clip.fps, clip.bundle) == (alone.text, alone.fps, alone.bundle)
    assert np.abs(clips[0].joints - clips[1].joints).max() > 1e-3


def test_takes_share_the_runs_of_the_models_if_wanted(toy: MotionPipeline) -> None:
    counts = []
    for shared in (True, False):
        seen: list[StepInfo] = []
        toy.takes(WALK, 5, seed=1, shared_run=shared, on_step=lambda info, seen=seen: seen.append(info), **FEW)
        assert [info.done for info in seen] == list(range(1, seen[0].total + 1))
        counts.append(len(seen))
    assert counts == [7, 35]


def test_without_seconds_all_takes_are_as_long_as_the_sentence_wants(toy: MotionPipeline) -> None:
    clips = toy.takes(WALK, 2, seed=3, steps=(2, 2, 3))
    alone = toy.generate(WALK, seed=3, steps=(2, 2, 3))
    assert {clip.frames for clip in clips} == {alone.frames}


@pytest.mark.parametrize("count", [0, -1, MAX_TAKES + 1, 1.5, True, "3", None])
def test_a_wrong_count_is_refused(toy: MotionPipeline, count: Any) -> None:
    with pytest.raises(InvalidInputError, match=f"from 1 to {MAX_TAKES}"):
        toy.takes(WALK, count)


def test_seeds_beyond_the_last_and_weighted_graphs_are_refused(toy: MotionPipeline) -> None:
    with pytest.raises(InvalidInputError, match="seed must be"):
        toy.takes(WALK, 2, seed=2**63 - 1)
    with pytest.raises(InvalidInputError, match="weigh"):
        toy.takes(with_weight(toy.parse(WALK), "walks", 2.0), 2, shared_run=True)


@pytest.mark.usefixtures("toy_by_default")
@pytest.mark.parametrize("edit", [[], ["--weight", "forward=2"]])
def test_on_the_command_line(edit: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = ["generate", WALK, *edit, "--steps", "2", "--seconds", "1", "--seed", "5", "--json"]
    assert cli.main([*words, "--takes", "10", "-o", str(tmp_path / "walk.npz")]) == 0
    records = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert [Path(record["file"]).name for record in records] == [f"walk_{take:02}.npz" for take in range(1, 11)]
    assert [record["seed"] for record in records] == list(range(5, 15))
    assert sorted(path.name for path in tmp_path.iterdir()) == [Path(record["file"]).name for record in records]
    with np.load(tmp_path / "walk_10.npz") as last:
        assert last["seed"] == 14
    assert "walk_01.npz' exists" in fails(capsys, *words, "--takes", "10", "-o", str(tmp_path / "walk.npz"))
    assert "takes must be" in fails(capsys, *words, "--takes", "0", "-o", str(tmp_path / "other.npz"))
