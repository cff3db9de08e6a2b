"""The bundle `open` as it is shipped: nothing in it has terms against trade, and it does what people ask for most."""

from __future__ import annotations

import json
import re
from dataclasses import asdict

import pytest

from kinegraph import MotionPipeline
from kinegraph.bundle.contract import FRAMES
from kinegraph.bundle.reader import BUNDLES, SHARED, read_bundle
from kinegraph.errors import InvalidInputError

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
    said = json.dumps([asdict(manifest.licence), manifest.provenance, manifest.training_data, manifest.training])
    assert AGAINST_TRADE.search(said) is None and "Apache-2.0" in manifest.licence.weights
    assert AGAINST_TRADE.search(json.dumps(default.provenance)) is not None, "the pattern finds nothing"
    for source in ("CMU", "SmartBody", "SNU", "SkillMimic"):
        assert source in manifest.licence.data and source in manifest.training_data


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
    graphs = [name for name in opened.files if name.endswith(".onnx") and name != "text_encoder.onnx"]
    same = [name for name in graphs if opened.files[name].sha256 == default.files[name].sha256]
    assert len(graphs) > 20 and same == []


def test_it_knows_no_skeleton_space_and_says_what_to_do(opened: MotionPipeline) -> None:
    with pytest.raises(InvalidInputError, match="add_frames"):
        opened.generate("a person walks", seconds=2, seed=1, space=FRAMES)
