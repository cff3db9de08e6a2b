"""Export a training run to a bundle, and validate it.

    python -m kinegraph_export.export_bundle --run runs/edge --assets assets --card card.json --out bundle

Every graph but the text encoder, which is an asset, is compared with its torch module, and the whole pipeline behind it
with torch; the differences are in the manifest.
"""

from __future__ import annotations

import argparse
import dataclasses
import io
import json
import platform
import shutil
import sys
import tempfile
from pathlib import Path
from typing import Literal, get_args

import numpy as np
import onnxruntime
import torch

import kinegraph
from kinegraph.arrays import FloatArray
from kinegraph.bundle.contract import FORMAT_VERSION
from kinegraph.bundle.manifest import (
    Defaults,
    FeatureSpec,
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
from kinegraph.bundle.tables import bones_of
from kinegraph.bundle.vocabulary import FILE as VOCABULARY
from kinegraph.diffusion.sampling import LevelPlan, initial_noise
from kinegraph.errors import InvalidInputError, OutputError
from kinegraph.graph import ROLES
from kinegraph.motion.postprocess import enforce_bone_lengths
from kinegraph.motion.skeleton import JOINT_NAMES, PARENTS
from kinegraph.options import resolve_options
from kinegraph.pipeline import MotionPipeline
from kinegraph.text.argument_classifier import read_provenance
from kinegraph_export.checkpoints import read_run
from kinegraph_export.clip_text_encoder import END
from kinegraph_export.graphs import (
    FLOAT32_GRAPHS,
    INT8_WEIGHT_GRAPHS,
    Precision,
    TrainedModels,
    export_graphs,
    level_specs,
)
from kinegraph_export.parity import ParityError
from kinegraph_export.pinned_wheels import MINILM, SPACY_MODEL
from kinegraph_export.pipeline_parity import SamplingRequest, torch_joints
from kinegraph_export.vocabulary import build_vocabulary
from kinegraph_training.bundle_tables import read_tables
from kinegraph_training.data.caption_cache import CaptionEncoder, read_assets
from kinegraph_training.data.shown_captions import read_shown_captions
from kinegraph_training.latents import TrainedVae
from kinegraph_training.layouts import layout_of

PROMPTS = (
    "a person walks forward", "someone runs", "a person raises the left hand", "a man waves with both hands",
    "a person turns left while walking", "an old person walks slowly", "the figure turns right", "somebody bows",
    "a tired person walks forward", "a person raises the right arm and lowers it again", "a child waves goodbye",
    "a person walks forward while waving the right hand", "someone runs, then bows", "a person jogs happily",
    "a person raises both hands above the head", "a person walks backwards", "a woman waves the left hand",
    "the person dashes forward", "a person walks to the left", "someone waves, then walks away proudly",
)  # fmt: skip
CLIP_PIECES = 77
"""Word pieces that CLIP has positions for."""
MAX_PIPELINE_MM: dict[Precision, float] = {"fp32": 1.0, "int8": 100.0}
"""Largest mean joint distance, mm, of the runtime to torch and of a batch to single clips, with the same noise.

In int8 it guards against a broken bundle only; `kinegraph_benchmarks.quality.precision` is the gate."""


@dataclasses.dataclass(frozen=True)
class BundleCard:
    """The part of a manifest that a person writes, read from a JSON file with these keys."""

    name: str
    version: str
    licence: Licence
    training_data: str
    scope: dict[str, str]
    training: dict[str, str | float | int]
    steps: dict[str, int]
    guidance: dict[str, float]
    guidance_base: Literal["empty", "coarse"]
    seconds: float
    quality: dict[str, float]
    spacing: Literal["leading", "trailing"] = "leading"
    """Of the diffusion steps, see `kinegraph.diffusion.sampling.NoiseSchedule`."""

    @staticmethod
    def read(path: Path) -> BundleCard:
        """Read a card.

        Raises:
            InvalidInputError: the file is missing or no JSON, or keys are missing or unknown.
        """
        try:
            fields = json.loads(path.read_text(encoding="utf-8"))
            return BundleCard(**{**fields, "licence": Licence(**fields["licence"])})
        except (OSError, ValueError, TypeError, KeyError) as error:
            raise InvalidInputError(f"{path} is no bundle card: {error}") from error


def encode_tables(tables: dict[str, FloatArray]) -> bytes:
    """Encode tables.npz, the statistics that the run took of its data."""
    buffer = io.BytesIO()
    np.savez(buffer, **tables)
    return buffer.getvalue()


def encode_vocabulary(run: Path, assets: Path) -> dict[str, bytes]:
    """Build vocabulary.npz of the captions that the run was trained on; none if they are too few or not stored.

    A run that `recover` wrote has the vocabulary of its bundle instead of captions.
    """
    shown = read_shown_captions(run)
    if not shown and (run / VOCABULARY).is_file():
        return {VOCABULARY: (run / VOCABULARY).read_bytes()}
    try:
        return {VOCABULARY: build_vocabulary(shown, CaptionEncoder(assets))} if shown else {}
    except InvalidInputError as error:
        print(f"the bundle will not tell unknown words: {error}", file=sys.stderr)
        return {}


def build_manifest(
    card: BundleCard,
    trained: TrainedModels,
    specific: TrainedVae,
    files: dict[str, bytes],
    parity: dict[str, float],
    precision: Precision,
) -> Manifest:
    """Build the manifest from the contents of all other `files`, complete but for the parity of the whole pipeline."""
    config, layout = trained.hierarchy.config, layout_of(len(specific.mean))
    is_clip = END.encode() in files["tokenizer.json"]
    graphs = {name: data for name, data in files.items() if name.endswith(".onnx")}
    operators = {name: summarise(data, name).operators for name, data in sorted(graphs.items())}
    return Manifest(
        format_version=FORMAT_VERSION,
        name=card.name,
        version=card.version,
        licence=card.licence,
        provenance={
            "training_data": card.training_data,
            "text_encoder": "CLIP's text tower" if is_clip else f"sentence-transformers/all-MiniLM-L6-v2 from {MINILM}",
            "parser": f"en_core_web_sm from {SPACY_MODEL}",
            "arguments": read_provenance(files["arguments.npz"]) if "arguments.npz" in files else "by rules alone",
            "numbers": describe_precision(operators, precision),
            "built_with": f"kinegraph {kinegraph.__version__}, torch {torch.__version__}, "
            f"onnxruntime {onnxruntime.__version__}, Python {platform.python_version()}",
        },
        scope=card.scope,
        skeleton=SkeletonSpec(JOINT_NAMES, PARENTS),
        fps=20.0,
        frames=FrameSpec(min=16, max=config.max_frames, per_token=trained.vae.config.frames_per_token),
        features=FeatureSpec(
            layout.name, layout.heading, tuple(map(float, specific.mean)), tuple(map(float, specific.std))
        ),
        text=TextSpec(config.text_width, END, CLIP_PIECES) if is_clip else TextSpec(config.text_width, "[MASK]"),
        levels=level_specs(trained),
        schedule=ScheduleSpec(config.train_steps, 8.5e-4, 0.012, 1, card.spacing, "epsilon"),
        defaults=Defaults(card.steps, card.guidance, card.guidance_base, card.seconds),
        roles=ROLES,
        precision=precision,
        files={name: describe_file(data) for name, data in sorted(files.items())},
        operators=operators,
        parity=parity,
        training=card.training,
        quality=card.quality,
    )


def describe_precision(operators: dict[str, tuple[str, ...]], precision: Precision) -> str:
    """Describe for a person how weights are stored and computed with.

    Args:
        operators: those of each graph file.
        precision: of the denoisers.
    """

    def present(graphs: tuple[str, ...]) -> str:
        return ", ".join(graph for graph in graphs if f"{graph}.onnx" in operators)

    in_blocks = "com.microsoft::MatMulNBits" in operators["text_encoder.onnx"]
    halves = "float32 arithmetic on weights stored as float16"
    networks = {
        "fp32": f"all networks: {halves}",
        "int8": "denoisers: int8, activations with one scale per tensor and run (with adaptive gradient descent, what "
        "reads and moves the context computes in float32); "
        f"{present(INT8_WEIGHT_GRAPHS)}: float32 arithmetic on weights stored as int8; "
        f"{present(FLOAT32_GRAPHS)}: {halves}",
    }[precision]
    return f"{networks}; text encoder: " + ("weights in int8 blocks" if in_blocks else "float32 throughout")


def write_bundle(folder: Path, manifest: Manifest, files: dict[str, bytes]) -> None:
    """Write all files of a bundle into a new folder."""
    folder.mkdir(parents=True)
    for name, data in files.items():
        (folder / name).write_bytes(data)
    (folder / "manifest.json").write_bytes(encode_manifest(manifest))


def pipeline_difference(folder: Path, trained: TrainedModels, specific: TrainedVae, bones: FloatArray | None) -> float:
    """Measure the mean joint distance between torch and the runtime over `PROMPTS`, mm; graphs and noise are the same.

    Args:
        folder: of the bundle.
        trained: the models that it was exported from.
        specific: the specific autoencoder with the statistics of its features.
        bones: (21,) bone lengths that the runtime enforces, metres.
    """
    pipe = MotionPipeline.load(folder)
    distances = []
    for seed, prompt in enumerate(PROMPTS):
        graph = pipe.parse(prompt)
        # The stages themselves: `generate` reads orders and negations into the sentence first, and torch does not.
        # Some are told to be captions of a part, as those of a composition are.
        features = pipe.encoder.encode_text([graph], [seed % 4 == 3])
        options = resolve_options(pipe.manifest, seed=seed, foot_fix=False)
        options = pipe.encoder.with_length(options, features)
        latents = pipe.sampler.sample(pipe.encoder.attend(features), None, [options])
        clip = pipe.decoder.decode(latents, [options], [prompt])[0]
        plans = [LevelPlan(name, spec.tokens, spec.latent_width, 1) for name, spec in pipe.manifest.levels.items()]
        sampling = pipe.manifest.defaults
        request = SamplingRequest(
            clip.frames,
            initial_noise(seed, plans),
            sampling.steps,
            sampling.guidance,
            sampling.guidance_base,
            spacing=pipe.manifest.schedule.spacing,
        )
        expected = torch_joints(trained, features[0], request, specific.mean, specific.std)
        expected = enforce_bone_lengths(expected, bones)
        distances.append(np.linalg.norm(clip.joints - expected, axis=-1).mean() * 1000.0)
    return float(np.mean(distances))


def batch_difference(folder: Path) -> float:
    """Measure the mean joint distance between clips of one batch and the same clips generated singly, mm."""
    pipe = MotionPipeline.load(folder)
    graphs = [pipe.parse(prompt) for prompt in PROMPTS]
    together = pipe.batch(graphs, seconds=2, seed=0, foot_fix=False, shared_run=True)
    alone = [pipe.generate(graph, seconds=2, seed=seed, foot_fix=False) for seed, graph in enumerate(graphs)]
    distances = [np.linalg.norm(a.joints - b.joints, axis=-1).mean() for a, b in zip(together, alone, strict=True)]
    return float(np.mean(distances)) * 1000.0


def pipeline_parity(
    folder: Path, trained: TrainedModels, specific: TrainedVae, tables: dict[str, FloatArray], precision: Precision
) -> dict[str, float]:
    """Compare whole clips of a bundle with torch, and clips of a batch with single ones; returns both, mm.

    Args:
        folder: of the bundle.
        trained: the models that it was exported from.
        specific: the specific autoencoder with the statistics of its features.
        tables: the statistics that the run took of its data.
        precision: of the denoisers.

    Raises:
        ParityError: one is larger than `MAX_PIPELINE_MM`.
    """
    differences = {
        "pipeline_mm": pipeline_difference(folder, trained, specific, bones_of(tables)),
        "batch_mm": batch_difference(folder),
    }
    for name, distance in differences.items():
        if not distance <= MAX_PIPELINE_MM[precision]:
            raise ParityError(f"{name} is {distance:.3f}, more than {MAX_PIPELINE_MM[precision]}")
    return differences


def export_bundle(run: Path, assets: Path, card: BundleCard, out: Path, precision: Precision = "int8") -> Manifest:
    """Export a run, validate the bundle, and put it in place; a bundle that was there before is replaced.

    Args:
        run: folder of the training run.
        assets: folder of the text files.
        card: what a person wrote.
        out: folder of the bundle.
        precision: of the denoisers.

    Raises:
        OutputError: `out` is a folder of something else.
        InvalidInputError: a stage or a text asset is missing.
        ParityError: a graph or the whole pipeline differs from torch.
    """
    if out.exists() and not (out / "manifest.json").is_file():
        raise OutputError(f"{out} exists and is not a bundle; name another folder")
    trained, specific = read_run(run)
    graphs, parity = export_graphs(trained, trained.hierarchy.config.text_width, len(specific.mean), precision)
    tables = read_tables(run)
    files = read_assets(assets) | graphs
    files["tables.npz"] = encode_tables(tables)
    files |= encode_vocabulary(run, assets)
    draft = build_manifest(card, trained, specific, files, parity, precision)
    with tempfile.TemporaryDirectory() as folder:
        staged = Path(folder) / "bundle"
        write_bundle(staged, draft, files)
        differences = pipeline_parity(staged, trained, specific, tables, precision)
        manifest = dataclasses.replace(draft, parity={**parity, **differences})
        (staged / "manifest.json").write_bytes(encode_manifest(manifest))
        put_in_place(staged, out)
    return manifest


def put_in_place(staged: Path, out: Path) -> None:
    """Copy a folder beside `out`, and only then put it in place of what is there."""
    out.parent.mkdir(parents=True, exist_ok=True)
    new, old = (out.with_name(f".{out.name}.{which}") for which in ("new", "old"))
    for folder in (new, old):
        shutil.rmtree(folder, ignore_errors=True)
    shutil.copytree(staged, new)
    if out.exists():
        out.rename(old)
    new.rename(out)
    shutil.rmtree(old, ignore_errors=True)


def main(argv: list[str] | None = None) -> None:
    """Run the command line."""
    parser = argparse.ArgumentParser(prog="kinegraph_export.export_bundle", description=__doc__.split("\n")[0])
    parser.add_argument("--run", type=Path, required=True, help="folder of the training run")
    parser.add_argument("--assets", type=Path, required=True, help="folder with the text files")
    parser.add_argument("--card", type=Path, required=True, help="JSON: name, version, licences, defaults, quality")
    parser.add_argument("--out", type=Path, required=True, help="folder of the bundle")
    parser.add_argument("--precision", choices=get_args(Precision), default="int8", help="of the denoisers")
    options = parser.parse_args(argv)
    card = BundleCard.read(options.card)
    manifest = export_bundle(options.run, options.assets, card, options.out, options.precision)
    for name, difference in manifest.parity.items():
        print(f"{name:20s} {difference:.2e}")
    size = sum(entry.bytes for entry in manifest.files.values())
    print(f"{size / 1e6:.1f} MB in {options.out}", file=sys.stderr)


if __name__ == "__main__":
    main()
