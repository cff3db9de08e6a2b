"""The optional part of a bundle that works in skeleton space: on the motion features of frames, without a decoder.

EnergyMoGen, section 3.1 and appendix A and B. The step graph is that of a latent denoiser (`contract.denoiser`), with
groups of consecutive frames in place of latent tokens. Its number of tokens C is free, for it is the clip's, and it
predicts the clean frames in place of the noise:

    frames_context      nodes, kind, order, bias -> keys and values of every layer                            once
    frames_modulation   timestep, frames -> modulation                                                        once
    frames_denoiser     latent (R, C, z), modulation, keys and values, src, combine, bias -> clean (R, C, z)  each step
    frames_*_agd        context and denoiser with adaptive gradient descent

A latent is `scale * (features - mean) / std` of the frames of a group, one after another: z = per_token F.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Literal

from kinegraph.bundle.contract import (
    FRAME_GRAPHS,
    FRAMES,
    LEVELS,
    GraphContract,
    LevelSpec,
    TensorSpec,
    context,
    context_agd,
    denoiser,
    denoiser_agd,
    modulation,
)
from kinegraph.diffusion.sampling import NoiseSchedule


@dataclass(frozen=True)
class FramesPart:
    """What the manifest says of skeleton space."""

    level: LevelSpec
    """Dimensions of the denoiser; `tokens` is the most that it has positions for."""
    per_token: int
    """Frames of a group."""
    scale: float
    """Factor of the normalised features."""
    steps: int
    """Diffusion steps of a call that leaves them out."""
    guidance: float
    """Guidance scale of a call that leaves it out."""
    prediction: Literal["clean"]
    """What the denoiser predicts."""
    beta_end: float = 0.012
    """Last beta of the noise schedule, whose other values are those of the latent levels.

    What all frames of a clip share, such as its speed, shows through noise that drowns each of them. A run starts at
    noise alone, so in training the last timestep must hide it, too (Lin et al., "Common Diffusion Noise Schedules and
    Sample Steps are Flawed", 2024).
    """

    def schedule(self, latent: NoiseSchedule) -> NoiseSchedule:
        """Make the schedule of skeleton space of that of the latent levels.

        A run starts at the last timestep, and ends at the predicted clean frames: the noise of alpha_bar[0], harmless
        in a latent, is a centimetre where joints are read off directly.
        """
        return replace(latent, beta_end=self.beta_end, spacing="trailing", ends_clean=True)

    def token_count(self, frames: int) -> int:
        """Return the groups of frames of a clip, rounded up."""
        return -(-frames // self.per_token)


def frame_contracts(level: LevelSpec, text_width: int) -> dict[str, GraphContract]:
    """Declare the graphs of skeleton space, by name.

    Args:
        level: dimensions of the denoiser.
        text_width: D, width of the graph encoder's nodes.
    """
    declared = (  # of any level; they are renamed below
        context(FRAMES, level, text_width, None),
        modulation(FRAMES, level),
        _on_frames(denoiser(FRAMES, level), level),
        context_agd(LEVELS[-1], level, text_width, None),
        _on_frames(denoiser_agd(LEVELS[-1], level), level),
    )
    return {name: replace(graph, name=name) for name, graph in zip(FRAME_GRAPHS, declared, strict=True)}


def _on_frames(graph: GraphContract, level: LevelSpec) -> GraphContract:
    """Free the number of latent tokens of a denoiser, and let it predict clean frames."""
    latent = TensorSpec("latent", ("R", "C", level.latent_width))
    bias = TensorSpec("bias", ("A", 1, "C", "S"))
    changed = {latent.name: latent, bias.name: bias}
    inputs = tuple(changed.get(spec.name, spec) for spec in graph.inputs)
    return replace(graph, inputs=inputs, outputs=(replace(latent, name="clean"),))


def find_faults(part: FramesPart, features: int, most_frames: int, sizes: Mapping[str, int]) -> list[tuple[str, str]]:
    """List what is wrong with the sizes of a part: key and message of each.

    Args:
        part: of a manifest.
        features: F.
        most_frames: of a clip.
        sizes: name of a field of the level -> largest value.
    """
    level = part.level
    checks = [
        (1 <= getattr(level, name) <= most, f"level.{name}", f"must be 1 to {most}, found {getattr(level, name)}")
        for name, most in sizes.items()
    ]
    checks += [
        (1 <= part.per_token <= most_frames, "per_token", f"must be 1 to {most_frames}, found {part.per_token}"),
        (
            level.latent_width == part.per_token * features,
            "level.latent_width",
            f"must be {part.per_token} x {features}, found {level.latent_width}",
        ),
        (
            part.per_token > 0 and level.tokens >= part.token_count(most_frames),
            "level.tokens",
            f"must be enough for {most_frames} frames, found {level.tokens}",
        ),
        (level.heads > 0 and level.width % level.heads == 0, "level.heads", f"must divide {level.width}"),
        (bool(level.nodes), "level.nodes", "must not be empty"),
        (0 < part.beta_end < 1, "beta_end", f"must be above 0 and below 1, found {part.beta_end}"),
        (0 < part.scale <= 100, "scale", f"must be above 0 and at most 100, found {part.scale}"),
        (0 <= part.guidance <= 20, "guidance", f"must be 0 to 20, found {part.guidance}"),
    ]
    return [(key, message) for holds, key, message in checks if not holds]
