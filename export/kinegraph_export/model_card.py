"""Write the model card of a bundle as Markdown: what it can and cannot, its actions, licences and origins.

    python -m kinegraph_export.model_card --bundle studio --out studio.md

All of it stands in the bundle (`kinegraph info`, `kinegraph info --words`).
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from kinegraph.bundle.reader import Bundle, read_bundle
from kinegraph.cli.inspect import info_record, words_record
from kinegraph.files import write_atomically


def model_card(bundle: Bundle) -> str:
    """Format the card of a bundle, the best shown actions first."""
    record, words = info_record(bundle), words_record(bundle)
    shortest, longest = record["seconds"]
    lines = [
        f"# {record['name']} {record['version']}",
        "",
        f"Clips of {shortest:g} to {longest:g} seconds at {record['fps']:g} frames per second; "
        f"{sum(record['bytes'].values()) / 1e6:.1f} MB in {record['precision']}.",
        *_facts("What it can do, and what it cannot", record["scope"]),
    ]
    if words["actions"] is not None:
        lines += [
            "",
            "Clips were recorded, or made where the origins say so. Words that are not of these, nor of their "
            "compositions, are told as unknown.",
            *_phrases("Actions", words["actions"]),
            *_phrases("Manners", words["styles"]),
        ]
    for title, key in (("Licences", "licence"), ("Origins", "provenance"), ("Training", "training")):
        lines += _facts(title, record[key])
    lines += _facts("Quality", record["quality"])
    return "\n".join(lines) + "\n"


def _facts(title: str, facts: Mapping[str, Any]) -> list[str]:
    """Format a section with a point for each fact."""
    points = [f"- **{name.replace('_', ' ')}**: {_cell(value)}" for name, value in facts.items()]
    return ["", f"## {title}", "", *points] if points else []


def _phrases(title: str, phrases: Sequence[Mapping[str, Any]]) -> list[str]:
    """Format a table of actions or styles."""
    if not phrases:
        return []
    is_measured = any(phrase["recognised"] is not None for phrase in phrases)
    heads = ["name", "clips", *(["recognised"] if is_measured else []), "example"]
    lines = ["", f"## {title}", ""]
    if is_measured:
        lines += ["*Recognised*: the share of its own clips in which it is found among 32 actions.", ""]
    lines += ["| " + " | ".join(heads) + " |", "|---" * len(heads) + "|"]
    for phrase in phrases:
        share = "" if phrase["recognised"] is None else format(phrase["recognised"], ".2f")
        cells = [phrase["name"], str(phrase["clips"]), *([share] if is_measured else []), phrase["example"]]
        lines.append("| " + " | ".join(_cell(cell) for cell in cells) + " |")
    return lines


def _cell(value: object) -> str:
    """Format a value so that it neither ends a line nor a cell of a table."""
    text = f"{value:.4g}" if isinstance(value, float) else str(value)
    return " ".join(text.split()).replace("|", "\\|")


def main(argv: list[str] | None = None) -> None:
    """Run the command line."""
    parser = argparse.ArgumentParser(prog="kinegraph_export.model_card", description=__doc__.split("\n")[0])
    parser.add_argument("--bundle", help="an installed bundle or the folder of one; the default bundle without it")
    parser.add_argument("--out", type=Path, required=True, help="Markdown file to write, or to replace")
    options = parser.parse_args(argv)
    write_atomically(options.out, model_card(read_bundle(options.bundle)).encode())
    print(options.out)


if __name__ == "__main__":
    main()
