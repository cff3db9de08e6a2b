"""Write a bundle of released networks: what GraphMotion's and MLD's importers share."""

from __future__ import annotations

import io
import platform
import shutil
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Final, Literal

import numpy as np
import onnxruntime
import torch

import kinegraph
from kinegraph.arrays import FloatArray
from kinegraph.bundle.contract import FORMAT_VERSION, Family, levels_of
from kinegraph.bundle.manifest import (
    Defaults,
    FeatureSpec,
    FileSpec,
    FrameSpec,
    Licence,
    Manifest,
    ScheduleSpec,
    SkeletonSpec,
    TextSpec,
    describe_file,
    encode_manifest,
)
from kinegraph.bundle.onnx_inspect import summarise
from kinegraph.bundle.reader import text_files_folder
from kinegraph.bundle.tables import EMPTY_CAPTION
from kinegraph.errors import InvalidInputError, OutputError
from kinegraph.graph import ROLES
from kinegraph.motion import kit_ml
from kinegraph.motion.skeleton import JOINT_NAMES, PARENTS
from kinegraph.pipeline import MotionPipeline
from kinegraph_export.clip_text_encoder import ClipAssets
from kinegraph_export.graphs import Precision
from kinegraph_export.official.checkpoint import GraphMotionModels, MldModels
from kinegraph_export.official.graphs import export_networks, level_specs

PARSER_FILES = ("parser.bin", "arguments.npz")
"""Taken from another bundle, so that plain sentences work."""


@dataclass(frozen=True)
class DataSet:
    """What a bundle says of the data that its networks were trained on."""

    name: str
    layout: Literal["humanml3d-263", "kit-251"]
    fps: float
    frames: FrameSpec
    """Lengths of its clips."""
    licence: str


DATA_SETS: Final = {
    263: DataSet(
        "HumanML3D", "humanml3d-263", 20.0, FrameSpec(40, 196, 1), "HumanML3D and AMASS: research, not commercial"
    ),
    251: DataSet("KIT-ML", "kit-251", kit_ml.FPS, FrameSpec(24, 196, 1), "KIT-ML: terms of its database"),
}
"""Width of the features -> data set."""
STEPS, GUIDANCE, SECONDS = 50, 7.5, 6.0
"""As published, but for the seconds: the released code takes lengths from the data."""


@dataclass(frozen=True)
class Origin:
    """Where a model is from, and what it is called."""

    name: str
    """Of the bundle."""
    model: str
    """In words."""
    licence: str
    """Of its code, for the manifest."""
    checkpoint: Path


class StagedFiles:
    """Files of a bundle in a folder of its own, each forgotten once it is written: together they are gigabytes."""

    def __init__(self, folder: Path) -> None:
        folder.mkdir()
        self.folder = folder
        self.described: dict[str, FileSpec] = {}
        self.operators: dict[str, tuple[str, ...]] = {}
        """Of each graph."""

    def add(self, name: str, content: bytes) -> None:
        """Write a file, and describe it for the manifest."""
        (self.folder / name).write_bytes(content)
        self.described[name] = describe_file(content)
        if name.endswith(".onnx"):
            self.operators[name] = summarise(content, name).operators

    def add_manifest(self, manifest: Manifest) -> None:
        """Write the manifest."""
        (self.folder / "manifest.json").write_bytes(encode_manifest(manifest))


def check_sizes(text_width: int, features: int, clip_width: int) -> None:
    """Check that the networks fit the text encoder and a body that is known.

    Args:
        text_width: of the text features that the networks take.
        features: of the motion.
        clip_width: of the text encoder.

    Raises:
        InvalidInputError: they do not.
    """
    if clip_width != text_width:
        raise InvalidInputError(
            f"the checkpoint was trained with a text encoder {text_width} wide, and --clip is {clip_width} wide: take "
            "openai/clip-vit-large-patch14 (768) for the published checkpoints"
        )
    if features not in DATA_SETS:
        known = " or ".join(f"{width} ({data.name})" for width, data in DATA_SETS.items())
        raise InvalidInputError(f"the checkpoint has {features} features; published ones have {known}")


def check_target(out: Path) -> None:
    """Check that a folder may be written: it is new, or a bundle.

    Raises:
        OutputError: it is something else.
    """
    if out.exists() and not (out / "manifest.json").is_file():
        raise OutputError(f"{out} exists and is not a bundle; name another folder")


