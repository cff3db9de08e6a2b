"""The bundle `open` as it is shipped: nothing in it has terms against trade, and it does what people ask for most."""

from __future__ import annotations

import json
import re
from dataclasses import asdict

import numpy as np
import pytest
from numpy.typing import NDArray

from kinegraph import MotionPipeline
from kinegraph.bundle.contract import FRAMES
from kinegraph.bundle.reader import BUNDLES, SHARED, read_bundle
from kinegraph.errors import InvalidInputError
from kinegraph.motion.skeleton import JOINT_INDEX

pytestmark = pytest.mark.release

AGAINST_TRADE = re.compile(r"\bNC\b|non-?commercial|bandai|\bKIT\b|HumanML3D", re.IGNORECASE)
MOST_BYTES = 64_000_000
MOST_OF_BOTH = 110_000_000
"""Of all installed bundles, before compression; their wheel has less than 100 MB."""


@pytest.fixture(scope="module")
def opened() -> MotionPipeline:
    return MotionPipeline.load("open", threads=1)


def test_nothing_that_it_says_of_its_origin_is_against_trade() -> None:
    manifest, default = read_bundle("open").manifest, read_bundle(None).manifest
    said = json.dumps([asdict(manifest.licence), dict(manifest.provenance), dict(manifest.training)])
    assert AGAINST_TRADE.search(said) is None and "Apache-2.0" in manifest.licence.weights
    assert AGAINST_TRADE.search(json.dumps(dict(default.provenance))) is not None, "the pattern finds nothing"
    for source in ("CMU", "SmartBody", "SNU", "SkillMimic"):
        assert source in manifest.licence.data and source in manifest.provenance["training_data"]


def test_it_has_its_own_weights_for_arguments_and_shares_the_rest_of_what_reads_text() -> None:
    manifest, default = read_bundle("open").manifest, read_bundle(None).manifest
    own = {path.name for path in (BUNDLES / "open").iterdir()}
    shared = {path.name for path in (BUNDLES / SHARED).iterdir()}
    assert own & shared == {"arguments.npz"} and own | shared == {"manifest.json", *manifest.files}
    assert manifest.files["arguments.npz"].sha256 != default.files["arguments.npz"].sha256
    assert manifest.precision == "int8" and sum(entry.bytes for entry in manifest.files.values()) <= MOST_BYTES
    assert sum(path.stat().st_size for path in BUNDLES.rglob("*") if path.is_file()) <= MOST_OF_BOTH


def test_a_denoiser_of_it_is_none_of_the_other_bundle() -> None:
    opened, default = read_bundle("open").manifest, read_bundle(None).manifest
    without_weights = {"text_encoder.onnx", *(name for name in opened.files if name.endswith("_vjp.onnx"))}
    graphs = [name for name in opened.files if name.endswith(".onnx") and name not in without_weights]
    same = [name for name in graphs if opened.files[name].sha256 == default.files[name].sha256]
    assert len(graphs) >= 19 and same == []


def test_it_knows_no_skeleton_space_and_says_what_to_do(opened: MotionPipeline) -> None:
    with pytest.raises(InvalidInputError, match="add_frames"):
        opened.generate("a person walks", seconds=2, seed=1, space=FRAMES)


def test_it_walks_runs_stands_jumps_and_raises_hands(opened: MotionPipeline) -> None:
    def clips(text: str) -> list[NDArray[np.float32]]:
        return [opened.generate(text, seconds=4, seed=seed).joints for seed in range(3)]

    def travelled(text: str) -> float:
        return float(np.median([np.linalg.norm(joints[-1, 0] - joints[0, 0]) for joints in clips(text)]))

    walked, ran = travelled("a person walks forward"), travelled("a person runs")
    assert 2 < walked < 7 and ran > 1.5 * walked and travelled("a person stands still") < 0.4
    wrists, toes = ([JOINT_INDEX[f"{side}_{name}"] for side in ("left", "right")] for name in ("wrist", "foot"))
    raised = clips("a person raises both hands")
    above = [joints[:, wrists, 1].min(axis=1).max() - joints[0, JOINT_INDEX["head"], 1] for joints in raised]
    assert np.median(above) > 0, "both hands above the head"
    assert np.median([joints[:, toes, 1].min(axis=1).max() for joints in clips("a person jumps up")]) > 0.15
