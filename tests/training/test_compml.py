"""Clips that the model composes for training: which, how clean, and that a killed run goes on to the same folder."""

from __future__ import annotations

import json
import subprocess
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from support.motions import posed, turn, walk

pytest.importorskip("torch")
pytest.importorskip("spacy")

from kinegraph_training import compml
from kinegraph_training.config import DataConfig
from kinegraph_training.data.clips import MotionClip, mirrored_label, read_split
from kinegraph_training.data.folder import PreparedClip, write_data
from kinegraph_training.dataset import training_clips
from kinegraph_training.metrics import hand_speed, jerk
from kinegraph_training.synthetic.caption_grammar import CAPTIONS, LOCOMOTION
from kinegraph_training.synthetic.compositions import HeldOut

HELD = {"together": [["walk", "wave-left-hand"], ["walk-turn-left", "raise-up-left-hand"]], "in_order": []}


def waving(frames: int, shoulder: int) -> np.ndarray:
    sign = 1.0 if shoulder == 16 else -1.0
    rows = [
        posed(np.array([0, 0.95, 0]), {shoulder: turn("z", sign * (1 + 0.3 * np.sin(0.2 * f)))}) for f in range(frames)
    ]
    return np.stack(rows).astype(np.float32)


RECORDED = (
    ("walk", "normal", walk(24)),
    ("walk", "happy", walk(28)),
    ("walk-turn-left", "normal", walk(30, turning=0.02)),
    ("walk-turn-right", "normal", walk(30, turning=-0.02)),
    ("wave-left-hand", "normal", waving(30, 16)),
    ("wave-right-hand", "normal", waving(30, 17)),
    ("raise-up-left-hand", "normal", waving(26, 16)),
    ("raise-up-right-hand", "happy", waving(26, 17)),
)


@pytest.fixture
def data(tmp_path: Path) -> Path:
    """A folder of recorded clips, with the list of pairs held out."""
    return written(tmp_path / "data", 0.0)


@pytest.fixture
def rough_data(tmp_path: Path) -> Path:
    """The same with joints that tremble: beside figures that move like clockwork, no real motion is clean."""
    return written(tmp_path / "rough", 0.02)


def written(folder: Path, tremble: float, recorded: Sequence[tuple[str, str, np.ndarray]] = RECORDED) -> Path:
    rng = np.random.default_rng(0)
    write_data(
        folder,
        [
            PreparedClip(
                f"{content}_{style}",
                joints + rng.normal(0, tremble, joints.shape),
                ("a person moves.",),
                "made",
                "train",
                content,
                style,
            )
            for content, style, joints in recorded
        ],
        20,
    )
    (folder / "held_out.json").write_text(json.dumps(HELD))
    return folder


def words(data: Path, out: Path, *more: str) -> list[str]:
    return ["--data", str(data), "--held-out", str(data / "held_out.json"), "--out", str(out), *more]


@dataclass
class Stub:
    """Pipeline that returns listed motions, one after another."""

    motions: list[np.ndarray] = field(default_factory=list)
    asked: list[dict[str, Any]] = field(default_factory=list)
    manifest: Any = field(default_factory=lambda: SimpleNamespace(fps=20, frames=SimpleNamespace(min=16, max=196)))

    def compose(self, concepts: Any, **how: Any) -> Any:
        self.asked.append({"concepts": concepts, **how})
        return SimpleNamespace(joints=self.motions[min(len(self.asked), len(self.motions)) - 1])


def stub_composer(data: Path, *motions: np.ndarray) -> compml.Composer:
    return compml.make_composer(Stub(list(motions)), data, data / "held_out.json", 5)  # type: ignore[arg-type]


def test_only_what_was_recorded_and_is_not_held_out_is_composed(data: Path) -> None:
    composer = stub_composer(data)
    requests = [composer.draw_request(number, 0) for number in range(300)]
    never = {frozenset(pair) for pair in HELD["together"]}
    never |= {frozenset(map(mirrored_label, pair)) for pair in never}
    pairs = {frozenset(request.actions) for request in requests}
    assert not pairs & never and len(pairs) > 4
    recorded = {(content, style): len(joints) for content, style, joints in RECORDED}
    for request in requests:
        first, second = request.actions
        assert (first, request.style) in recorded and (second, request.style) in recorded
        assert second not in LOCOMOTION
        assert request.seconds == recorded[first, request.style] / 20
        assert len(set(request.captions)) == CAPTIONS
    assert {request.style for request in requests} == {"normal", "happy"}
    # The manner is said of each action, and clips are drawn independently of one another.
    assert all("happ" in " ".join(request.concepts) for request in requests if request.style == "happy")
    assert len({request.seed for request in requests}) == 300
    assert composer.draw_request(17, 0) == requests[17] != composer.draw_request(17, 1)


