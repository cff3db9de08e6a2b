"""Command-line arguments that the benchmarks share, declared once."""

from __future__ import annotations

import argparse
from collections.abc import Collection
from pathlib import Path
from typing import Any

ARGUMENTS: dict[str, dict[str, Any]] = {
    "data": {"required": True, "help": "folder of the captured motion (bandai)"},
    "held_out": {"required": True, "help": "held_out_pairs.json: pairs of actions that training never joined"},
    "run": {"required": True, "help": "training run with the three autoencoders"},
    "autoencoders": {"required": True, "help": "training run whose autoencoders and caches are shared"},
    "bundle": {"type": str, "help": "an installed bundle or the folder of one; the default bundle without it"},
    "work": {"default": Path("evaluation"), "help": "folder that keeps generated clips, so that a stopped run goes on"},
    "out": {"required": True, "help": "JSON file; a .md file is written beside it"},
}
"""Keyword arguments of `add_argument` by name; each is a path unless it says otherwise."""


def benchmark_parser(doc: str | None) -> argparse.ArgumentParser:
    """Make the parser of a benchmark, whose help is the module's docstring as it is laid out."""
    return argparse.ArgumentParser(description=doc, formatter_class=argparse.RawDescriptionHelpFormatter)


def add_arguments(
    parser: argparse.ArgumentParser,
    *names: str,
    optional: Collection[str] = (),
    repeats: int | None = None,
    seeds: int | None = None,
    quick: str | None = None,
) -> None:
    """Add shared arguments to a parser.

    Args:
        parser: of the benchmark.
        names: keys of `ARGUMENTS`, in the order of the help.
        optional: those of `names` that may be left out although others require them.
        repeats: default of `--repeats`; without it there is no such argument.
        seeds: default of `--seeds`, a number of seeds; without it there is no such argument.
        quick: what `--quick` cuts down to, for the help; without it there is no such flag.
    """
    if repeats is not None:
        parser.add_argument("--repeats", type=int, default=repeats, help=f"how often to measure ({repeats})")
    if seeds is not None:
        parser.add_argument("--seeds", type=int, default=seeds, help=f"number of seeds of each sentence ({seeds})")
    if quick is not None:
        parser.add_argument("--quick", action="store_true", help=f"{quick}: does it run?")
    for name in names:
        settings = ARGUMENTS[name] | ({"required": False} if name in optional else {})
        parser.add_argument(f"--{name.replace('_', '-')}", **{"type": Path, **settings})