def read_parser(bundle: Path | None) -> dict[str, bytes]:
    """Read the files of the sentence parser from a bundle; None is the one that comes with the package.

    Raises:
        InvalidInputError: it has no parser.
    """
    folder = text_files_folder() if bundle is None else bundle
    files = {name: (folder / name).read_bytes() for name in PARSER_FILES if (folder / name).is_file()}
    if PARSER_FILES[0] not in files:
        raise InvalidInputError(f"{folder} has no {PARSER_FILES[0]}; name a bundle with a parser (--parser)")
    return files


def write_imported(
    out: Path,
    origin: Origin,
    models: GraphMotionModels | MldModels,
    family: Family,
    clip: ClipAssets,
    statistics: tuple[FloatArray, FloatArray],
    parser: dict[str, bytes],
    precision: Precision,
) -> Manifest:
    """Export all networks, write the bundle, load it once, and put it in place; an older one is replaced.

    Raises:
        ParityError: a graph differs from its module.
    """
    buffer = io.BytesIO()
    np.savez(buffer, **{EMPTY_CAPTION: clip.empty_caption})
    files = {
        **parser,
        "text_encoder.onnx": clip.text_encoder,
        "tokenizer.json": clip.tokenizer,
        "tables.npz": buffer.getvalue(),
    }
    out.parent.mkdir(parents=True, exist_ok=True)
    # beside `out`: gigabytes are not copied between disks, and a folder appears whole or not at all
    with tempfile.TemporaryDirectory(dir=out.parent) as folder:
        staged = StagedFiles(Path(folder) / "bundle")
        for name, content in files.items():
            staged.add(name, content)
        parity = dict(clip.parity)
        for name, content, differences in export_networks(models, family, precision):
            staged.add(name, content)
            parity |= differences
        manifest = build_manifest(origin, models, family, clip, statistics, staged, parity, precision)
        staged.add_manifest(manifest)
        MotionPipeline.load(staged.folder)
        shutil.rmtree(out, ignore_errors=True)
        staged.folder.rename(out)
    return manifest


def build_manifest(
    origin: Origin,
    models: GraphMotionModels | MldModels,
    family: Family,
    clip: ClipAssets,
    statistics: tuple[FloatArray, FloatArray],
    files: StagedFiles,
    parity: dict[str, float],
    precision: Precision,
) -> Manifest:
    """Build the manifest of an imported bundle."""
    mean, std = statistics
    data = DATA_SETS[len(mean)]
    shortest, longest = data.frames.min / data.fps, data.frames.max / data.fps
    levels = levels_of(family)
    return Manifest(
        format_version=FORMAT_VERSION,
        name=origin.name,
        version="imported",
        licence=Licence(
            code=origin.licence,
            weights="those of the checkpoint's authors",
            data=data.licence,
            text_encoder="MIT (OpenAI CLIP)",
            parser="MIT",
        ),
        provenance={
            "training_data": data.name,
            "checkpoint": origin.checkpoint.name,
            "model": origin.model,
            "built_with": f"kinegraph {kinegraph.__version__}, torch {torch.__version__}, onnxruntime "
            f"{onnxruntime.__version__}, Python {platform.python_version()}",
        },
        scope={
            "actions": f"those of {data.name}",
            "length": f"{shortest:.1f} to {longest:.1f} seconds, which the denoisers do not know",
        },
        skeleton=SkeletonSpec(JOINT_NAMES, PARENTS),
        fps=data.fps,
        frames=data.frames,
        features=FeatureSpec(data.layout, "humanml3d", tuple(map(float, mean)), tuple(map(float, std))),
        text=TextSpec(clip.empty_caption.shape[1], "<|endoftext|>", clip.positions),
        levels=level_specs(models),
        schedule=ScheduleSpec(1000, 8.5e-4, 0.012, 1, "leading", "epsilon"),
        defaults=Defaults(dict.fromkeys(levels, STEPS), dict.fromkeys(levels, GUIDANCE), "structure", SECONDS),
        roles=ROLES,
        precision=precision,
        files=dict(sorted(files.described.items())),
        operators=dict(sorted(files.operators.items())),
        parity=parity,
        training={},
        quality={},
        family=family,
    )
