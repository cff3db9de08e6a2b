"""Recognition by action: its shares, its means and its spreads are those of the clips."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from kinegraph.motion.skeleton import start_at_origin
from kinegraph_benchmarks.common.label_classifier import LabelClassifier
from kinegraph_benchmarks.quality import recognition
from kinegraph_benchmarks.quality.recognition import Captured, EmbeddedTake
from kinegraph_training.data.clips import MotionClip
from kinegraph_training.data.common_skeleton import rest_directions, to_common_skeleton
from kinegraph_training.data.folder import PreparedClip, write_data
from support.motions import t_pose, walk


def clip(number: int, action: str, joints: np.ndarray) -> MotionClip:
    return MotionClip(f"{action}{number}", joints, (f"a person does {action}.",), (action,), "")


def walks(count: int, speed: float = 0.05) -> list[MotionClip]:
    return [clip(number, "walk", walk(40 + number, speed=speed)) for number in range(count)]


def stands(count: int) -> list[MotionClip]:
    return [clip(number, "stand", t_pose(40) + np.float32(0.001 * number)) for number in range(count)]


class Fake:
    """Walks at a speed of its seed; stands if asked to."""

    name, stamp, fps, seconds_limits = "fake", "s", 20.0, (0.8, 9.8)

    def generate(self, caption: str, *, seconds: float, seed: int, **options: Any) -> Any:
        made = t_pose(40) if "stand" in caption else walk(40, speed=0.05 + 0.002 * (seed % 5))
        return type("Clip", (), {"joints": made})


class Judge:
    """Embeds a motion as how far it gets, and a caption as what it asks for."""

    version = "t"

    def embed_motions(self, clips: Any) -> np.ndarray:
        return np.array([[np.ptp(joints[:, 0, 2]), 0.0] for joints in clips])

    def embed_captions(self, captions: Any) -> np.ndarray:
        return np.array([[0.0 if "stand" in caption else 2.0, 0.0] for caption in captions])


def test_shares_are_of_takes() -> None:
    judge = LabelClassifier(walks(9) + stands(9), recognition.BALANCE)
    asked = [walks(1)[0], stands(1)[0]]
    takes = [[walk(44), t_pose(40)], [t_pose(40), t_pose(40)]]
    assert recognition.recognised(asked, takes, judge) == [0.5, 1.0]


def test_a_caption_is_found_if_no_other_is_as_near() -> None:
    evaluator: Any = Judge()
    clips = [*walks(2), *stands(2)]
    asked = [clip.captions[0] for clip in clips]
    motions = [walk(44), walk(50), t_pose(40), t_pose(41)]
    right = EmbeddedTake.of(motions, asked, evaluator)
    wrong = EmbeddedTake.of([t_pose(40), walk(44), walk(44), t_pose(40)], asked, evaluator)
    assert recognition.found_captions(clips, [right]) == [1.0] * 4
    assert recognition.found_captions(clips, [right, wrong]) == [0.5, 1.0, 0.5, 1.0]
    alike = EmbeddedTake.of(motions, ["a person walks."] * 4, evaluator)  # what is asked alike cannot be told apart
    assert recognition.found_captions(clips, [alike]) == [0.0] * 4


def test_shares_of_an_action_leave_out_clips_that_were_not_judged() -> None:
    captured = Captured(walks(9), [*walks(3)], frozenset())
    rows = recognition.by_action(captured, {"caption": [1.0, float("nan"), 0.5], "captured": [float("nan")] * 3})
    assert rows["walk"]["caption"] == 0.75 and rows["walk"]["captured"] == 0.0 and rows["walk"]["trained"] == 9


def test_balance_lets_a_rare_action_count() -> None:
    rng = np.random.default_rng(0)
    common = [clip(n, "walk", walk(40, speed=0.05 + 0.01 * rng.standard_normal())) for n in range(60)]
    rare = [clip(n, "stroll", walk(40, speed=0.04 + 0.01 * rng.standard_normal())) for n in range(6)]
    asked = [clip(n, "stroll", walk(40, speed=0.035)) for n in range(3)]
    rates = [
        np.mean(recognition.recognised(asked, [[one.joints for one in asked]], LabelClassifier(common + rare, balance)))
        for balance in (0.0, 1.0)
    ]
    assert rates[1] > rates[0]


def test_means_are_over_actions_that_captured_clips_are_recognised_in() -> None:
    rows = {
        "walk": {"trained": 9, "captured": 1.0, "generated": 0.9},
        "jump": {"trained": 8, "captured": 0.5, "generated": 0.6},
        "kick": {"trained": 8, "captured": 0.8, "generated": 0.0},
        "bow": {"trained": 8, "captured": 0.0, "generated": 0.5},
        "rare": {"trained": 7, "captured": 1.0, "generated": 0.0},
    }
    found = recognition.summarise(rows)
    assert found["actions"] == 3 and found["at_zero"] == ["kick"] and found["no_opinion"] == ["bow"]
    assert found["of_captured"] == pytest.approx((0.9 + 1 + 0) / 3) and found["reach_0.8"] == 2


def test_spreads_are_distances_between_clips() -> None:
    moved = [t_pose(10), t_pose(10) + np.array([0.3, 0.0, 0.0], dtype=np.float32)]
    assert recognition.pose_spread(moved) == pytest.approx(0.3, rel=1e-5)
    assert recognition.pose_spread([*moved, moved[0]]) == pytest.approx(0.2, rel=1e-5)
    assert recognition.embedded_spread(np.array([[0.0, 0.0], [3.0, 4.0]])) == 5.0


def test_one_bundle_is_measured_and_shown(tmp_path: Path) -> None:
    captured = Captured(walks(9) + stands(9), walks(3) + stands(3), frozenset({"stand0", "stand1", "stand2"}))
    model: Any = Fake()
    evaluator: Any = Judge()
    judge = recognition.train_classifier(captured)
    found = recognition.measure_model(model, captured, judge, evaluator, tmp_path, 2, 3)
    assert found["recognition"]["of_captured"] == 1.0 and found["recognition"]["actions"] == 2
    assert found["actions"]["stand"]["same_take"] and not found["actions"]["walk"]["same_take"]
    assert found["scores"]["r_precision_1"] == 1.0 == found["captured_scores"]["r_precision_1"]
    assert set(found["spread_by_action"]) == {"walk", "stand"}
    assert found["spread_by_action"]["stand"]["takes"] == 0 < found["spread_by_action"]["walk"]["takes"]
    text = recognition.markdown_table(
        {"evaluator": "t", "repeats": 2, "held_out": 6, "bundles": {"a": found, "b": found}}
    )
    assert "| of captured | 1 | 1.000 | 1.000 |" in text
    assert "| stand | 9 | 3 of trained takes | 1.00 | 1.00 | 1.00 | 1.00 | 1.00 | 1.00 |" in text
    assert found["captions"]["captured"] == found["captions"]["generated"] == 1.0 and not found["captions"]["at_zero"]


def test_what_the_autoencoder_keeps_is_a_column(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    latents = pytest.importorskip("kinegraph_training.latents")
    scores = pytest.importorskip("kinegraph_benchmarks.common.autoencoder_scores")
    monkeypatch.setattr(latents, "read_vae", lambda path: path)
    monkeypatch.setattr(scores, "reconstruct", lambda trained, features: features * np.float32("vae" in str(trained)))
    captured = Captured(walks(9) + stands(9), walks(3) + stands(3), frozenset())
    judge = recognition.train_classifier(captured)
    kept = recognition.measure_autoencoder(tmp_path, captured, judge)
    assert kept["recognition"]["of_captured"] == 1.0 and kept["actions"]["walk"]["error"] < 1e-5
    model: Any = Fake()
    evaluator: Any = Judge()
    found = recognition.measure_model(model, captured, judge, evaluator, tmp_path, 1, 2)
    result = {"evaluator": "t", "repeats": 1, "held_out": 6, "bundles": {"a": found}, "autoencoder": kept}
    text = recognition.markdown_table(result)
    assert "| captured | a | classifier: captured | copied | error, mm | a |" in text
    assert "| stand | 9 | 3 | 1.00 | 1.00 | 1.00 | 1.00 | 0 | 1.00 |" in text
    copies = [np.stack([t_pose(40)[0]] * len(one.joints)) for one in captured.held_out]
    assert recognition.body_error(copies[0], captured.held_out[0].joints) > 0.01


def test_another_body_is_brought_to_that_of_the_captured_clips() -> None:
    plain = [walk(40), walk(50, speed=0.08)]
    common = [start_at_origin(to_common_skeleton(joints, rest_directions(plain))) for joints in plain]
    assert recognition.has_common_body(common[0]) and not recognition.has_common_body(plain[0])
    asked = [clip(0, "walk", common[0])]
    brought = recognition.on_body_of(asked, plain)
    np.testing.assert_allclose(brought[1], common[1])
    assert recognition.on_body_of(asked, common)[0] is common[0]
    assert recognition.on_body_of([clip(0, "walk", plain[0])], plain)[1] is plain[1]


def test_judges_see_no_held_out_clip(tmp_path: Path) -> None:
    clips = [
        PreparedClip(f"{action}{n}", walk(30 + n), ("a person moves",), f"{action}{n // 3}", split, action=action)
        for action, split, count in (("kick", "train", 12), ("walk", "train", 9), ("walk", "val", 1))
        for n in range(count)
    ]
    clips = [PreparedClip(**{**vars(one), "id": f"{one.split}-{one.id}"}) for one in clips]
    write_data(tmp_path, clips, 20)
    (tmp_path / "test.npz").rename(tmp_path / "dev_test.npz")
    captured = recognition.read_captured(tmp_path)
    assert len(captured.train) + len(captured.held_out) == 22
    assert {one.action for one in captured.held_out} == {"kick", "walk"} and not captured.same_take
    assert not {one.id for one in captured.train} & {one.id for one in captured.held_out}
