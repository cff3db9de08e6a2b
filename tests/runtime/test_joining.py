"""Clips joined into one: nothing jumps, nothing is lost, bones and feet stay."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from cli_runs import fails
from motions import recorded, walk

from kinegraph import Cancelled, InvalidInputError, MotionPipeline, cli
from kinegraph.bundle import DEFAULT_BUNDLE
from kinegraph.encoding import Encoders
from kinegraph.motion.joining import best_join, joined
from kinegraph.motion.skeleton import bone_lengths, facing_angle

FPS = 20.0
needs_default = pytest.mark.skipif(not (DEFAULT_BUNDLE / "manifest.json").is_file(), reason="no default bundle")
FEW: dict[str, Any] = {"steps": (3, 3, 4), "seed": 4}


def acceleration(joints: np.ndarray) -> np.ndarray:
    """(frames - 2,) largest over joints, m/s^2."""
    return np.linalg.norm(np.diff(joints.astype(np.float64), n=2, axis=0), axis=-1).max(axis=1) * FPS**2


def test_one_clip_is_itself() -> None:
    clip = walk(40)
    np.testing.assert_array_equal(joined([clip], FPS), clip)


def test_two_halves_of_a_walk_become_the_walk_again() -> None:
    whole = walk(120, turning=0.02)
    first, second = whole[:80], whole[40:]
    second = second - second[:1, :1] * np.array([1, 0, 1])  # from its own origin, as every clip is
    a, b = best_join(first, second, 10, FPS)
    assert (a - b) % 18 in (3, 4, 5) or abs(a - (40 + b)) <= 1  # the same phase of the step (18 frames)
    found = joined([first, second], FPS)
    assert acceleration(found).max() < 1.5 * acceleration(whole).max()


@pytest.mark.parametrize("headings", [(0.0, 2.0), (1.0, -3.0)])
def test_the_second_clip_goes_on_where_the_first_looks(headings: tuple[float, float]) -> None:
    first, second = (walk(60, heading=angle) for angle in headings)
    found = joined([first, second], FPS)
    assert np.abs(facing_angle(found) - facing_angle(first)[0]).max() < 0.3
    steps = np.linalg.norm(np.diff(found[:, 0][:, [0, 2]], axis=0), axis=-1)
    np.testing.assert_allclose(steps[2:-2], 0.05, atol=0.03)


def test_recorded_clips_join_without_a_jump() -> None:
    clips = recorded(count=12)
    for first, second in zip(clips[::2], clips[1::2], strict=False):
        found = joined([first, second], FPS)
        assert np.isfinite(found).all() and len(found) >= 0.5 * (len(first) + len(second))
        own = np.concatenate([acceleration(first), acceleration(second)])
        window = round(0.5 * FPS)
        a, _ = best_join(first, second, window, FPS)
        assert acceleration(found)[max(0, a - 3) : a + window + 3].max() <= 2 * max(np.quantile(own, 0.95), 10.0)
        lengths = bone_lengths(found)
        np.testing.assert_allclose(lengths, np.broadcast_to(lengths[:1], lengths.shape), atol=2e-3)


@pytest.mark.parametrize("frames", [2, 4, 9])
def test_short_clips_join(frames: int) -> None:
    found = joined([walk(frames), walk(30), walk(frames)], FPS)
    assert found.shape[1:] == (22, 3) and np.isfinite(found).all()


@needs_default
def test_a_sequence_of_sentences() -> None:
    pytest.importorskip("spacy")
    pipe = MotionPipeline.load(threads=1)
    texts = ["a person walks forward", "a person turns left", "a person bows"]
    clip = pipe.sequence(texts, seconds=[2, 2, 3], **FEW)
    assert clip.text == "a person walks forward, then a person turns left, then a person bows"
    assert 3.0 < clip.duration < 7.0 and clip.seed == 4
    np.testing.assert_array_equal(clip.joints, pipe.sequence(texts, seconds=[2, 2, 3], **FEW).joints)
    single = pipe.sequence(texts[:1], seconds=2, **FEW)
    np.testing.assert_array_equal(single.joints, pipe.generate(texts[0], seconds=2, **FEW).joints)


@needs_default
def test_progress_of_a_sequence_goes_once_from_start_to_end_and_can_stop() -> None:
    pytest.importorskip("spacy")
    pipe = MotionPipeline.load(threads=1)
    seen: list[tuple[int, int]] = []
    texts = ["a person walks forward", "a person bows"]
    pipe.sequence(texts, seconds=2, on_step=lambda info: seen.append((info.done, info.total)), **FEW)
    assert seen == [(number, 20) for number in range(1, 21)]
    with pytest.raises(Cancelled):
        pipe.sequence(texts, seconds=2, on_step=lambda info: info.done < 13, **FEW)


@needs_default
@pytest.mark.parametrize(
    ("texts", "seconds", "message"),
    [
        ([], 2, "1 to 32 sentences"),
        ("a person walks", 2, "a list"),
        (["a person walks"] * 33, 2, "1 to 32"),
        (["a person walks", ""], 2, "caption is empty"),
        (["a person walks", "a person bows"], [2], "seconds has 1 lengths for 2 sentences"),
        (["a person walks", "a person bows"], [2, 99], "seconds must be"),
    ],
)
def test_a_wrong_sequence_is_refused_before_a_model_runs(
    texts: Any, seconds: Any, message: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("spacy")
    pipe = MotionPipeline.load(threads=1)

    def never(*_: object) -> None:
        raise AssertionError("a model ran")

    monkeypatch.setattr(Encoders, "arrays", never)
    with pytest.raises(InvalidInputError, match=message):
        pipe.sequence(texts, seconds=seconds, seed=1)


@needs_default
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
