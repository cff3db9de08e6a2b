"""`manifest.json`: what a bundle is. Read-only facts; what a call wants lives in `kinegraph.options`."""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final, Literal

from kinegraph.contract import GraphContract, LevelSpec, contracts
from kinegraph.diffusion.schedule import NoiseSchedule
from kinegraph.errors import BundleIntegrityError
from kinegraph.manifest_checks import check_manifest, check_version
from kinegraph.strict_json import decode, parse_object, plain


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
    joint_names: tuple[str, ...]
    parents: tuple[int, ...]


@dataclass(frozen=True)
class FrameSpec:
    """Frames one clip may have."""

    min: int
    max: int
    per_token: int
    """Frames per token of the decoder's sequence; the frame mask is padded to a multiple of it."""


@dataclass(frozen=True)
class FeatureSpec:
    layout: Literal["joints-137", "humanml3d-263"]
    heading: Literal["true", "humanml3d"]
    mean: tuple[float, ...]
    std: tuple[float, ...]
    """Features are `decoded * std + mean`."""


@dataclass(frozen=True)
class TextSpec:
    width: int
    """D, width of the text encoder's states."""
    mask_token: str
    """What a masked word is replaced by in the caption."""


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
        """The schedule to sample with."""
        return NoiseSchedule(self.train_steps, self.beta_start, self.beta_end, self.steps_offset, self.spacing)


@dataclass(frozen=True)
class Defaults:
    """What a call gets that does not say otherwise."""

    steps: Mapping[str, int]
    """Diffusion steps per level."""
    guidance: Mapping[str, float]
    """Guidance scale per level."""
    guidance_base: Literal["empty", "coarse"]
    """What guidance leads away from: GraphMotion's "empty" set (Eq. A), or no text beside the "coarse"r latent."""
    seconds: float


@dataclass(frozen=True)
class FileSpec:
    sha256: str
    bytes: int


@dataclass(frozen=True)
class Manifest:
    """All of `manifest.json`; made by `decode_manifest`, written by `to_json`."""

    format_version: int
    name: str
    version: str
    licence: Licence
    provenance: Mapping[str, str]
    """Training data, sources and hashes of text encoder and parser, versions of the build tools."""
    scope: Mapping[str, str]
    """What the model can do and what it cannot, in words: actions, manners, and so on."""
    skeleton: SkeletonSpec
    fps: float
    frames: FrameSpec
    features: FeatureSpec
    text: TextSpec
    levels: Mapping[str, LevelSpec]
    schedule: ScheduleSpec
    defaults: Defaults
    roles: tuple[str, ...]
    precision: Literal["fp32", "int8"]
    files: Mapping[str, FileSpec]
    operators: Mapping[str, tuple[str, ...]]
    """Graph file -> sorted `domain::OpType`; `kinegraph verify` compares them with the graphs."""
    parity: Mapping[str, float]
    training: Mapping[str, str | float | int]
    quality: Mapping[str, float]

    def __post_init__(self) -> None:
        check_manifest(self)

    @property
    def contracts(self) -> dict[str, GraphContract]:
        """Contract of every graph of this bundle, by name."""
        declared = contracts(self.levels, self.text.width, len(self.features.mean))
        return {name: contract for name, contract in declared.items() if contract.file in self.files}

    @property
    def seconds_limits(self) -> tuple[float, float]:
        """Shortest and longest clip, seconds."""
        return self.frames.min / self.fps, self.frames.max / self.fps


# A manifest ends with its own SHA-256, over every byte before it: no other file vouches for this one,
# and a flipped bit in a mean or a scale would otherwise change the motion without a sign.
_SEAL: Final = re.compile(rb',\n "sha256": "([0-9a-f]{64})"\n}\n\Z')


def to_json(manifest: Manifest) -> bytes:
    """The content of `manifest.json`, sealed with its own SHA-256."""
    # allow_nan=False: a NaN quality figure must fail here, not at every user's load.
    text = json.dumps(plain(manifest), indent=1, ensure_ascii=False, allow_nan=False)
    return seal(text.removesuffix("\n}").encode())


def seal(body: bytes) -> bytes:
    """Close the text of a JSON object (without its last newline and brace) with the SHA-256 of that text."""
    return body + b',\n "sha256": "' + hashlib.sha256(body).hexdigest().encode() + b'"\n}\n'


def decode_manifest(data: bytes) -> Manifest:
    """Read and check the content of `manifest.json`.

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
    """Entry of `files` for a file with this content."""
    return FileSpec(sha256=hashlib.sha256(data).hexdigest(), bytes=len(data))
