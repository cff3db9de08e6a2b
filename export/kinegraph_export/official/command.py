"""What the command lines of the importers share."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable
from pathlib import Path
from typing import get_args

from kinegraph.bundle.manifest import Manifest
from kinegraph.errors import KinegraphError
from kinegraph_export.graphs import Precision


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options that all importers have."""
    parser.add_argument("--checkpoint", type=Path, required=True, help="file of the published weights")
    parser.add_argument("--clip", type=Path, required=True, help="folder of openai/clip-vit-large-patch14")
    parser.add_argument("--stats", type=Path, required=True, help="folder of Mean.npy and Std.npy of the data set")
    parser.add_argument("--out", type=Path, required=True, help="folder of the bundle")
    parser.add_argument("--precision", choices=get_args(Precision), default="int8", help="of the denoisers")
    parser.add_argument("--parser", type=Path, help="bundle whose sentence parser is taken; the default one otherwise")


def run_import(import_bundle: Callable[[], Manifest], out: Path) -> int:
    """Import, print how far the graphs are from the networks and the size of the bundle; return the exit status."""
    try:
        manifest = import_bundle()
    except KinegraphError as error:
        print(f"{type(error).__name__}: {error}", file=sys.stderr)
        return 2
    for name, difference in manifest.parity.items():
        print(f"{name:24s} {difference:.2e}")
    size = sum(entry.bytes for entry in manifest.files.values())
    print(f"{size / 1e6:.1f} MB in {out}", file=sys.stderr)
    return 0
