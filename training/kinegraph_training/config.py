"""Presets: what is trained and how, read strictly from TOML (presets/*.toml or a file of your own)."""

from __future__ import annotations

import tomllib
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, TypeVar

from kinegraph.errors import InvalidInputError
from kinegraph_training.models.denoiser import DenoiserConfig
from kinegraph_training.models.vae import VaeConfig

LEVELS = ("motion", "action", "specific")
T = TypeVar("T")


@dataclass(frozen=True)
class DataConfig:
    """What is trained on."""

    min_frames: int = 16
    max_frames: int = 196
    splices: int = 700
    """Made clips of two actions at once; 0 for data without content labels."""
    sequences: int = 700
    """Made clips of one action after another."""
    excerpts: int = 0
    """Walks and runs of other lengths than the recorded ones."""
    paces: int = 0
    """Walks, runs and turns slower and faster than recorded, whose captions say so."""
    rare_weight: float = 3.0
    """How much more often the denoisers see clips of contents with fewer than 50 clips."""
    seed: int = 7
    """Of the made clips; apart from that of training, so that runs of several seeds share their data."""


@dataclass(frozen=True)
class OptimiserConfig:
    """One stage's schedule."""

    steps: int
    learning_rate: float
    warmup: int
    batch: int
    """Clips per step for denoisers, frames per step for autoencoders."""
    ema: float
    beta2: float = 0.98
    weight_decay: float = 0.01
    clip: float = 1.0


@dataclass(frozen=True)
class Preset:
    """Everything one model needs to be trained and exported."""

    name: str
    seed: int
    data: DataConfig
    vae: dict[str, VaeConfig]
    vae_training: dict[str, OptimiserConfig]
    denoiser: DenoiserConfig
    denoiser_training: OptimiserConfig


def decoded(kind: type[T], table: dict[str, Any], where: str) -> T:
    """A flat dataclass from a TOML table; unknown and missing keys are errors."""
    known = {field.name for field in fields(kind)}  # type: ignore[arg-type]
    unknown = sorted(set(table) - known)
    if unknown:
        raise InvalidInputError(f"[{where}] has unknown keys {', '.join(unknown)}; known: {', '.join(sorted(known))}")
    try:
        return kind(**table)
    except TypeError as error:
        raise InvalidInputError(f"[{where}]: {error}") from error


def read_preset(name_or_path: str) -> Preset:
    """A preset of this package by name, or a TOML file; its `base`, if it has one, is a preset that it changes.

    Raises:
        InvalidInputError: no such preset, or a table that breaks the format.
    """
    table, name = preset_table(name_or_path)
    vae, training = table["vae"], table["vae_training"]
    return Preset(
        name=name,
        seed=table.get("seed", 0),
        data=decoded(DataConfig, table.get("data", {}), "data"),
        vae={level: decoded(VaeConfig, vae["shared"] | vae[level], f"vae.{level}") for level in LEVELS},
        vae_training={
            level: decoded(OptimiserConfig, training["shared"] | training.get(level, {}), f"vae_training.{level}")
            for level in LEVELS
        },
        denoiser=decoded(DenoiserConfig, table["denoiser"], "denoiser"),
        denoiser_training=decoded(OptimiserConfig, table["denoiser_training"], "denoiser_training"),
    )


def preset_table(name_or_path: str, depth: int = 0) -> tuple[dict[str, Any], str]:
    """The tables of a preset on top of those of its base, and its name."""
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
        # A path is meant from the file that names it.
        wanted = str(path.parent / base) if base.endswith(".toml") else base
        table = merged(preset_table(wanted, depth + 1)[0], table)
    return table, path.stem


def merged(base: dict[str, Any], changes: dict[str, Any]) -> dict[str, Any]:
    """Tables within tables, the changes on top."""
    both = {**base, **changes}
    for name in base.keys() & changes.keys():
        if isinstance(base[name], dict) and isinstance(changes[name], dict):
            both[name] = merged(base[name], changes[name])
    return both
