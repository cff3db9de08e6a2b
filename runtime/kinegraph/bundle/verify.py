"""Full check of a bundle for `kinegraph verify`: everything that loading checks, then operators and sessions."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from kinegraph.bundle.onnx_inspect import summarise
from kinegraph.bundle.reader import Bundle, read_bundle
from kinegraph.bundle.sessions import open_sessions
from kinegraph.errors import BundleFormatError


@dataclass(frozen=True)
class VerifyReport:
    """Facts that were checked and hold; anything wrong is an exception."""

    path: Path
    name: str
    version: str
    files: Mapping[str, int]
    """File name -> bytes; size and SHA-256 agree with the manifest."""
    operators: Mapping[str, int]
    """Graph file -> number of different operators; they equal those that the manifest lists."""
    sessions: tuple[str, ...]
    """Graphs that onnxruntime loads, with inputs and outputs as in the contract."""


def verify_bundle(path: str | Path | None = None) -> VerifyReport:
    """Check a bundle without running it.

    Args:
        path: folder of the bundle, or the name of an installed one; None takes the default bundle.

    Raises:
        BundleError: the first violation; the message names the file.
    """
    bundle = read_bundle(path)
    operators = {name: _check_operators(bundle, name) for name in bundle.manifest.operators}
    for session in open_sessions(bundle, threads=1).lazy:
        session()
    manifest = bundle.manifest
    return VerifyReport(
        path=bundle.path,
        name=manifest.name,
        version=manifest.version,
        files={name: entry.bytes for name, entry in manifest.files.items()},
        operators=operators,
        sessions=tuple(manifest.contracts),
    )


def _check_operators(bundle: Bundle, name: str) -> int:
    data = bundle.read_graph(name)
    summary = summarise(data, name)
    if summary.external_data:
        raise BundleFormatError(f"{name} keeps tensors in another file; export it with all data inside")
    listed = bundle.manifest.operators[name]
    for operator in summary.operators:
        if operator not in listed:
            raise BundleFormatError(f"{name} uses the operator {operator}, which the manifest does not list")
    for operator in listed:
        if operator not in summary.operators:
            raise BundleFormatError(f"the manifest lists {operator} for {name}, which does not use it")
    return len(summary.operators)
