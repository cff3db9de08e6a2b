"""A bundle of released networks, which several test files run: exporting it takes a while."""

from __future__ import annotations

from pathlib import Path

import pytest

from kinegraph import MotionPipeline
from support.shared import SHARED
from support.workers import shared_folder

FIXTURES = SHARED / "fixtures" / "official"


@pytest.fixture(scope="session")
def graphmotion_files(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """A checkpoint of GraphMotion, CLIP and statistics: the official modules' random weights where they are at hand."""
    pytest.importorskip("torch")
    pytest.importorskip("safetensors")
    from support.official import graphmotion_tensors, write_clip, write_lightning, write_statistics

    folder = tmp_path_factory.mktemp("graphmotion")
    official = FIXTURES / "gm_small.weights.safetensors"
    made = folder / "GraphMotion.ckpt"
    return {
        "checkpoint": official if official.is_file() else write_lightning(made, graphmotion_tensors()),
        "clip": write_clip(folder / "clip"),
        "stats": write_statistics(folder / "stats"),
    }


@pytest.fixture(scope="session")
def graphmotion_bundle(graphmotion_files: dict[str, Path], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of a float32 bundle that runs sentences as the released evaluation does; only read it."""
    pytest.importorskip("onnx")
    from kinegraph_export.import_graphmotion import import_graphmotion
    from support.tracing import traced_once

    out = tmp_path_factory.mktemp("imported") / "graphmotion"
    with traced_once(shared_folder(tmp_path_factory, "traces")):
        import_graphmotion(**graphmotion_files, out=out, precision="fp32", heads=(4, 4))
    return out


@pytest.fixture(scope="session")
def graphmotion(graphmotion_bundle: Path) -> MotionPipeline:
    """The bundle, loaded."""
    return MotionPipeline.load(graphmotion_bundle, threads=1)
