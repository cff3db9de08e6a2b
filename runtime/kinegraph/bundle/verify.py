"""The thorough check behind `kinegraph verify`: all that loading checks, operators and sessions on top."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from kinegraph.bundle.manifest import OPTIONAL_GRAPH_FILES
from kinegraph.bundle.onnx_inspect import summarise
from kinegraph.bundle.reader import Bundle, read_bundle
from kinegraph.bundle.sessions import open_sessions
from kinegraph.errors import BundleFormatError


@dataclass(frozen=True)
class VerifyReport:
    """What was found right; anything wrong is an exception."""

    path: Path
    name: str
    version: str
    files: Mapping[str, int]
    """Bytes of each file whose size and SHA-256 agree with the manifest."""
    operators: Mapping[str, int]
    """Number of different operators of each graph, all of them on the manifest's list."""
    sessions: tuple[str, ...]
    """Graphs that onnxruntime loads and whose inputs and outputs keep the contract."""


def verify_bundle(path: Path | None = None) -> VerifyReport:
    """Check a bundle without running it.

    Args:
        path: folder of the bundle; None is the one that comes with the package.

    Raises:
        BundleError: the first thing that is wrong, naming the file.
    """
    bundle = read_bundle(path)
    operators = {name: _check_operators(bundle, name) for name in bundle.manifest.operators}
    for session in open_sessions(bundle, threads=1).deferred:
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
    data = bundle.optional(name) if name in OPTIONAL_GRAPH_FILES else bundle.files[name]
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
