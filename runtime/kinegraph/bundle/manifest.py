"""`manifest.json`: the read-only facts of a bundle, their reading and writing.

The records mirror the JSON object key by key; `manifest_validation` checks them. What one call asks for lives in
`kinegraph.options`.
"""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final, Literal

from kinegraph.bundle.contract import CONTEXT_MIXING_VERSION, Family, GraphContract, LevelSpec, contracts
from kinegraph.bundle.frames_part import FramesPart, frame_contracts
from kinegraph.bundle.manifest_validation import check_manifest, check_version
from kinegraph.bundle.released_contract import released_contracts
from kinegraph.bundle.strict_json import decode, parse_object, to_plain
from kinegraph.diffusion.sampling import NoiseSchedule
from kinegraph.errors import BundleIntegrityError
from kinegraph.limits import MAX_PIECES

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
    frames_part: FramesPart | None = None
    """Skeleton space; None if the bundle has no graphs of it."""

    def __post_init__(self) -> None:
        check_manifest(self)

    @property
    def contracts(self) -> dict[str, GraphContract]:
        """Contract of every graph of this bundle, by name."""
        sizes = (self.levels, self.text.width, len(self.features.mean))
        if self.family == "kinegraph":
            declared = contracts(*sizes, self.format_version)
            if self.frames_part is not None:
                declared |= frame_contracts(self.frames_part.level, self.text.width)
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
        check_version(value["format_version"])
    return decode(Manifest, value, "manifest.json")


def describe_file(data: bytes) -> FileSpec:
    """Describe the content of one file for `Manifest.files`."""
    return FileSpec(sha256=hashlib.sha256(data).hexdigest(), bytes=len(data))
