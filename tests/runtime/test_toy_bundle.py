"""The toy bundle of the tests: small, whole, and trained well enough that its clips follow their captions."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from kinegraph import MotionPipeline
from kinegraph.bundle.contract import FRAME_GRAPHS, GRAPHS, OPTIONAL_GRAPHS
from kinegraph.bundle.reader import read_bundle
from kinegraph.motion.skeleton import JOINT_INDEX
from support.toy import PARSER_FILES, TOY_BUNDLE

MOST_BYTES = 3_000_000


def test_it_is_small_and_has_every_graph_in_float32() -> None:
    manifest = read_bundle(TOY_BUNDLE).manifest
    assert sum(path.stat().st_size for path in TOY_BUNDLE.iterdir()) <= MOST_BYTES
    assert manifest.precision == "fp32" and not set(PARSER_FILES) & set(manifest.files)
    graphs = {name.removesuffix(".onnx") for name in manifest.files if name.endswith(".onnx")}
    assert graphs == {*GRAPHS, *OPTIONAL_GRAPHS, *FRAME_GRAPHS}


def test_its_parser_is_that_of_the_default_bundle(toy_bundle: Path) -> None:
    files = read_bundle(toy_bundle).manifest.files
    assert {name: files[name] for name in PARSER_FILES} == {
        name: read_bundle(None).manifest.files[name] for name in PARSER_FILES
    }


def test_its_clips_follow_their_captions(toy: MotionPipeline) -> None:
    pytest.importorskip("spacy")

    def joints_of(text: str) -> np.ndarray:
        return np.stack([clip.joints for clip in toy.takes(text, 4, seed=1)])

    def speed(text: str) -> float:
        floor = joints_of(text)[:, :, 0][..., [0, 2]]
        return float(np.linalg.norm(np.diff(floor, axis=1), axis=-1).mean() * 20.0)

    def highest(text: str, joint: str) -> float:
        return float(joints_of(text)[:, :, JOINT_INDEX[joint], 1].max(axis=1).min())

    assert speed("a person stands still") < 0.1 < speed("a person walks slowly") < 0.6
    assert 0.8 < speed("a person walks forward") < 1.6 < 2.4 < speed("a person runs")
    # +X is to the left of who looks along +Z
    assert joints_of("a person walks to the left")[:, -1, 0, 0].min() > 0.2
    assert joints_of("a person walks to the right")[:, -1, 0, 0].max() < -0.2
    for side, other in (("left", "right"), ("right", "left")):
        text = f"a person waves the {side} hand"
        assert highest(text, f"{side}_wrist") > 1.6 and highest(text, f"{other}_wrist") < 1.2
    assert joints_of("a person bows")[:, :, JOINT_INDEX["head"], 1].min(axis=1).max() < 1.45
