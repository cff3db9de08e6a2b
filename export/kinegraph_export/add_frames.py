"""Add skeleton space to a bundle: the graphs of a denoiser of frames (EnergyMoGen, appendix A and B).

    python -m kinegraph_export.add_frames --bundle BUNDLE --run runs/studio

`--run` is where `kinegraph_training.train_frames` wrote frames/last.ckpt, over the graph encoder and the normalisation
of this very bundle. No other file of the bundle is changed. Every graph is compared with its torch module, and whole
clips with torch, as in `export_bundle`.
"""

from __future__ import annotations

import argparse
import dataclasses
from pathlib import Path
from typing import Any, get_args

import numpy as np
import torch
from torch import Tensor, nn

from kinegraph.arrays import FloatArray
from kinegraph.bundle.contract import (
    FORMAT_VERSION,
    FRAME_FILES,
    FRAME_GRAPHS,
    FRAMES,
    FRAMES_DENOISER,
    FRAMES_DENOISER_AGD,
    LEVELS,
    LevelSpec,
)
from kinegraph.bundle.frames_part import FramesPart, frame_contracts
from kinegraph.bundle.manifest import Manifest
from kinegraph.bundle.reader import read_bundle
from kinegraph.conditioning import GraphArrays
from kinegraph.errors import InvalidInputError
from kinegraph.motion.features import LAYOUT
from kinegraph.motion.fusion import fused_joints
from kinegraph.motion.postprocess import enforce_bone_lengths
from kinegraph.options import resolve_options
from kinegraph.pipeline import MotionPipeline
from kinegraph_export.bundle_changes import unchanged_if_it_fails, with_graphs, write_files
from kinegraph_export.checkpoints import check_normalisation
from kinegraph_export.export_bundle import MAX_PIPELINE_MM, PROMPTS
from kinegraph_export.graphs import Precision, export_graph
from kinegraph_export.modules import (
    AgdDenoiserGraph,
    DenoiserGraph,
    ModulationGraph,
    MotionAgdContextGraph,
    MotionContextGraph,
)
from kinegraph_export.onnx_export import round_weights
from kinegraph_export.parity import ParityError
from kinegraph_export.pipeline_parity import alpha_bar, as_batch, level_conditions
from kinegraph_export.shared_weights import without_shared
from kinegraph_training.checkpoints import read_checkpoint
from kinegraph_training.config import FrameConfig
from kinegraph_training.layouts import layout_of
from kinegraph_training.models.agd import AgdNoisePredictor
from kinegraph_training.models.concat_denoiser import ConcatDenoiser
from kinegraph_training.models.denoiser import Denoiser, DenoiserConfig, LatentShape
from kinegraph_training.models.hierarchy import Hierarchy

STEPS, GUIDANCE = 20, 2.5
"""Of a call that leaves them out, unless the command says otherwise."""


@dataclasses.dataclass(frozen=True)
class TrainedFrames:
    """A skeleton-space denoiser in evaluation mode, with weights rounded to what a bundle stores."""

    hierarchy: Hierarchy
    """With the graph encoder that it was trained over."""
    latent: LatentShape
    frames: FrameConfig

    @property
    def denoiser(self) -> Any:
        """Return the denoiser, a `FrameDenoiser`; a `ConcatDenoiser` in comparisons."""
        return self.hierarchy.levels[FRAMES]

    @property
    def config(self) -> DenoiserConfig:
        """Return the configuration of the network."""
        return self.hierarchy.config

    def part(self, steps: int, guidance: float) -> FramesPart:
        """Describe it as the manifest does."""
        config = self.config
        level = LevelSpec(
            tokens=self.latent.tokens,
            latent_width=self.latent.width,
            width=config.width,
            heads=config.heads,
            layers=config.layers,
            nodes=config.kinds_seen(FRAMES),
        )
        frames = self.frames
        return FramesPart(
            level, frames.frames_per_token, frames.scale, steps, guidance, "clean", beta_end=frames.beta_end
        )

    def modules(self) -> dict[str, nn.Module]:
        """Wrap it as graphs, by the graph's name."""
        denoiser = self.denoiser
        modules: list[nn.Module] = [
            MotionContextGraph(denoiser.context),
            ModulationGraph(denoiser.clock),
            DenoiserGraph(denoiser.step),
            MotionAgdContextGraph(denoiser.context),
            AgdDenoiserGraph(AgdNoisePredictor(denoiser)),
        ]
        return {name: module.eval() for name, module in zip(FRAME_GRAPHS, modules, strict=True)}


