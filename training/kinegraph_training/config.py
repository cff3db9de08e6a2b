"""Presets: the shapes and schedules of a model, read strictly from TOML (presets/*.toml, or a file of a user's)."""

from __future__ import annotations

import tomllib
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Any, TypeVar

from kinegraph.bundle.contract import LEVELS
from kinegraph.errors import InvalidInputError
from kinegraph_training.models.denoiser import DenoiserConfig
from kinegraph_training.models.vae import VaeConfig

T = TypeVar("T")


@dataclass(frozen=True)
class DataConfig:
    """Training data of a model: limits of captured clips, and numbers of synthetic ones."""

    min_frames: int = 16
    max_frames: int = 196
    splices: int = 700
    """Synthetic clips of two actions at once; 0 for data without action labels."""
    triples: int = 0
    """Synthetic clips of three actions at once: legs, left arm and right arm."""
    sequences: int = 700
    """Synthetic clips of one action after another."""
    excerpts: int = 0
    """Synthetic clips of steady actions of other lengths than the captured ones."""
    gesture_excerpts: int = 0
    """Parts of 2 to 5 s of repeated gestures."""
    padded: int = 0
    """Short actions with standing before or after them."""
    bent: int = 0
    """Walks led around a circle, through a U-turn, or to a stop."""
    gestures: int = 0
    """Gestures made by inverse kinematics on people who stand."""
    paces: int = 0
    """Synthetic walks, runs and turns at other speeds than captured, with captions that say so."""
    wordings: int = 0
    """Captions of the action table added to each captured clip of one action."""
    draws: dict[str, float] = field(default_factory=dict)
    """Share of the draws by what made a clip (`MotionClip.made_by`); the rest are recorded clips. Empty: as many as
    there are of each."""
    label_cap: float = 0.05
    """Largest share of the draws of one action."""
    label_power: float = 0.35
    """Draws of an action go by this power of its number of clips, and within it those of a style: below 1 rare ones
    come more often."""
    weighted_vae: bool = False
    """Whether the autoencoders draw clips as often as the denoisers do; else each once an epoch, and a fall, of which
    there are nine clips, once in a thousand."""
    often: list[str] = field(default_factory=list)
    """Beginnings of labels that are drawn `often_weight` times as often: what people ask for and data seldom hold."""
    often_weight: float = 3.0
    composed: float = 0.0
    """Share of the draws with partial captions of a splice that are composed of one for each action, half of them each
    by Eq. 7 and Eq. 9 of EnergyMoGen (`composed_rows`)."""
    verb_masking: bool = True
    """Whether verbs are masked in some captions, which needs all of them to be encoded twice."""
    hide_from: float = 0.0
    """Share of the steps of the denoisers after which nodes are hidden and verbs masked."""
    seed: int = 7
    """Of the synthetic clips; apart from the seed of training, so that runs of several seeds share their data."""


@dataclass(frozen=True)
class OptimiserConfig:
    """Optimiser and schedule of one training stage."""

    steps: int
    learning_rate: float
    """Peak."""
    warmup: int
    """Steps."""
    batch: int
    """Clips per step for denoisers, frames per step for autoencoders."""
    ema: float
    """Decay of the weight average."""
    beta2: float = 0.98
    weight_decay: float = 0.01
    clip: float = 1.0
    """Largest norm of the gradient."""
    spectral_from: float = 0.0
    """Share of the steps of the denoisers after which the spectral loss is added."""


@dataclass(frozen=True)
class FrameConfig:
    """Shape of the skeleton-space denoiser, where it differs from the latent denoisers."""

    frames_per_token: int = 4
    scale: float = 0.5
    """Factor of the normalised features. Neighbouring features and frames tell the same, so noise that would drown each
    of them leaves the whole to be seen; smaller values are drowned earlier (Chen, "On the Importance of Noise
    Scheduling for Diffusion Models", 2023)."""
    beta_end: float = 0.0225
    """Last beta of the noise schedule: at the last timestep alpha_bar is 1e-4, and in latent space 5e-3. With that of
    latent space, a running clip's speed was seen through the noise of the last timestep, where a run starts without it:
    clips ran at 1.2 m/s, and at 3 in latent space (see `kinegraph.bundle.frames_part`)."""
    kind: str = "frames"
    """As `DenoiserConfig.kind`: "concat", with one frame a token, is MDM's network (for comparison)."""
    from_latent: bool = True
    """Whether the network keeps the graph encoder of the run's latent denoisers and starts from the weights of the
    finest one; else all of it is trained from random weights (for comparison)."""
    width: int | None = None
    """This and all that follow: None is that of the latent denoisers."""
    layers: int | None = None
    heads: int | None = None
    feed_forward: int | None = None

    def denoiser(self, base: DenoiserConfig) -> DenoiserConfig:
        """Make the configuration of the network; it sees all nodes, as the finest level does."""
        sizes = {name: getattr(self, name) for name in ("width", "layers", "heads", "feed_forward")}
        given = {name: size for name, size in sizes.items() if size is not None}
        own = {"frames_per_token": self.frames_per_token, **given}
        return replace(base, kind=self.kind, nodes_seen="all", levels=LEVELS[-1:], **own)