def test_data_without_two_actions_that_go_together_are_refused(data: Path, tmp_path: Path) -> None:
    alone = tmp_path / "alone"
    write_data(alone, [PreparedClip("a", walk(30), ("walks.",), "made", "train", "walk", "normal")], 20)
    with pytest.raises(compml.InvalidInputError, match="nothing can be composed"):
        compml.make_composer(Stub(), alone, data / "held_out.json", 0)  # type: ignore[arg-type]
    legs = [("a", walk(30), "walk"), ("b", walk(30, turning=0.02), "walk-turn-left")]
    write_data(alone, [PreparedClip(n, j, ("walks.",), "made", "train", c, "normal") for n, j, c in legs], 20)
    with pytest.raises(compml.InvalidInputError, match="no two actions"):
        compml.make_composer(Stub(), alone, data / "held_out.json", 0).draw_request(0, 0)  # type: ignore[arg-type]


WALK = walk(40)


def shaking(size: float) -> np.ndarray:
    """A walk whose joints all jump up and down: its jerk is that of the walk and about 64000 size."""
    joints = WALK.copy()
    joints[::2, :, 1] += size
    return joints


def test_a_clip_that_jerks_or_skates_is_drawn_again(data: Path) -> None:
    calm = waving(40, 16)
    sliding = walk(40, speed=0.5)
    composer = stub_composer(data, shaking(0.5), sliding, calm)
    request, joints, redrawn = composer.compose(3)
    assert redrawn == 2 and joints is calm
    assert request == composer.draw_request(3, 2)
    assert composer.pipe.asked[-1] == {  # type: ignore[attr-defined]
        "concepts": request.concepts, "text": request.captions[0], "seconds": request.seconds, "seed": request.seed,
    }  # fmt: skip


def test_the_limit_is_the_worse_of_both_actions(data: Path) -> None:
    composer = stub_composer(data)
    highest = {c: max(jerk(j) for content, _, j in RECORDED if content == c) for c, _, _ in RECORDED}
    measured = {content: row[0] for content, row in composer.highest.items()}
    assert measured == pytest.approx(highest, rel=0.1)  # joints are stored to 0.1 mm
    pair = ("wave-left-hand", "walk")
    sizes = np.geomspace(1e-5, 1e-1, 400)
    times = np.array([jerk(shaking(size)) for size in sizes]) / max(highest[action] for action in pair)
    below, above = sizes[times < 1.4][-1], sizes[times > 1.6][0]
    assert composer.is_clean(shaking(below), pair) and not composer.is_clean(shaking(above), pair)


def test_hands_that_hardly_move_are_no_gesture(data: Path) -> None:
    composer = stub_composer(data)
    kind = ("wave-left-hand", "normal")
    assert kind in composer.slowest
    recorded = next(joints for content, style, joints in RECORDED if (content, style) == kind)
    assert composer.slowest[kind] == pytest.approx(hand_speed(recorded), rel=0.02)
    faint, calm = (recorded[:1] + size * (recorded - recorded[:1]) for size in (0.6, 0.8))
    assert composer.is_lively(recorded, kind) and composer.is_lively(calm, kind)
    assert not composer.is_lively(faint, kind)


def test_a_clip_without_a_style_is_composed_with_normal_ones(tmp_path: Path) -> None:
    plain = ("raise-up-right-hand", "", waving(30, 17))
    folder = written(tmp_path / "plain", 0.0, [("walk", "normal", walk(24)), plain])
    composer = stub_composer(folder, walk(24))
    request, _, _ = composer.compose(0)
    assert request.actions == ("walk", "raise-up-right-hand")
    assert composer.slowest[("raise-up-right-hand", "normal")] == pytest.approx(hand_speed(plain[2]), rel=0.02)


def test_a_clip_that_is_never_clean_is_left_out_and_counted(data: Path, tmp_path: Path) -> None:
    composer = stub_composer(data, shaking(0.5))
    out = tmp_path / "out"
    compml.claim_folder(out, {"seed": 5})
    counts = compml.compose_all(composer, out, 2, 1)
    assert counts == {"clips": 0, "left_out": 2, "rejected": 2 * compml.ATTEMPTS}
    assert read_split(out, "train") == []


