"""Validation of a manifest: ranges, and agreement between its fields, which types alone cannot express."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import TYPE_CHECKING, Final

from kinegraph.bundle.contract import (
    COARSE_DECODERS,
    CONTEXT_MIXING_VERSION,
    FORMAT_VERSION,
    FRAME_FILES,
    NODE_KINDS,
    OLDEST_VERSION,
    OPTIONAL_TABLES,
    REQUIRED_TABLES,
    LevelSpec,
    agd_files,
    gradient_files,
    graph_file,
    graph_files,
    levels_of,
    optional_graph_files,
)
from kinegraph.bundle.frames_part import find_faults
from kinegraph.bundle.released_contract import SLOTS
from kinegraph.errors import BundleFormatError, InvalidInputError
from kinegraph.graph import ROLES
from kinegraph.limits import MAX_FRAMES, MAX_PIECES
from kinegraph.motion.skeleton import JOINT_NAMES, PARENTS
from kinegraph.validation import short_repr

if TYPE_CHECKING:
    from kinegraph.bundle.manifest import FeatureSpec, Manifest

MAX_DIMS: Final[Mapping[str, int]] = {
    "tokens": 256,
    "latent_width": 4096,
    "width": 8192,
    "heads": 256,
    "layers": 256,
}
"""Upper limits on `LevelSpec`, far above any model: they bound the size of contracts before a file is trusted."""

LAYOUT_WIDTHS: Final[Mapping[str, int]] = {"joints-137": 137, "humanml3d-263": 263, "kit-251": 251}
"""Feature layout -> F, width of its features."""


def check_manifest(manifest: Manifest) -> None:
    """Check all fields of a manifest.

    Raises:
        BundleFormatError: a value is out of range, or fields contradict each other; the message names the key.
    """
    check_version(manifest.format_version)
    _check_body(manifest)
    _check_features(manifest.features)
    _check_levels(manifest.levels, manifest.format_version, levels_of(manifest.family))
    if manifest.family != "kinegraph":
        for name, level in manifest.levels.items():
            _require(set(level.nodes) <= set(SLOTS), f"levels.{name}.nodes", f"must be some of {list(SLOTS)}")
    _check_schedule(manifest)
    _check_frames_part(manifest)
    _check_files(manifest)


def _require(holds: bool, key: str, message: str) -> None:
    if not holds:
        raise BundleFormatError(f"manifest.json: {key} {message}")


def check_version(version: int) -> None:
    """Refuse a format that this release does not read."""
    _require(
        OLDEST_VERSION <= version <= FORMAT_VERSION,
        "format_version",
        f"is {version}, this kinegraph reads {OLDEST_VERSION} to {FORMAT_VERSION}; "
        "install the release the bundle was built for",
    )


def _check_body(manifest: Manifest) -> None:
    skeleton, frames = manifest.skeleton, manifest.frames
    _require(
        skeleton.joint_names == JOINT_NAMES,
        "skeleton.joint_names",
        "must be the 22 joints of kinegraph.motion.skeleton",
    )
    _require(skeleton.parents == PARENTS, "skeleton.parents", "must be those of kinegraph.motion.skeleton")
    _require(manifest.roles == ROLES, "roles", f"must be {list(ROLES)} in this order, found {list(manifest.roles)}")
    _require(
        1 <= manifest.text.width <= MAX_DIMS["width"],
        "text.width",
        f"must be 1 to {MAX_DIMS['width']}, found {manifest.text.width}",
    )
    _require(
        2 <= manifest.text.max_pieces <= MAX_PIECES,
        "text.max_pieces",
        f"must be 2 to {MAX_PIECES}, found {manifest.text.max_pieces}",
    )
    _require(0 < manifest.fps <= 1000, "fps", f"must be above 0 and at most 1000, found {manifest.fps}")
    _require(
        2 <= frames.min <= frames.max <= MAX_FRAMES,
        "frames",
        f"must satisfy 2 <= min <= max <= {MAX_FRAMES}, found min {frames.min}, max {frames.max}",
    )
    _require(
        1 <= frames.per_token <= frames.max,
        "frames.per_token",
        f"must be 1 to {frames.max}, found {frames.per_token}",
    )


def _check_features(features: FeatureSpec) -> None:
    width = LAYOUT_WIDTHS[features.layout]
    for key in ("mean", "std"):
        count = len(getattr(features, key))
        _require(
            count == width,
            f"features.{key}",
            f"must have {width} numbers for {features.layout}, found {count}",
        )
    _require(min(features.std) > 0, "features.std", f"must be positive, found {min(features.std)}")


def _check_levels(levels: Mapping[str, LevelSpec], version: int, names: tuple[str, ...]) -> None:
    _check_keys(levels, "levels", names)
    known = NODE_KINDS if version >= CONTEXT_MIXING_VERSION else NODE_KINDS[:-1]
    coarse: LevelSpec | None = None
    for name in names:
        level = levels[name]
        key = f"levels.{name}"
        for field, most in MAX_DIMS.items():
            size = getattr(level, field)
            _require(1 <= size <= most, f"{key}.{field}", f"must be 1 to {most}, found {size}")
        _require(
            level.width % level.heads == 0,
            f"{key}.heads",
            f"must divide the width {level.width}, found {level.heads}",
        )
        kinds = tuple(kind for kind in known if kind in level.nodes)
        _require(
            bool(kinds) and level.nodes == kinds,
            f"{key}.nodes",
            f"must be some of {list(known)} in this order, found {list(level.nodes)}",
        )
        if coarse is not None:
            # The coarser latent becomes context tokens of this level, of the same width.
            _require(
                level.latent_width == coarse.latent_width,
                f"{key}.latent_width",
                f"must be that of the coarser level, {coarse.latent_width}, found {level.latent_width}",
            )
            _require(
                level.tokens >= coarse.tokens,
                f"{key}.tokens",
                f"must not be fewer than the coarser level's {coarse.tokens}, found {level.tokens}",
            )
        coarse = level


def _check_keys(mapping: Mapping[str, object], key: str, names: tuple[str, ...]) -> None:
    _require(set(mapping) == set(names), key, f"must have exactly the keys {list(names)}, found {list(mapping)}")


def _check_schedule(manifest: Manifest) -> None:
    schedule, defaults, frames, fps = manifest.schedule, manifest.defaults, manifest.frames, manifest.fps
    names, is_ours = levels_of(manifest.family), manifest.family == "kinegraph"
    _require(
        is_ours == (defaults.guidance_base != "structure"),
        "defaults.guidance_base",
        f"cannot be {defaults.guidance_base!r} for networks of the family {manifest.family!r}",
    )
    _require(
        1 <= schedule.train_steps <= 100_000,
        "schedule.train_steps",
        f"must be 1 to 100000, found {schedule.train_steps}",
    )
    _require(
        0 < schedule.beta_start <= schedule.beta_end < 1,
        "schedule",
        f"must satisfy 0 < beta_start <= beta_end < 1, found {schedule.beta_start}, {schedule.beta_end}",
    )
    _require(
        0 <= schedule.steps_offset < schedule.train_steps,
        "schedule.steps_offset",
        f"must be 0 to {schedule.train_steps - 1}, found {schedule.steps_offset}",
    )
    _check_keys(defaults.steps, "defaults.steps", names)
    _check_keys(defaults.guidance, "defaults.guidance", names)
    for name in names:
        steps, scale = defaults.steps[name], defaults.guidance[name]
        try:
            schedule.noise.timesteps(steps)
        except InvalidInputError as error:
            raise BundleFormatError(f"manifest.json: defaults.steps.{name}: {error}") from error
        _require(0 <= scale <= 20, f"defaults.guidance.{name}", f"must be 0 to 20, found {scale}")
    _require(
        frames.min <= round(defaults.seconds * fps) <= frames.max,
        "defaults.seconds",
        f"must be {frames.min / fps:g} to {frames.max / fps:g}, found {defaults.seconds}",
    )


def _check_frames_part(manifest: Manifest) -> None:
    part, present = manifest.frames_part, FRAME_FILES & set(manifest.files)
    if part is None:
        _require(not present, "files", f"has {sorted(present)}, which the key frames_part would describe")
        return
    _require(present == FRAME_FILES, "files", f"lacks {sorted(FRAME_FILES - present)}, which frames_part describes")
    for key, message in find_faults(part, len(manifest.features.mean), manifest.frames.max, MAX_DIMS):
        raise BundleFormatError(f"manifest.json: frames_part.{key} {message}")
    try:
        part.schedule(manifest.schedule.noise).timesteps(part.steps)
    except InvalidInputError as error:
        raise BundleFormatError(f"manifest.json: frames_part.steps: {error}") from error


def _check_files(manifest: Manifest) -> None:
    files, operators, version = manifest.files, manifest.operators, manifest.format_version
    required = REQUIRED_TABLES.union(graph_files(version, manifest.family))
    known = required | optional_graph_files(version, manifest.family) | OPTIONAL_TABLES
    for name, entry in files.items():
        # Only known names are ever opened, so separators, drives, "..", NUL and devices can name nothing.
        _require(
            name in known,
            "files",
            f"names {short_repr(name)}, no file of a bundle of format {version}; allowed are {sorted(known)}",
        )
        _require(
            re.fullmatch("[0-9a-f]{64}", entry.sha256) is not None,
            f"files.{name}.sha256",
            f"must be 64 hex digits, found {short_repr(entry.sha256)}",
        )
        _require(entry.bytes >= 0, f"files.{name}.bytes", f"must not be negative, found {entry.bytes}")
    missing = sorted(required - set(files))
    _require(not missing, "files", f"lacks {missing}")
    all_agd = agd_files(version)
    agd = all_agd & set(files)
    _require(not agd or agd == all_agd, "files", f"has {sorted(agd)}, of {sorted(all_agd)} all or none")
    all_gradients = gradient_files(version)
    gradients = all_gradients & set(files)
    _require(
        not gradients or gradients == all_gradients,
        "files",
        f"has {sorted(gradients)}, of {sorted(all_gradients)} all or none",
    )
    decoders = {graph_file(graph, version) for graph in COARSE_DECODERS.values()}
    _require(
        not gradients or decoders <= set(files),
        "files",
        f"lacks {sorted(decoders - set(files))}, whose weights {sorted(gradients)} take",
    )
    graphs = sorted(name for name in files if name.endswith(".onnx"))
    _require(
        sorted(operators) == graphs, "operators", f"must have exactly the keys {graphs}, found {sorted(operators)}"
    )
    for name, listed in operators.items():
        _require(list(listed) == sorted(set(listed)), f"operators.{name}", "must be sorted and without repeats")
