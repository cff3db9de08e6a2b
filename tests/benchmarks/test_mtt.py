"""MTT's protocol: timelines as it draws them, its own files, scores by hand, and rows on the toy bundle."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from kinegraph import InvalidInputError, MotionPipeline
from kinegraph.intervals import Interval
from kinegraph_benchmarks.common import mtt_scores as scores
from kinegraph_benchmarks.common import mtt_set as mtt
from kinegraph_benchmarks.common.mtt_scores import MttJudge
from kinegraph_benchmarks.quality import mtt as command
from kinegraph_training.data.clips import MotionClip
from support.motions import stand, t_pose, walk

WALKS, WAVES, BOWS = "a person walks forward", "a person waves the right hand", "a person bows"
TEXTS = (
    mtt.MttText(WALKS, ("legs",), walk(60)),
    mtt.MttText(WAVES, ("right arm",), stand(60, wave=2.0)),
    mtt.MttText(BOWS, ("head", "torso"), stand(60, bow=1.0)),
)


def timeline(first: float = 2.0, second: float = 2.0, beside: tuple[float, float] = (1.0, 3.0)) -> mtt.MttTimeline:
    return mtt.MttTimeline(
        Interval(WALKS, 0, first, ("legs",)),
        Interval(BOWS, first, first + second, ("head", "torso")),
        Interval(WAVES, *beside, ("right arm",)),
    )


class ByHand:
    """Embeds texts as unit vectors, and motions by their height and travel."""

    version = "by hand"

    def embed_captions(self, captions: list[str]) -> np.ndarray:
        return np.eye(4, dtype=np.float32)[[[WALKS, WAVES, BOWS].index(caption) for caption in captions]]

    def embed_motions(self, clips: list[np.ndarray]) -> np.ndarray:
        rows = [[np.ptp(joints[:, 0, 2]), joints[:, 21, 1].max(), -joints[:, 15, 1].min(), 1.0] for joints in clips]
        return np.array([np.array(row) / np.linalg.norm(row) for row in rows], dtype=np.float32)


def clip(action: str, caption: str, style: str = "normal") -> MotionClip:
    return MotionClip(f"{action} {style}", walk(40), (caption, "another caption"), (action,), style)


def test_texts_are_those_of_known_actions_plain_ones_first() -> None:
    clips = [
        clip("walk", "he walks sadly.", "sad"),
        clip("walk", "he walks. "),
        clip("walk", "he walks on."),
        clip("raise-up-left-hand", "she raises the left hand", ""),
        clip("sing-a-song", "he sings"),
        clip("run", "he walks."),
        clip("wave-both-hands", "he waves both hands."),
    ]
    texts = mtt.texts_of_clips(clips)
    assert [(text.text, text.parts) for text in texts] == [
        ("he walks", ("legs",)),
        ("she raises the left hand", ("left arm",)),
        ("he waves both hands", ("left arm", "right arm")),
        ("he walks sadly", ("legs",)),
    ]
    assert len(mtt.texts_of_clips(clips, 2)) == 2 and [text.weight for text in texts] == [3, 1, 2, 3]
    assert set(mtt.parts_of("bow")) <= set(mtt.BODY)


def test_timelines_are_drawn_as_mtt_draws_them() -> None:
    drawn = mtt.draw_timelines(TEXTS, 60)
    assert drawn == mtt.draw_timelines(TEXTS, 60) != mtt.draw_timelines(TEXTS, 60, seed=1)
    lengths, places = [], set()
    for each in drawn:
        first, second, beside = each.intervals
        assert first.start == 0 and second.start == first.end and second.end == each.seconds
        assert 0 <= beside.start < beside.end <= each.seconds
        others = [other for other in (first, second) if other.start < beside.end and beside.start < other.end]
        assert others and all(not {*beside.parts} & {*other.parts} for other in others)
        places.add((len(others), others[0] is first))
        lengths += [interval.end - interval.start for interval in each.intervals]
    assert places == {(1, True), (1, False), (2, True)}
    assert max(lengths) <= mtt.LONGEST and 5 < np.mean(lengths) < 6.5  # what fits beside is shorter


def test_texts_of_the_whole_body_leave_no_room() -> None:
    golf = [mtt.MttText(text, mtt.BODY) for text in "abc"]
    with pytest.raises(InvalidInputError, match="made 0 of 3 timelines"):
        mtt.draw_timelines(golf, 3)
    with pytest.raises(InvalidInputError, match="three texts; there are 2"):
        mtt.draw_timelines(TEXTS[:2], 3)


def write_mtt(folder: Path, **changes: str) -> Path:
    files = {
        "texts": "walk forwards # legs\nbow # head # spine\nwave # right arm\n",
        "MTT": "walk forwards # 0.0 # 5.0 # legs\nbow # 5.0 # 9.5 # head # spine\nwave # 0.5 # 4.5 # right arm\n\n"
        "bow # 0.0 # 4.0 # head # spine\nwalk forwards # 4.0 # 8.0 # legs\nwave # 5.5 # 7.5 # right arm\n\n",
        "motions": "".join(f"A/clip_{row} # 0.5 # 1.5\n" for row in range(3)),
    }
    for name, text in (files | changes).items():
        (folder / f"{name}.txt").write_text(text, encoding="utf-8")
    return folder


def test_files_of_mtt_are_read_as_they_are(tmp_path: Path) -> None:
    folder = write_mtt(tmp_path)
    (folder / "A").mkdir()
    motion = walk(40)
    upright = np.stack([motion[..., 0], -motion[..., 2], motion[..., 1]], axis=-1)  # +Z up
    for row in range(3):
        np.save(folder / "A" / f"clip_{row}.npy", np.concatenate([upright, upright[:, :2]], axis=1))
    found = mtt.read_mtt(folder, folder)
    assert [text.parts for text in found.texts] == [("legs",), ("head", "torso"), ("right arm",)]
    assert [each.texts for each in found.timelines] == [
        ("walk forwards", "bow", "wave"),
        ("bow", "walk forwards", "wave"),
    ]
    assert found.timelines[0].beside.start == 0.5 and found.timelines[1].seconds == 8.0
    captured = found.texts[0].motion
    assert captured is not None and captured.shape == (20, 22, 3)
    np.testing.assert_allclose(captured[-1, 0] - captured[0, 0], motion[29, 0] - motion[10, 0], atol=0.1)
    assert mtt.read_mtt(folder).texts[0].motion is None and found.rows["wave"] == 2


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"texts": "walk # tail\n"}, "'tail' is no part"),
        ({"MTT": "walk forwards # 0.0 # 5.0 # legs\n"}, "must have three texts"),
        ({"MTT": "jump # 0.0 # 5.0\nbow # 5 # 9\nwave # 1 # 2\n"}, "'jump' is not in texts.txt"),
        ({"MTT": "walk forwards # nought # 5.0\n"}, "timeline 1 of .* line 1"),
        ({"motions": "A/clip_0 # 0.5\n"}, "a line is path # begin # end"),
        ({"motions": "A/clip_0 # 0.5 # 1\n"}, "clip_0.npy cannot be read"),
    ],
)
def test_other_files_are_refused(tmp_path: Path, changes: dict[str, str], message: str) -> None:
    with pytest.raises(InvalidInputError, match=message):
        mtt.read_mtt(write_mtt(tmp_path, **changes), tmp_path if "motions" in changes else None)
    with pytest.raises(InvalidInputError, match=r"texts.txt cannot be read"):
        mtt.read_mtt(tmp_path / "none")


def test_crops_and_moments_are_those_of_the_intervals() -> None:
    joints = walk(80)
    crops = scores.crops_of(timeline(), joints, whole=False)
    assert [len(crop) for crop in crops] == [40, 40, 40]
    np.testing.assert_array_equal(crops[2], joints[20:60])
    assert all(crop is joints for crop in scores.crops_of(timeline(), joints, whole=True))
    assert scores.moments_of(timeline(), 80, whole=False) == [20, 40, 60]
    assert scores.moments_of(timeline(), 81, whole=True) == [20, 40, 60]
    assert [len(crop) for crop in scores.random_crops(joints)] == [80] * 5
    assert len({crop[0, 0, 2] for crop in scores.random_crops(walk(300))}) > 1


def test_a_transition_counts_neither_travel_nor_turn() -> None:
    gliding = t_pose(20)
    angle = np.linspace(0, 1, 20)[:, None]
    x, z = gliding[..., 0].copy(), gliding[..., 2].copy()
    gliding[..., 0] = np.cos(angle) * x + np.sin(angle) * z + 3 * angle
    gliding[..., 2] = np.cos(angle) * z - np.sin(angle) * x
    np.testing.assert_allclose(scores.distances_at(gliding, [5, 10]), 0, atol=1e-6)
    gliding[10:, 20, 1] += 0.11
    np.testing.assert_allclose(scores.distances_at(gliding, [5, 10]), [0, 0.11 / 22], atol=1e-6)


def judge_of(timelines: tuple[mtt.MttTimeline, ...]) -> MttJudge:
    evaluator: Any = ByHand()
    return MttJudge.of(mtt.MttSet(TEXTS, timelines), evaluator)


def test_scores_are_shares_and_cosines() -> None:
    judge = judge_of((timeline(), timeline()))
    far = walk(80, speed=1.0)
    found = judge.score([far, far], whole=True)
    rows = ByHand().embed_motions([far])[0]
    nearest = np.argsort(-rows[:3])
    assert found["r_precision_1"] == pytest.approx(1 / 3) and found["r_precision_3"] == 1.0
    assert nearest[0] == 0 and found["motion_text_score"] == pytest.approx(float((1 + rows[:3]).mean() / 2))
    motions = ByHand().embed_motions([text.motion for text in TEXTS])  # type: ignore[misc]
    assert found["motion_motion_score"] == pytest.approx(float((1 + motions @ rows).mean() / 2), abs=1e-6)
    assert found["fid"] > 0.01 and found["transition"] > 0
    captured = judge.score_captured()
    assert captured["motion_motion_score"] == pytest.approx(1) and captured["fid"] < found["fid"]
    alike = replace(judge, texts=np.repeat(judge.texts[:1], 3, axis=0))
    assert alike.score([far, far], whole=True)["r_precision_1"] == 0.0  # a tie is no hit
    assert "motion_motion_score" not in replace(judge, motions=None).score([far, far], whole=False)


def test_a_single_track_is_cut_where_something_begins_or_ends() -> None:
    assert command.single_track(timeline(3, 3, (1.0, 4.5)), 0.8) == [
        (0.0, 1.0, [WALKS]),
        (1.0, 3.0, [WALKS, WAVES]),
        (3.0, 4.5, [BOWS, WAVES]),
        (4.5, 6.0, [BOWS]),
    ]
    assert command.single_track(timeline(3, 3, (0.2, 3.3)), 0.8) == [(0.0, 3.0, [WALKS, WAVES]), (3.0, 6.0, [BOWS])]


def test_rows_are_those_of_the_papers_tables() -> None:
    rows = command.list_rows()
    assert sum(name.startswith("one text, latent, AGD") for name in rows) == 5  # Table 9
    assert sum(name.startswith("composed, latent") for name in rows) == 13  # Table 7, and the default
    assert {"one text, skeleton", "one text, skeleton, AGD 0.001/0.002"} <= rows.keys()  # Table 6
    assert {row.table for row in rows.values()} == set(command.TABLES)
    assert all(abs(sum(lambdas) - 1) < 1e-9 for lambdas in command.PAPER_LAMBDAS)


def test_rows_are_made_scored_and_remembered(toy: MotionPipeline, tmp_path: Path) -> None:
    pytest.importorskip("spacy")
    judge, out = judge_of((timeline(1.5, 1.5, (0.5, 2.0)), timeline(1.5, 1.5, (1.5, 3.0)))), tmp_path / "mtt.json"
    names = (
        "one text, latent",
        "one text, skeleton, AGD 0.001/0.002",
        "composed, skeleton, 0.1/0.7/0.2",
        "single track, latent",
        "composed track, latent",
        "timeline of whole bodies, skeleton",
        "timeline, skeleton",
    )
    rows = {name: command.list_rows()[name] for name in names}
    for name, row in rows.items():
        frames = len(row.make(toy, judge.mtt.timelines[0], 0))
        assert frames == 60 or ("track" in name and abs(frames - 60) <= 10), name
    result = command.measure(toy, judge, command.TABLES, out, rows)
    assert result["rows"].keys() == {"captured", *names} and result["left_out"] == []
    transitions = [result["rows"][name]["transition"] for name in names[-2:]]
    assert transitions[0] != transitions[1], "parts of the body count for nothing"

    def fail(*_: object) -> Any:
        raise AssertionError("made again")

    again = {name: replace(row, make=fail) for name, row in rows.items()}
    assert command.measure(toy, judge, command.TABLES, out, again) == result
    bare: Any = SimpleNamespace(
        manifest=SimpleNamespace(name="bare", version="1", frames_part=None), sampler=toy.sampler
    )
    left = command.measure(bare, judge, command.TABLES, tmp_path / "other.json", {names[-1]: again[names[-1]]})
    assert left["left_out"] == [names[-1]]
    table = command.markdown_table(left | {"rows": result["rows"]})
    assert "| R@1 | R@3 | M2T | M2M | FID | transition, cm |" in table and "Not in this bundle: timeline" in table
    assert table.count("\n| ") == 9


def test_a_set_needs_a_folder(tmp_path: Path) -> None:
    with pytest.raises(InvalidInputError, match="give --data"):
        command.load_set(None, None, None, 3)
    read, captured = command.load_set(None, write_mtt(tmp_path), None, 1)
    assert len(read.timelines) == 1 and captured == []
