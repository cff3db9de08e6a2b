"""`MotionPipeline.sequence`: sentences one after another as one clip, in Python and on the command line."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from kinegraph import Cancelled, InvalidInputError, MotionPipeline, cli, clip_editing
from kinegraph.conditioning import ConditionEncoder
from support.cli_runs import fails

FEW: dict[str, Any] = {"steps": (3, 3, 4), "seed": 4}


def test_a_sequence_of_sentences(toy: MotionPipeline) -> None:
    texts = ["a person walks forward", "a person turns left", "a person bows"]
    clip = toy.sequence(texts, seconds=[2, 2, 3], **FEW)
    assert clip.text == "a person walks forward, then a person turns left, then a person bows"
    assert toy.sequence([texts[0], "then bows"], seconds=2, **FEW).text == "a person walks forward, then bows"
    assert clip.duration == pytest.approx(7.0, abs=0.4) and clip.seed == 4
    np.testing.assert_array_equal(clip.joints, toy.sequence(texts, seconds=[2, 2, 3], **FEW).joints)
    single = toy.sequence(texts[:1], seconds=2, **FEW)
    np.testing.assert_array_equal(single.joints, toy.generate(texts[0], seconds=2, **FEW).joints)


def test_progress_of_a_sequence_goes_once_from_start_to_end_and_can_stop(toy: MotionPipeline) -> None:
    seen: list[tuple[int, int]] = []
    texts = ["a person walks forward", "a person bows"]
    toy.sequence(texts, seconds=2, on_step=lambda info: seen.append((info.done, info.total)), **FEW)
    assert seen == [(number, 20) for number in range(1, 21)]
    with pytest.raises(Cancelled):
        toy.sequence(texts, seconds=2, on_step=lambda info: info.done < 13, **FEW)


@pytest.mark.parametrize(
    ("texts", "seconds", "message"),
    [
        ([], 2, "1 to 256 sentences"),
        ("a person walks", 2, "a list"),
        (["a person walks"] * 257, 2, "1 to 256"),
        (["a person walks", ""], 2, "caption is empty"),
        (["a person walks", "a person bows"], [2], "seconds has 1 lengths for 2 sentences"),
        (["a person walks", "a person bows"], [2, 99], "seconds must be"),
        (["a person walks", "a person bows"], 2, "seed must be"),
    ],
)
def test_a_wrong_sequence_is_refused_before_a_model_runs(
    toy: MotionPipeline, texts: Any, seconds: Any, message: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    def never(*_: object) -> None:
        raise AssertionError("a model ran")

    monkeypatch.setattr(ConditionEncoder, "encode_text", never)
    with pytest.raises(InvalidInputError, match=message):
        toy.sequence(texts, seconds=seconds, seed=2**63 - 1 if message.startswith("seed") else 1)
    for offsets in ([0], [0, 1, 2], [0, -1], [0, 10**6 + 1], [0, 0.5], "01", 3):
        with pytest.raises(InvalidInputError, match="seed_offsets are 2 whole numbers from 0 to"):
            toy.sequence(["a person walks", "a person bows"], seconds=2, seed_offsets=offsets)  # type: ignore[arg-type]


@pytest.mark.usefixtures("toy_by_default")
def test_the_seed_of_a_sequence_is_that_of_the_whole_whatever_its_offsets(toy: MotionPipeline, tmp_path: Path) -> None:
    pytest.importorskip("spacy")
    texts = ["a person walks forward", "a person bows"]
    clip = toy.sequence(texts, seconds=2, seed_offsets=[3, 0], **FEW)
    assert clip.seed == 4
    single = toy.sequence(texts[:1], seconds=2, seed_offsets=[3], **FEW)
    np.testing.assert_array_equal(single.joints, toy.generate(texts[0], seconds=2, **{**FEW, "seed": 7}).joints)
    assert single.seed == 4
    path = tmp_path / "clip.npz"
    options = ["--seconds", "2", "--steps", "3,3,4", "--seed", "4", "--seed-offsets", "3,0", "-o", str(path)]
    assert cli.main(["sequence", *texts, *options]) == 0
    np.testing.assert_array_equal(np.load(path)["joints"], clip.joints)


@pytest.mark.usefixtures("toy_by_default")
def test_on_the_command_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("spacy")
    target = tmp_path / "walk.npz"
    words = ["sequence", "a person walks", "a person bows", "--steps", "2", "--seed", "1", "--json", "-o", str(target)]
    assert cli.main([*words, "--seconds", "2"]) == 0
    record = json.loads(capsys.readouterr().out)
    assert record["seconds"] == pytest.approx(4.0, abs=0.4)
    with np.load(target) as stored:
        assert stored["text"] == "a person walks, then a person bows"
    assert "exists" in fails(capsys, *words)
    other = str(tmp_path / "other.npz")
    assert cli.main([*words[:-1], other, "--seconds", "2,3"]) == 0
    assert json.loads(capsys.readouterr().out)["seconds"] > record["seconds"]
    again = [*words[:-1], str(tmp_path / "third.npz"), "--seconds"]
    assert "seconds has 3 lengths for 2 sentences" in fails(capsys, *again, "2,3,2")
    with pytest.raises(SystemExit):
        cli.main([*again, "2,x"])
    assert "is not a number, nor several" in capsys.readouterr().err


def test_parts_continue_from_the_last_pose_with_the_lengths_that_were_asked_for(
    toy: MotionPipeline, monkeypatch: pytest.MonkeyPatch
) -> None:
    begun: list[np.ndarray] = []
    begin_in = clip_editing.begin_in
    monkeypatch.setattr(clip_editing, "begin_in", lambda joints, *rest: begun.append(joints) or begin_in(joints, *rest))
    texts = ["a person walks forward", "a person waves the right hand", "a person bows"]
    clip = toy.sequence(texts, method="continue", seconds=[2, 1.5, 2], **FEW)
    assert clip.frames == 110 and clip.text == ", then ".join(texts)
    assert clip.misses == () and clip.seed == 4
    alone = toy.generate(texts[0], seconds=2, **FEW)
    np.testing.assert_array_equal(clip.joints[:36], alone.joints[:36])  # nothing is cut or blended
    assert [len(joints) for joints in begun] == [4, 4]  # each part but the first begins in 0.2 s of the motion so far
    np.testing.assert_array_equal(begun[0], alone.joints[-4:])
    steps = np.linalg.norm(np.diff(clip.joints, axis=0), axis=-1).max(axis=1)
    assert steps[[39, 69]].max() < 2 * np.quantile(steps, 0.95)
    again = toy.sequence(texts, method="continue", seconds=[2, 1.5, 2], **FEW)
    np.testing.assert_array_equal(clip.joints, again.joints)
    longest = toy.manifest.seconds_limits[1]
    whole = toy.sequence(texts[:2], method="continue", seconds=longest, steps=1, seed=1)
    assert 0 <= 2 * longest - whole.duration <= 0.2 + 1e-9


def test_an_unknown_method_is_refused_and_so_is_a_bundle_that_cannot_continue(
    toy: MotionPipeline, monkeypatch: pytest.MonkeyPatch
) -> None:
    texts = ["a person walks", "a person bows"]
    for method in ("cut", None, 3):
        with pytest.raises(InvalidInputError, match="method must be one of blend, continue, energy"):
            toy.sequence(texts, method=method, **FEW)  # type: ignore[arg-type]
    bare = toy.with_sessions(dataclasses.replace(toy.sampler.sessions, decoder_gradients={}))
    with pytest.raises(InvalidInputError, match="no gradients of its decoders"):
        bare.sequence(texts, method="continue", seconds=2, **FEW)
    assert bare.sequence(texts, seconds=2, **FEW).frames > 60
