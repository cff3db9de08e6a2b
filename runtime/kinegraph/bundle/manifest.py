"""`manifest.json`: the read-only facts of a bundle, their reading and writing, and their validation.

The records mirror the JSON object key by key. What one call asks for lives in `kinegraph.options`.
"""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final, Literal

from kinegraph.bundle.contract import (
    AGD_CONTEXTS,
    AGD_DENOISERS,
    COARSE_DECODERS,
    CONTEXT_MIXING_VERSION,
    DECODER_GRADIENTS,
    FORMAT_VERSION,
    NODE_KINDS,
    OLDEST_VERSION,
    SLOTS,
    Family,
    GraphContract,
    LevelSpec,
    contracts,
    graph_file,
    graphs_of,
    levels_of,
    optional_graphs_of,
    released_contracts,
)
from kinegraph.bundle.strict_json import decode, parse_object, to_plain
from kinegraph.diffusion.sampling import NoiseSchedule
from kinegraph.errors import BundleFormatError, BundleIntegrityError, InvalidInputError
from kinegraph.graph import ROLES
from kinegraph.limits import MAX_FRAMES, MAX_PIECES
from kinegraph.motion.skeleton import JOINT_NAMES, PARENTS
from kinegraph.validation import short_repr

REQUIRED_TABLES: Final[frozenset[str]] = frozenset(("tokenizer.json", "tables.npz"))
"""Files that every bundle has besides its graphs."""
OPTIONAL_TABLES: Final[frozenset[str]] = frozenset(("parser.bin", "arguments.npz", "vocabulary.npz"))
"""Files besides the graphs that a bundle works without, with limits.

- Without parser.bin it takes graphs, but no plain sentences.
- Without arguments.npz its parser labels arguments by rules.
- Without vocabulary.npz it cannot tell words that it was never shown.
"""


def graph_files(version: int = FORMAT_VERSION, family: Family = "kinegraph") -> tuple[str, ...]:
    """List the files of the graphs that a bundle of a format version must have, in order of execution."""
    return tuple(graph_file(graph, version) for graph in graphs_of(family))


def optional_graph_files(version: int = FORMAT_VERSION, family: Family = "kinegraph") -> frozenset[str]:
    """List the files of the graphs that a bundle of a format version works without, with limits.

    - Without the coarse decoders it shows no clip before the last level is done.
    - Without the graphs of adaptive gradient descent it refuses to compose with `agd`.
    - Without the gradients of the decoders it refuses constraints; without the encoder, edits of clips.
    """
    return frozenset(graph_file(graph, version) for graph in optional_graphs_of(family))


def agd_files(version: int = FORMAT_VERSION) -> frozenset[str]:
    """List the files of the graphs of adaptive gradient descent, of which a bundle has all or none."""
    return frozenset(graph_file(graph, version) for graph in (*AGD_CONTEXTS.values(), *AGD_DENOISERS.values()))


def gradient_files(version: int = FORMAT_VERSION) -> frozenset[str]:
    """List the files of the decoders' gradients, of which a bundle has all or none."""
    return frozenset(graph_file(graph, version) for graph in DECODER_GRADIENTS.values())


# Records


@dataclass(frozen=True)
class Licence:
    """Licence of each part, as `kinegraph info` prints it."""

    code: str
    weights: str
    data: str
    text_encoder: str
    parser: str


@dataclass(frozen=True)
class SkeletonSpec:
    """Joints of the body; they must equal those of `kinegraph.motion.skeleton`."""

    joint_names: tuple[str, ...]
    parents: tuple[int, ...]
    """Index of each joint's parent."""


@dataclass(frozen=True)
class FrameSpec:
    """Limits on the frames of one clip."""

    min: int
    max: int
    per_token: int
    """Frames per token of the decoder's sequence; the frame mask is padded to a multiple of it."""


@dataclass(frozen=True)
class FeatureSpec:
    """Motion features that the decoders return, and their normalisation: `decoded * std + mean`."""

    layout: Literal["joints-137", "humanml3d-263", "kit-251"]
    heading: Literal["true", "humanml3d"]
    mean: tuple[float, ...]
    """(F,)."""
    std: tuple[float, ...]
    """(F,), all positive."""


@dataclass(frozen=True)
class TextSpec:
    """Dimensions and tokens of the text encoder."""

    width: int
    """D, width of the text encoder's hidden states."""
    mask_token: str
    """Token that replaces a masked word in the caption."""
    max_pieces: int = MAX_PIECES
    """Word pieces of a caption that the encoder has positions for, special ones included."""


@dataclass(frozen=True)
class ScheduleSpec:
    """Noise schedule: betas are `linspace(sqrt(beta_start), sqrt(beta_end), train_steps) ** 2`."""

    train_steps: int
    beta_start: float
    beta_end: float
    steps_offset: int
    spacing: Literal["leading", "trailing"]
    prediction: Literal["epsilon"]

    @property
    def noise(self) -> NoiseSchedule:
        """Schedule to sample with."""
        return NoiseSchedule(self.train_steps, self.beta_start, self.beta_end, self.steps_offset, self.spacing)


@dataclass(frozen=True)
class Defaults:
    """Options of a call that leaves them out."""

    steps: Mapping[str, int]
    """Diffusion steps per level."""
    guidance: Mapping[str, float]
    """Guidance scale per level."""
    guidance_base: Literal["empty", "coarse", "structure"]
    """Unconditional branch of classifier-free guidance: "empty" drops text and coarse latent (Eq. A); "coarse" drops
    the text only; "structure", of released networks alone, keeps the graph as well and gives its nodes the features of
    an empty caption."""
    seconds: float
    """Length of a clip where neither the caller nor the duration model gives one."""


