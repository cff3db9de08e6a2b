"""The toy bundle (`tests/toy_bundle`): trained, float32, two megabytes.

It carries no parser. Tests that hand it sentences use `with_parser`, a copy with the parser of the default bundle.
"""

from __future__ import annotations

import dataclasses
import shutil
from collections.abc import Mapping
from pathlib import Path

from kinegraph.bundle.manifest import decode_manifest, describe_file, encode_manifest
from kinegraph.bundle.reader import text_files_folder

TOY_BUNDLE = Path(__file__).resolve().parents[1] / "toy_bundle" / "bundle"
PARSER_FILES = ("parser.bin", "arguments.npz")


def with_parser(folder: Path, more: Mapping[str, bytes] | None = None) -> Path:
    """Write the toy bundle with the default bundle's parser into `folder`, which must not exist, and seal it anew.

    Args:
        folder: where to write.
        more: other optional files, by name.
    """
    shutil.copytree(TOY_BUNDLE, folder)
    manifest = decode_manifest((folder / "manifest.json").read_bytes())
    files = dict(manifest.files)
    parser = {name: (text_files_folder() / name).read_bytes() for name in PARSER_FILES}
    for name, data in {**parser, **(more or {})}.items():
        (folder / name).write_bytes(data)
        files[name] = describe_file(data)
    (folder / "manifest.json").write_bytes(encode_manifest(dataclasses.replace(manifest, files=files)))
    return folder
