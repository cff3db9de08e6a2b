"""Skeleton space carried over: to a bundle of the same graph encoder and normalisation, and to no other."""

from __future__ import annotations

import dataclasses
import shutil
from pathlib import Path

import pytest

pytest.importorskip("torch")
onnx = pytest.importorskip("onnx")

from kinegraph.bench import GRAPH
from kinegraph.bundle.contract import FRAME_FILES, FRAMES
from kinegraph.bundle.manifest import Manifest
from kinegraph.bundle.reader import read_bundle
from kinegraph.errors import InvalidInputError
from kinegraph.pipeline import MotionPipeline
from kinegraph_export.bundle_changes import with_graphs, write_files
from kinegraph_export.carry_frames import carry_frames
from support.toy import TOY_BUNDLE


def without_frames(manifest: Manifest) -> Manifest:
    """Take skeleton space off a manifest."""
    return dataclasses.replace(
        manifest,
        files={name: entry for name, entry in manifest.files.items() if name not in FRAME_FILES},
        operators={name: entry for name, entry in manifest.operators.items() if name not in FRAME_FILES},
        parity={name: value for name, value in manifest.parity.items() if not name.startswith("frames_")},
        frames_part=None,
    )


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Copy the toy without its skeleton space."""
    shutil.copytree(TOY_BUNDLE, tmp_path / "bundle")
    for name in FRAME_FILES:
        (tmp_path / "bundle" / name).unlink()
    write_files(tmp_path / "bundle", without_frames(read_bundle(TOY_BUNDLE).manifest))
    return tmp_path / "bundle"


def test_what_is_carried_over_makes_the_same_clips(folder: Path) -> None:
    source = read_bundle(TOY_BUNDLE).manifest
    with pytest.raises(InvalidInputError):
        MotionPipeline.load(folder).in_space(FRAMES)
    parity = carry_frames(folder, TOY_BUNDLE)
    assert parity and read_bundle(folder).manifest == source
    ours, theirs = (
        MotionPipeline.load(path).generate(GRAPH, seconds=2.0, seed=3, space=FRAMES) for path in (folder, TOY_BUNDLE)
    )
    assert (ours.joints == theirs.joints).all()


def refused(folder: Path, source: Path, why: str) -> None:
    """Check that nothing is carried over, and that nothing of the folder changes."""
    before = {path.name: path.read_bytes() for path in folder.iterdir()}
    with pytest.raises(InvalidInputError, match=why):
        carry_frames(folder, source)
    assert {path.name: path.read_bytes() for path in folder.iterdir()} == before


def test_a_bundle_without_skeleton_space_gives_none(folder: Path) -> None:
    refused(folder, folder, "has no skeleton space")


def test_features_of_another_scale_are_refused(folder: Path) -> None:
    manifest = read_bundle(folder).manifest
    std = tuple(value * 1.01 for value in manifest.features.std)
    write_files(folder, dataclasses.replace(manifest, features=dataclasses.replace(manifest.features, std=std)))
    refused(folder, TOY_BUNDLE, "another normalisation of features")


def test_another_graph_encoder_is_refused(folder: Path) -> None:
    model = onnx.load(folder / "graph_encoder.onnx")
    for tensor in model.graph.initializer:
        values = onnx.numpy_helper.to_array(tensor)
        if values.ndim == 2:
            tensor.CopyFrom(onnx.numpy_helper.from_array(values * 1.05, tensor.name))
    files = {"graph_encoder.onnx": model.SerializeToString()}
    write_files(folder, with_graphs(read_bundle(folder).manifest, files, {}), files)
    refused(folder, TOY_BUNDLE, "graph encoders .* differ")