@dataclass(frozen=True)
class FileSpec:
    """Hash and size of one file."""

    sha256: str
    bytes: int


@dataclass(frozen=True)
class Manifest:
    """Content of `manifest.json`; read by `decode_manifest`, written by `encode_manifest`.

    Raises:
        BundleFormatError: a value is out of range, or fields contradict each other; the message names the key.
    """

    format_version: int
    name: str
    version: str
    licence: Licence
    provenance: Mapping[str, str]
    """Training data, sources and hashes of text encoder and parser, versions of the build tools."""
    scope: Mapping[str, str]
    """Abilities and limits of the model in words: actions, styles, and so on."""
    skeleton: SkeletonSpec
    fps: float
    frames: FrameSpec
    features: FeatureSpec
    text: TextSpec
    levels: Mapping[str, LevelSpec]
    schedule: ScheduleSpec
    defaults: Defaults
    roles: tuple[str, ...]
    """Roles of edges by number, as the graph encoder was trained with: those of `kinegraph.graph.ROLES`."""
    precision: Literal["fp32", "int8"]
    files: Mapping[str, FileSpec]
    """File name -> hash and size, of every file but the manifest."""
    operators: Mapping[str, tuple[str, ...]]
    """Graph file -> sorted `domain::OpType`; `kinegraph verify` compares them with the graphs."""
    parity: Mapping[str, float]
    """Largest difference from the trained model: per graph (int8: relative) and of whole clips (mean of joints, mm)."""
    training: Mapping[str, str | float | int]
    """Settings of the training run."""
    quality: Mapping[str, float]
    """Measured quality, by metric."""
    family: Family = "kinegraph"
    """Whose networks they are; says which graphs the bundle has, and what they take."""

    def __post_init__(self) -> None:
        _validate(self)

    @property
    def contracts(self) -> dict[str, GraphContract]:
        """Contract of every graph of this bundle, by name."""
        sizes = (self.levels, self.text.width, len(self.features.mean))
        if self.family == "kinegraph":
            declared = contracts(*sizes, self.format_version)
        else:
            declared = released_contracts(self.family, *sizes)
        return {name: contract for name, contract in declared.items() if contract.file in self.files}

    @property
    def attends_to_words(self) -> bool:
        """Whether the words of a caption stand beside the nodes of its graph."""
        return any("word" in level.nodes for level in self.levels.values())

    @property
    def knows_partial_captions(self) -> bool:
        """Whether the model has a token that says that a caption may name only a part of what happens."""
        return self.format_version >= CONTEXT_MIXING_VERSION and self.family == "kinegraph"

    @property
    def seconds_limits(self) -> tuple[float, float]:
        """Shortest and longest clip, seconds."""
        return self.frames.min / self.fps, self.frames.max / self.fps


# Reading and writing

# A manifest ends with its own SHA-256, over every byte before it. No other file vouches for this one, and a flipped
# bit in a mean or a scale would otherwise change the motion unnoticed.
_SEAL: Final = re.compile(rb',\n "sha256": "([0-9a-f]{64})"\n}\n\Z')


def encode_manifest(manifest: Manifest) -> bytes:
    """Write the content of `manifest.json`, sealed with its own SHA-256."""
    # allow_nan=False: a NaN quality figure must fail here, not at every user's load.
    text = json.dumps(to_plain(manifest), indent=1, ensure_ascii=False, allow_nan=False)
    return seal(text.removesuffix("\n}").encode())


def seal(body: bytes) -> bytes:
    """Close the text of a JSON object (without its last newline and brace) with the SHA-256 of that text."""
    return body + b',\n "sha256": "' + hashlib.sha256(body).hexdigest().encode() + b'"\n}\n'


def decode_manifest(data: bytes) -> Manifest:
    """Read and validate the content of `manifest.json`.

    Raises:
        BundleIntegrityError: the bytes differ from the SHA-256 at their end.
        BundleFormatError: unknown or missing key, wrong type, number not finite, wrong version, or fields
            that contradict each other; the message names the path of the key.
    """
    end = _SEAL.search(data[-100:])
    if end is None:
        raise BundleIntegrityError(
            "manifest.json does not end with its own sha256: it was cut, edited or written by another "
            "program; fetch the bundle again or export it again"
        )
    body = data[: len(data) - len(end.group(0))]
    if hashlib.sha256(body).hexdigest().encode() != end.group(1):
        raise BundleIntegrityError(
            "manifest.json differs from the sha256 at its end; fetch the bundle again or export it again"
        )
    value = parse_object(body + b"\n}", "manifest.json")
    # The version first: a newer format has other keys, and "unknown key" would send the reader the wrong way.
    if type(value.get("format_version")) is int:
        _check_version(value["format_version"])
    return decode(Manifest, value, "manifest.json")


def describe_file(data: bytes) -> FileSpec:
    """Describe the content of one file for `Manifest.files`."""
    return FileSpec(sha256=hashlib.sha256(data).hexdigest(), bytes=len(data))


# Validation: ranges, and agreement between fields, which types alone cannot express

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


def _validate(manifest: Manifest) -> None:
    _check_version(manifest.format_version)
    _check_body(manifest)
    _check_features(manifest.features)
    _check_levels(manifest.levels, manifest.format_version, levels_of(manifest.family))
    if manifest.family != "kinegraph":
        for name, level in manifest.levels.items():
            _require(set(level.nodes) <= set(SLOTS), f"levels.{name}.nodes", f"must be some of {list(SLOTS)}")
    _check_schedule(manifest)
    _check_files(manifest)


def _require(holds: bool, key: str, message: str) -> None:
    if not holds:
        raise BundleFormatError(f"manifest.json: {key} {message}")


def _check_version(version: int) -> None:
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