def test_a_killed_run_goes_on_to_the_same_folder(rough_data: Path, tmp_path: Path) -> None:
    count = 4
    command = [sys.executable, "-m", "kinegraph_training.compml"]
    command += words(rough_data, tmp_path / "killed", "--count", str(count), "--jobs", "2", "--seed", "3")
    running = subprocess.Popen(command, stderr=subprocess.DEVNULL)
    parts = tmp_path / "killed" / "parts"
    try:
        while running.poll() is None and len(list(parts.glob("*.npz"))) < 1:
            time.sleep(0.01)
    finally:
        running.kill()
        running.wait()
    before = {path.name: path.stat().st_mtime_ns for path in parts.glob("*.npz")}
    assert 1 <= len(before) < count and not (tmp_path / "killed" / "train.npz").exists()
    assert subprocess.run(command, capture_output=True, check=False).returncode == 0
    assert all((parts / name).stat().st_mtime_ns == when for name, when in before.items())
    whole = words(rough_data, tmp_path / "whole", "--count", str(count), "--jobs", "1", "--seed", "3")
    assert compml.main(whole) == 0
    for name in ("train.npz", "captions.jsonl", "index.jsonl", "provenance.json"):
        assert (tmp_path / "killed" / name).read_bytes() == (tmp_path / "whole" / name).read_bytes(), name
    clips = read_split(tmp_path / "whole", "train")
    assert len(clips) == count and all(len(clip.actions) == 2 and clip.style for clip in clips)
    origin = json.loads((tmp_path / "whole" / "provenance.json").read_text())["origin"]
    assert "CC BY-NC" in origin["licence"]["weights"] and origin["bundle"]


def test_wrong_wishes_are_refused_before_anything_is_made(
    data: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    for more, message in (
        (["--count", "0"], "--count must be 1 to"),
        (["--count", "2", "--jobs", "0"], "--jobs must be"),
        (["--count", "2", "--seed", "-1"], "--seed"),
        (["--count", "2", "--held-out", str(tmp_path / "none.json")], "none.json"),
        (["--count", "2", "--data", str(tmp_path)], "train.npz is missing"),
    ):
        assert compml.main(words(data, out, *more)) == 2
        assert message in capsys.readouterr().err and not out.exists()
    out.mkdir()
    (out / "thesis.txt").write_text("four years")
    assert compml.main(words(data, out, "--count", "1")) == 2
    assert "something else" in capsys.readouterr().err and list(out.iterdir()) == [out / "thesis.txt"]


def test_clips_of_another_origin_are_not_mixed(tmp_path: Path) -> None:
    compml.claim_folder(tmp_path / "out", {"seed": 1, "bundle": "a"})
    compml.claim_folder(tmp_path / "out", {"seed": 1, "bundle": "a"})
    with pytest.raises(compml.OutputError, match="another seed"):
        compml.claim_folder(tmp_path / "out", {"seed": 2, "bundle": "a"})


def test_composed_clips_are_trained_on_as_they_are(data: Path, tmp_path: Path) -> None:
    composed = MotionClip("c", walk(40), ("someone walks and waves the left hand.",), ("walk-turn-left", "x"), "normal")
    more = tmp_path / "more"
    write_data(more, [PreparedClip("c", composed.joints, composed.captions, "composed", "train", "a+b", "normal")], 20)
    config = DataConfig(splices=3, sequences=0)
    alone = training_clips(data, config, data / "held_out.json")
    both = training_clips(data, config, data / "held_out.json", [more])
    added = {clip.id for clip in both} - {clip.id for clip in alone}
    assert added == {"c", "c~mirror"} and len(both) == len(alone) + 2
    mirror = next(clip for clip in both if clip.id == "c~mirror")
    assert mirror.captions == ("someone walks and waves the right hand.",)


def test_a_list_of_held_out_pairs_that_is_none_is_refused(tmp_path: Path) -> None:
    for text in ("[]", '{"together": [["walk"]], "in_order": []}', '{"together": []}', "no"):
        (tmp_path / "held.json").write_text(text)
        with pytest.raises(compml.InvalidInputError, match="together"):
            HeldOut.read(tmp_path / "held.json")
