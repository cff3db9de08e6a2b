"""Poses and edits made in both spaces: the same cases, times beside the plain clip of latent space, one table."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from kinegraph import EndPose, MotionPipeline, StartPose
from kinegraph_benchmarks.quality import inpainting
from kinegraph_training.data.clips import MotionClip
from support.motions import stand, walk


class Evaluator:
    def embed_motions(self, clips: list[np.ndarray]) -> np.ndarray:
        return np.array([[np.ptp(joints[:, 0, 2]), joints[:, 15, 1].min()] for joints in clips], dtype=np.float32)


def clip(label: str, joints: np.ndarray) -> MotionClip:
    return MotionClip(label, joints.astype(np.float32), ("a person moves.",), (label,), "normal")


CLIPS = [clip("walk", walk(60)), clip("bow", stand(60, bow=1.2)), clip("walk", walk(50, speed=0.06))]


def test_cases_are_of_all_kinds_and_two_poses_make_an_in_between() -> None:
    cases = inpainting.pose_cases(CLIPS, 2)
    assert cases.keys() == {*inpainting.KINDS, inpainting.BETWEEN} - {"hand"}, "no clip here raises one"
    for between, start, end in zip(cases["between"], cases["start"], cases["end"], strict=True):
        assert [type(each) for each in between.constraints] == [StartPose, EndPose]
        assert between.constraints == (*start.constraints, *end.constraints) and between.seed == start.seed


def test_both_spaces_are_measured_alike(toy: MotionPipeline, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("spacy")
    monkeypatch.setattr(inpainting, "KINDS", ("end",))
    monkeypatch.setattr(inpainting, "EDITS", inpainting.EDITS[:1])
    evaluator: Any = Evaluator()
    result = inpainting.measure(toy, CLIPS, 2, 1, evaluator)
    assert list(result["kinds"]) == ["end"]
    for summary in (result["kinds"]["end"][space] for space in inpainting.WAYS):
        assert summary["cases"] == 2 and summary["corrected"]["miss_mean"] < summary["plain"]["miss_mean"]
        assert summary["time"]["corrected"] > 0 and "joints" not in summary["rows"][0]["plain"]
    assert result["edits"]["latent"]["time_of_pulled"] == 1.0
    assert all(result["edits"][space]["kept"] < 0.02 for space in inpainting.WAYS)
    table = inpainting.markdown_table(result)
    assert "| end | held, skeleton | " in table and "| pulled, latent | " in table