def read_frames(checkpoint: Path) -> TrainedFrames:
    """Load the averaged weights of a skeleton-space denoiser.

    Raises:
        InvalidInputError: there is none.
    """
    if not checkpoint.is_file():
        raise InvalidInputError(f"{checkpoint} is missing; train it: python -m kinegraph_training.train_frames")
    state = read_checkpoint(checkpoint)
    settings = state["hyper_parameters"]
    config, latent = DenoiserConfig(**settings["config"]), LatentShape(**settings["latents"][FRAMES])
    hierarchy, prefix = Hierarchy(config, {FRAMES: latent}), "hierarchy."
    weights = {name.removeprefix(prefix): w for name, w in state["state_dict"].items() if name.startswith(prefix)}
    hierarchy.load_state_dict(weights)
    round_weights(hierarchy.eval())
    return TrainedFrames(hierarchy, latent, FrameConfig(**settings["frames"]))


def check_fits(trained: TrainedFrames, manifest: Manifest) -> None:
    """Refuse a network that was not trained over a bundle of this kind.

    Raises:
        InvalidInputError: a network for comparison only; another format, family, text encoder or feature layout.
    """
    if trained.config.kind != "frames" or not trained.frames.from_latent:
        raise InvalidInputError(
            f"a bundle takes a network of kind 'frames' that was trained over its graph encoder, not kind "
            f"{trained.config.kind!r}, from_latent {trained.frames.from_latent}"
        )
    if manifest.format_version != FORMAT_VERSION or manifest.family != "kinegraph":
        raise InvalidInputError(
            f"only bundles of kinegraph's own networks of format {FORMAT_VERSION} have skeleton space, not format "
            f"{manifest.format_version}, family {manifest.family!r}; export the bundle again first"
        )
    expected = {
        "width of the text": (trained.config.text_width, manifest.text.width),
        "features of a frame": (trained.latent.width // trained.frames.frames_per_token, len(manifest.features.mean)),
    }
    for what, (ours, theirs) in expected.items():
        if ours != theirs:
            raise InvalidInputError(
                f"the {what} is {ours} in training and {theirs} in the bundle: another bundle's run"
            )


@torch.no_grad()
def torch_frames(trained: TrainedFrames, pipe: MotionPipeline, prompt: str, seed: int, frames: int) -> FloatArray:
    """Sample the joints (frames, 22, 3) of a sentence in torch, one prediction at a time, as the reference.

    Nodes are those of the graph encoder that the network was trained over, which must be the bundle's.
    """
    manifest, part = pipe.manifest, pipe.manifest.frames_part
    assert part is not None
    (graph,) = pipe.encoder.encode_text([pipe.parse(prompt)], [seed % 4 == 3])
    nodes = trained.hierarchy.encode(as_batch(graph))[0]
    mean, std = (np.array(values, dtype=np.float32) for values in (manifest.features.mean, manifest.features.std))
    joints = sample_frames(trained.denoiser, graph, nodes, part, seed, frames, mean, std)
    return enforce_bone_lengths(joints, pipe.decoder.bones)


def sample_frames(
    denoiser: Denoiser | ConcatDenoiser,
    graph: GraphArrays,
    nodes: Tensor,
    part: FramesPart,
    seed: int,
    frames: int,
    mean: FloatArray,
    std: FloatArray,
) -> FloatArray:
    """Sample the joints (frames, 22, 3) of an encoded graph in torch by guided DDIM on clean predictions.

    Args:
        denoiser: of skeleton space.
        graph: kinds, order and weights of the nodes.
        nodes: (n, d) encoded nodes.
        part: sizes, steps, guidance and schedule.
        seed: of the noise.
        frames: of the clip.
        mean: (f,) of the features.
        std: (f,) of the same.
    """
    conditions = level_conditions(denoiser, graph, nodes, part.level.nodes, None, empty=True)
    tokens = part.token_count(frames)
    rng = np.random.Generator(np.random.PCG64(seed))
    latent = torch.from_numpy(rng.standard_normal((tokens, part.level.latent_width), dtype=np.float32))[None]
    alphas, stride = alpha_bar(beta_end=part.beta_end), 1000 // part.steps
    for index in range(part.steps):
        time = round(1000 - index * 1000 / part.steps) - 1
        clock = denoiser.clock(torch.tensor([time]), torch.tensor([tokens * part.per_token]))
        text, null = (
            denoiser.step(latent, clock, known.context, known.bias[:, None, None, :])
            for known in (conditions["text"], conditions["null"])
        )
        clean = null + part.guidance * (text - null)
        now, after = alphas[time], torch.ones(()) if index == part.steps - 1 else alphas[time - stride]
        noise = (latent - now.sqrt() * clean) / (1 - now).sqrt()
        latent = (after.sqrt() * clean + (1 - after).sqrt() * noise).float()
    features = latent.reshape(-1, len(mean)).numpy()[:frames] / part.scale * std + mean
    layout = layout_of(len(mean))
    return fused_joints(features) if layout.name == LAYOUT else layout.to_joints(features)


def pipeline_difference(folder: Path, trained: TrainedFrames) -> float:
    """Measure the mean joint distance between torch and the runtime over `PROMPTS`, mm, with the same noise."""
    pipe = MotionPipeline.load(folder)
    frames = pipe.in_space(FRAMES)
    distances = []
    for seed, prompt in enumerate(PROMPTS):
        features = pipe.encoder.encode_text([pipe.parse(prompt)], [seed % 4 == 3])
        options = resolve_options(pipe.manifest, seed=seed, foot_fix=False, space=FRAMES)
        options = pipe.encoder.with_length(options, features)
        latents = frames.sampler.sample(pipe.encoder.attend(features), None, [options])
        clip = frames.decoder.decode(latents, [options], [prompt])[0]
        expected = torch_frames(trained, pipe, prompt, seed, options.frames)
        distances.append(np.linalg.norm(clip.joints - expected, axis=-1).mean() * 1000.0)
    return float(np.mean(distances))


def add_frames(
    folder: Path, run: Path, steps: int = STEPS, guidance: float = GUIDANCE, precision: Precision = "fp32"
) -> dict[str, float]:
    """Write skeleton space into a bundle's folder, and its manifest anew; returns the parity of its graphs and clips.

    Args:
        folder: of the bundle, changed in place; what it had of skeleton space is replaced.
        run: folder with frames/last.ckpt, and the specific autoencoder whose normalisation it was trained under.
        steps: diffusion steps of a call that leaves them out.
        guidance: guidance scale of a call that leaves it out.
        precision: of the new graphs. In int8 clips of `studio` were 114 mm from torch, as each of 20 steps rounds anew.

    Raises:
        BundleError: the bundle cannot be read, or `steps` and `guidance` are out of range.
        InvalidInputError: there is no network, or it is of another bundle.
        ParityError: a graph or whole clips differ from torch.
    """
    manifest, trained = read_bundle(folder).manifest, read_frames(run / FRAMES / "last.ckpt")
    check_fits(trained, manifest)
    check_normalisation(run / f"vae_{LEVELS[-1]}" / "last.ckpt", manifest)
    part = trained.part(steps, guidance)
    declared = frame_contracts(part.level, manifest.text.width)
    files: dict[str, bytes] = {}
    parity: dict[str, float] = {}
    for name, module in trained.modules().items():
        files[declared[name].file], differences = export_graph(module, declared[name], part.per_token, precision)
        parity |= differences
    file, source = declared[FRAMES_DENOISER_AGD].file, declared[FRAMES_DENOISER].file
    files[file] = without_shared(files[file], files[source])
    with unchanged_if_it_fails(folder, FRAME_FILES):
        write_files(folder, with_graphs(manifest, files, parity, frames_part=part), files)
        parity["frames_mm"] = pipeline_difference(folder, trained)
        if not parity["frames_mm"] <= MAX_PIPELINE_MM[precision]:
            raise ParityError(f"clips of skeleton space are {parity['frames_mm']:.3f} mm from torch")
        write_files(folder, with_graphs(manifest, files, parity, frames_part=part))
    return parity


def main(argv: list[str] | None = None) -> None:
    """Run the command line."""
    parser = argparse.ArgumentParser(prog="kinegraph_export.add_frames", description=__doc__.split("\n")[0])
    parser.add_argument("--bundle", type=Path, required=True, help="folder of the bundle, changed in place")
    parser.add_argument("--run", type=Path, required=True, help="folder with frames/last.ckpt")
    parser.add_argument("--steps", type=int, default=STEPS, help=f"default diffusion steps ({STEPS})")
    parser.add_argument("--guidance", type=float, default=GUIDANCE, help=f"default guidance scale ({GUIDANCE})")
    parser.add_argument("--precision", choices=get_args(Precision), default="fp32", help="of the new graphs (fp32)")
    options = parser.parse_args(argv)
    parity = add_frames(options.bundle, options.run, options.steps, options.guidance, options.precision)
    for name, difference in parity.items():
        print(f"{name:24s} {difference:.2e}")


if __name__ == "__main__":
    main()
