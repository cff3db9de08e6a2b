"""Change files in the folder of a bundle, and its manifest with them: a change that fails leaves all as it was."""

from __future__ import annotations

import dataclasses
from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from kinegraph.bundle.manifest import FileSpec, Manifest, describe_file, encode_manifest
from kinegraph.bundle.onnx_inspect import summarise
from kinegraph.bundle.reader import MANIFEST
from kinegraph.files import write_atomically


def listed_files(manifest: Manifest, files: Mapping[str, bytes]) -> dict[str, FileSpec]:
    """List the files of a manifest and further ones by name, or others under the same names."""
    described = {name: describe_file(data) for name, data in files.items()}
    return dict(sorted({**manifest.files, **described}.items()))


def with_graphs(
    manifest: Manifest, graphs: Mapping[str, bytes], parity: Mapping[str, float], **changes: Any
) -> Manifest:
    """List further graphs in a manifest, or others under the same names.

    Args:
        manifest: of the bundle.
        graphs: ONNX bytes by file name.
        parity: their differences from torch.
        changes: other fields of the manifest.
    """
    operators = {name: summarise(data, name).operators for name, data in graphs.items()}
    replaced = {f"{prefix}{name.removesuffix('.onnx')}" for name in graphs for prefix in ("", "int8_")}
    kept = {name: value for name, value in manifest.parity.items() if name not in replaced}
    return dataclasses.replace(
        manifest,
        files=listed_files(manifest, graphs),
        operators=dict(sorted({**manifest.operators, **operators}.items())),
        parity={**kept, **parity},
        **changes,
    )


def write_files(folder: Path, manifest: Manifest, files: Mapping[str, bytes] | None = None) -> None:
    """Write files into a bundle's folder, each at once, and its manifest after them.

    Raises:
        OutputError: the folder cannot be written.
    """
    for name, data in {**(files or {}), MANIFEST: encode_manifest(manifest)}.items():
        write_atomically(folder / name, data)


@contextmanager
def unchanged_if_it_fails(folder: Path, names: Collection[str]) -> Iterator[None]:
    """Bring files of a bundle back, and its manifest, if the block fails or is stopped.

    Args:
        folder: of the bundle.
        names: of the files that the block writes; those that are not there now are removed again.
    """
    paths = [folder / name for name in (*names, MANIFEST)]
    before = {path: path.read_bytes() for path in paths if path.is_file()}
    try:
        yield
    except BaseException:
        for path in paths:
            if path in before:
                write_atomically(path, before[path])
            else:
                path.unlink(missing_ok=True)
        raise
