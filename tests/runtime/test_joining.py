"""Clips joined into one: nothing jumps, nothing is lost, bones and feet stay."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from kinegraph import Cancelled, InvalidInputError, MotionPipeline, cli
from kinegraph.conditioning import ConditionEncoder
from kinegraph.motion.blending import BLEND_SECONDS, best_blend, best_transition, peak_accelerations, stitch
from kinegraph.motion.skeleton import JOINT_INDEX, bone_lengths, facing_angle
from support.cli_runs import fails
from support.motions import recorded, walk

FPS = 20.0
FEW: dict[str, Any] = {"steps": (3, 3, 4), "seed": 4}


def test_one_clip_is_itself() -> None:
    clip = walk(40)
    np.testing.assert_array_equal(stitch([clip], FPS), clip)


def test_two_halves_of_a_walk_become_the_walk_again() -> None:
    whole = walk(120, turning=0.02)
    first, second = whole[:80], whole[40:]
    second = second - second[:1, :1] * np.array([1, 0, 1])  # from its own origin, as every clip is
    a, b = best_transition(first, second, 10, FPS)
    assert (a - b) % 18 in (3, 4, 5) or abs(a - (40 + b)) <= 1  # the same phase of the step (18 frames)
    found = stitch([first, second], FPS)
    assert peak_accelerations(found, FPS).max() < 1.5 * peak_accelerations(whole, FPS).max()


@pytest.mark.parametrize("headings", [(0.0, 2.0), (1.0, -3.0)])
def test_the_second_clip_goes_on_where_the_first_looks(headings: tuple[float, float]) -> None:
    first, second = (walk(60, heading=angle) for angle in headings)
    found = stitch([first, second], FPS)
    assert np.abs(facing_angle(found) - facing_angle(first)[0]).max() < 0.3
    steps = np.linalg.norm(np.diff(found[:, 0][:, [0, 2]], axis=0), axis=-1)
    np.testing.assert_allclose(steps[2:-2], 0.05, atol=0.03)


def test_recorded_clips_join_without_a_jump() -> None:
    clips = recorded(count=24)
    for first, second in zip(clips[::2], clips[1::2], strict=False):
        found = stitch([first, second], FPS)
        assert np.isfinite(found).all() and len(found) >= 0.5 * (len(first) + len(second))
        own = np.concatenate([peak_accelerations(first, FPS), peak_accelerations(second, FPS)])
        blend = best_blend(first, second, FPS)
        # and while feet come to be held beside it, a fifth of a second
        held = peak_accelerations(found, FPS)[max(0, blend.start - 6) : blend.start + blend.frames + 4]
        assert held.max() <= 2 * max(np.quantile(own, 0.95), 10.0)
        lengths = bone_lengths(found)
        np.testing.assert_allclose(lengths, np.broadcast_to(lengths[:1], lengths.shape), atol=2e-3)


def test_hands_that_have_far_to_go_take_longer() -> None:
    low = np.repeat(walk(1), 60, axis=0)
    high = low.copy()
    arm = [JOINT_INDEX[name] for name in ("left_elbow", "left_wrist")]
    shoulder = low[:, [JOINT_INDEX["left_shoulder"]]]
    high[:, arm] = shoulder - (low[:, arm] - shoulder) * np.array([-1, 1, 1], dtype=np.float32)
    swaying = 0.002 * np.sin(np.arange(60) / 2).astype(np.float32)[:, None, None]
    clips = [low + swaying, high + swaying]
    assert best_blend(*clips, FPS).frames == round(BLEND_SECONDS[-1] * FPS) > best_blend(clips[0], clips[0], FPS).frames
    found = stitch(clips, FPS)
    # the arm goes round, it does not shrink
    lengths = bone_lengths(found)
    np.testing.assert_allclose(lengths, np.broadcast_to(lengths[:1], lengths.shape), atol=2e-3)


def test_feet_stand_while_one_clip_becomes_the_next_unless_they_are_left_alone() -> None:
    drift = 0.002 * np.arange(40, dtype=np.float32)[:, None, None] * np.array([1, 0, 0], dtype=np.float32)
    clips = [np.repeat(walk(1), 40, axis=0) + sign * drift for sign in (1, -1)]
    held, left = stitch(clips, FPS), stitch(clips, FPS, foot_fix=False)
    for toe in (JOINT_INDEX["left_foot"], JOINT_INDEX["right_foot"]):
        speed = [np.linalg.norm(np.diff(found[:, toe][:, [0, 2]], axis=0), axis=-1) * FPS for found in (held, left)]
        assert speed[0].mean() < 0.1 * speed[1].mean()
    np.testing.assert_allclose(left[:20], clips[0][:20], atol=1e-5)


@pytest.mark.parametrize("frames", [2, 4, 9])
def test_short_clips_join(frames: int) -> None:
    found = stitch([walk(frames), walk(30), walk(frames)], FPS)
    assert found.shape[1:] == (22, 3) and np.isfinite(found).all()


def test_a_sequence_of_sentences(pipe: MotionPipeline) -> None:
    texts = ["a person walks forward", "a person turns left", "a person bows"]
    clip = pipe.sequence(texts, seconds=[2, 2, 3], **FEW)
    assert clip.text == "a person walks forward, then a person turns left, then a person bows"
    assert pipe.sequence([texts[0], "then bows"], seconds=2, **FEW).text == "a person walks forward, then bows"
    assert 3.0 < clip.duration < 7.0 and clip.seed == 4
    np.testing.assert_array_equal(clip.joints, pipe.sequence(texts, seconds=[2, 2, 3], **FEW).joints)
    single = pipe.sequence(texts[:1], seconds=2, **FEW)
    np.testing.assert_array_equal(single.joints, pipe.generate(texts[0], seconds=2, **FEW).joints)


def test_progress_of_a_sequence_goes_once_from_start_to_end_and_can_stop(pipe: MotionPipeline) -> None:
    seen: list[tuple[int, int]] = []
    texts = ["a person walks forward", "a person bows"]
    pipe.sequence(texts, seconds=2, on_step=lambda info: seen.append((info.done, info.total)), **FEW)
    assert seen == [(number, 20) for number in range(1, 21)]
    with pytest.raises(Cancelled):
        pipe.sequence(texts, seconds=2, on_step=lambda info: info.done < 13, **FEW)


@pytest.mark.parametrize(
    ("texts", "seconds", "message"),
    [
        ([], 2, "1 to 32 sentences"),
        ("a person walks", 2, "a list"),
        (["a person walks"] * 33, 2, "1 to 32"),
        (["a person walks", ""], 2, "caption is empty"),
        (["a person walks", "a person bows"], [2], "seconds has 1 lengths for 2 sentences"),
        (["a person walks", "a person bows"], [2, 99], "seconds must be"),
        (["a person walks", "a person bows"], 2, "seed must be"),
    ],
)
def test_a_wrong_sequence_is_refused_before_a_model_runs(
    pipe: MotionPipeline, texts: Any, seconds: Any, message: str, monkeypatch: pytest.MonkeyPatch
) -> None:

    def never(*_: object) -> None:
        raise AssertionError("a model ran")

    monkeypatch.setattr(ConditionEncoder, "encode_text", never)
    with pytest.raises(InvalidInputError, match=message):
        pipe.sequence(texts, seconds=seconds, seed=2**63 - 1 if message.startswith("seed") else 1)


def test_on_the_command_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("spacy")
    target = tmp_path / "walk.npz"
    words = ["sequence", "a person walks", "a person bows", "--steps", "2", "--seed", "1", "--json", "-o", str(target)]
    assert cli.main([*words, "--seconds", "2"]) == 0
    record = json.loads(capsys.readouterr().out)
    assert 2.0 < record["seconds"] < 4.0
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
    assert "no list of them" in capsys.readouterr().err