@dataclass(frozen=True)
class Preset:
    """Everything that one model needs to be trained and exported."""

    name: str
    seed: int
    data: DataConfig
    vae: dict[str, VaeConfig]
    vae_training: dict[str, OptimiserConfig]
    denoiser: DenoiserConfig
    denoiser_training: OptimiserConfig
    frames: FrameConfig
    frames_training: OptimiserConfig


def parse_table(kind: type[T], table: dict[str, Any], where: str) -> T:
    """Make a flat dataclass from a TOML table; unknown and missing keys are errors."""
    known = {field.name for field in fields(kind)}  # type: ignore[arg-type]
    unknown = sorted(set(table) - known)
    if unknown:
        raise InvalidInputError(f"[{where}] has unknown keys {', '.join(unknown)}; known: {', '.join(sorted(known))}")
    try:
        return kind(**table)
    except TypeError as error:
        raise InvalidInputError(f"[{where}]: {error}") from error


def read_preset(name_or_path: str) -> Preset:
    """Read a preset of this package by name, or a TOML file, which may change a `base` preset.

    Raises:
        InvalidInputError: no such preset, or a table that breaks the format.
    """
    table, name = read_preset_table(name_or_path)
    vae, training = table["vae"], table["vae_training"]
    return Preset(
        name=name,
        seed=table.get("seed", 0),
        data=parse_table(DataConfig, table.get("data", {}), "data"),
        vae={level: parse_table(VaeConfig, vae["shared"] | vae[level], f"vae.{level}") for level in LEVELS},
        vae_training={
            level: parse_table(OptimiserConfig, training["shared"] | training.get(level, {}), f"vae_training.{level}")
            for level in LEVELS
        },
        denoiser=parse_table(DenoiserConfig, table["denoiser"], "denoiser"),
        denoiser_training=parse_table(OptimiserConfig, table["denoiser_training"], "denoiser_training"),
        frames=parse_table(FrameConfig, table.get("frames", {}), "frames"),
        frames_training=parse_table(
            OptimiserConfig, table["denoiser_training"] | table.get("frames_training", {}), "frames_training"
        ),
    )


def read_preset_table(name_or_path: str, depth: int = 0) -> tuple[dict[str, Any], str]:
    """Read the tables of a preset on top of those of its base; returns them and the preset's name."""
    folder = Path(__file__).parent / "presets"
    path = Path(name_or_path) if name_or_path.endswith(".toml") else folder / f"{name_or_path}.toml"
    if not path.is_file():
        names = ", ".join(sorted(file.stem for file in folder.glob("*.toml")))
        raise InvalidInputError(f"no preset {name_or_path!r}; presets: {names}, or the path of a .toml file")
    try:
        table = tomllib.loads(path.read_text(encoding="utf-8"))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise InvalidInputError(f"{path} is not TOML: {error}") from error
    base = table.pop("base", None)
    if base is not None:
        if depth > 4:
            raise InvalidInputError(f"{path}: its base leads back to it")
        # A path is relative to the file that names it.
        base_name = str(path.parent / base) if base.endswith(".toml") else base
        table = merge_tables(read_preset_table(base_name, depth + 1)[0], table)
    return table, path.stem


def merge_tables(base: dict[str, Any], changes: dict[str, Any]) -> dict[str, Any]:
    """Merge nested tables; changes replace what the base holds."""
    both = {**base, **changes}
    for name in base.keys() & changes.keys():
        if isinstance(base[name], dict) and isinstance(changes[name], dict):
            both[name] = merge_tables(base[name], changes[name])
    return both
