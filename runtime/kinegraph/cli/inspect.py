"""`kinegraph parse | info | verify | bench`: show the graph of a sentence, or describe a bundle."""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from kinegraph.cli.console import as_json
from kinegraph.cli.inputs import apply_edits, check_jsonl_alone, load_pipeline, read_captions, read_text_or_graph
from kinegraph.errors import BundleError, InvalidInputError, KinegraphError

# Modules that load numpy or onnxruntime are imported where they are used: `--help` must be instant.
if TYPE_CHECKING:
    from kinegraph.bundle.reader import Bundle
    from kinegraph.bundle.verify import VerifyReport


def parse(args: argparse.Namespace) -> int:
    """Run `kinegraph parse`."""
    if args.jsonl is None:
        return _parse_one(args)
    check_jsonl_alone(args)
    captions = read_captions(args.jsonl)
    pipeline = load_pipeline(args.bundle, None, parses=True)
    for location, caption in captions:
        try:
            graph = pipeline.parse(caption)
        except KinegraphError as error:
            # The type stays; the message gains the location.
            raise type(error)(f"{location}: {error}") from error
        print(as_json(graph.to_dict()))
    return 0


def _parse_one(args: argparse.Namespace) -> int:
    from kinegraph.files import check_target, write_atomically

    if args.svg is not None:
        check_target(args.svg, args.force, (".svg",))
    graph = read_text_or_graph(args.text, args.graph)
    if isinstance(graph, str):
        graph = load_pipeline(args.bundle, None, parses=True).parse(graph)
    graph = apply_edits(graph, args.edits)
    if args.svg is None:
        print(as_json(graph.to_dict(), pretty=not args.json))
    else:
        from kinegraph.formats.graph_svg import graph_svg

        write_atomically(args.svg, graph_svg(graph).encode(), force=args.force)
        print(as_json({"file": str(args.svg)}) if args.json else args.svg)
    return 0


def info(args: argparse.Namespace) -> int:
    """Run `kinegraph info`."""
    from kinegraph.bundle.reader import read_bundle

    bundle = read_bundle(args.bundle)
    if args.words:
        known = words_record(bundle)
        print(as_json(known) if args.json else words_text(known))
    else:
        record = info_record(bundle)
        print(as_json(record) if args.json else info_text(record))
    return 0


def verify(args: argparse.Namespace) -> int:
    """Run `kinegraph verify`."""
    from kinegraph.bundle.strict_json import to_plain
    from kinegraph.bundle.verify import verify_bundle

    report = verify_bundle(args.bundle)
    if args.json:
        print(as_json({**to_plain(report), "path": str(report.path)}))
    else:
        print(verify_text(report))
    return 0


def run_bench(args: argparse.Namespace) -> int:
    """Run `kinegraph bench`."""
    from kinegraph.bench import bench, text_table
    from kinegraph.bundle.strict_json import to_plain
    from kinegraph.files import check_target, write_atomically

    if args.repeats < 1:
        raise InvalidInputError(f"repeats must be 1 or more, not {args.repeats}")
    if args.json is not None:
        check_target(args.json, True, (".json",))
    report = bench(args.bundle, seconds=args.seconds, repeats=args.repeats, threads=args.threads)
    if args.json is not None:
        write_atomically(args.json, (as_json(to_plain(report), pretty=True) + "\n").encode())
    print(text_table(report))
    return 0


def info_record(bundle: Bundle) -> dict[str, Any]:
    """Collect the facts of `info` as plain JSON values."""
    from kinegraph.bundle.reader import DEFAULT_BUNDLE, installed_bundles
    from kinegraph.bundle.strict_json import to_plain

    manifest = to_plain(bundle.manifest)
    features = manifest["features"]
    installed = {
        name: _describe_installed(folder, is_default=folder == DEFAULT_BUNDLE)
        for name, folder in installed_bundles().items()
    }
    return {
        "name": manifest["name"],
        "version": manifest["version"],
        "path": str(bundle.path),
        "precision": manifest["precision"],
        "family": manifest["family"],
        "licence": manifest["licence"],
        "provenance": manifest["provenance"],
        "scope": manifest["scope"],
        "seconds": list(bundle.manifest.seconds_limits),
        "fps": manifest["fps"],
        "features": {"layout": features["layout"], "heading": features["heading"]},
        "levels": manifest["levels"],
        "defaults": manifest["defaults"],
        "spacing": manifest["schedule"]["spacing"],
        "bytes": {name: entry["bytes"] for name, entry in manifest["files"].items()},
        "training": manifest["training"],
        "quality": manifest["quality"],
        "parity": manifest["parity"],
        "installed": installed,
    }


def _describe_installed(folder: Path, *, is_default: bool) -> dict[str, Any]:
    """Describe an installed bundle by its manifest alone; a broken one must not hide the others."""
    from kinegraph.bundle.reader import read_manifest

    try:
        manifest = read_manifest(folder)
    except BundleError as error:
        return {"default": is_default, "error": str(error)}
    facts = {"name": manifest.name, "version": manifest.version, "weights": manifest.licence.weights}
    return {"default": is_default, **facts}


def info_text(record: Mapping[str, Any]) -> str:
    """Format the table of `kinegraph info`; `record` is from `info_record`."""
    sizes = record["bytes"]
    shortest, longest = record["seconds"]
    defaults = record["defaults"]
    lines = [
        f"{record['name']} {record['version']} ({record['precision']}, {_megabytes(sum(sizes.values()))})",
        record["path"],
        f"clips of {shortest:g} to {longest:g} seconds at {record['fps']:g} frames per second, "
        f"default {defaults['seconds']:g}; features {record['features']['layout']}; networks {record['family']}",
    ]
    begin = "from pure noise" if record["spacing"] == "trailing" else "counted up from the clean end"
    for name, level in record["levels"].items():
        lines.append(
            f"  {name:<9} {level['tokens']} tokens, {level['layers']} layers of width {level['width']}, "
            f"{defaults['steps'][name]} steps {begin}, guidance {defaults['guidance'][name]:g}"
        )
    lines += _section("what it can do, and what it cannot", record["scope"])
    lines += _section("licences", record["licence"])
    lines += _section("provenance", record["provenance"])
    lines += _section("training", record["training"])
    lines += _section("quality", record["quality"])
    lines += _section("parity (largest difference; int8: relative; mm: mean of joints)", record["parity"])
    lines += _section("files", {name: _megabytes(size) for name, size in sizes.items()})
    lines += _section(
        "installed bundles, for --bundle NAME", {k: _installed_line(v) for k, v in record["installed"].items()}
    )
    return "\n".join(lines)


def _installed_line(entry: Mapping[str, Any]) -> str:
    """Format one installed bundle: what it is, and under which licence its weights are."""
    facts = entry.get("error") or f"{entry['name']} {entry['version']}; weights: {entry['weights']}"
    return f"{facts} (the default)" if entry["default"] else facts


def words_record(bundle: Bundle) -> dict[str, Any]:
    """Collect what `info --words` lists as plain JSON values; actions and styles are None without a vocabulary."""
    record: dict[str, Any] = {"name": bundle.manifest.name, "version": bundle.manifest.version}
    for kind in ("action", "style"):
        record[f"{kind}s"] = (
            None
            if bundle.vocabulary is None
            else [
                {
                    "name": phrase.name,
                    "example": phrase.example,
                    "clips": phrase.clips,
                    "recognised": phrase.recognised,
                    "wordings": list(phrase.wordings),
                }
                for phrase in bundle.vocabulary.facts.phrases
                if phrase.kind == kind
            ]
        )
    return record


def words_text(record: Mapping[str, Any]) -> str:
    """Format the list of `info --words`; `record` is from `words_record`."""
    title = f"{record['name']} {record['version']}"
    if record["actions"] is None:
        return (
            f"{title} does not know what it was shown: it has no vocabulary.npz, and so tells no unknown words. "
            "`kinegraph info` prints what its maker says of it; `python -m kinegraph_export.vocabulary` adds the file"
        )
    lines = [
        f"{title} was shown these, in clips that were recorded or made, and their compositions; other words are told"
    ]
    measured = any(phrase["recognised"] is not None for phrase in record["actions"])
    if measured:
        lines.append("(clips shown, share of its own clips in which it is recognised among 32 actions, example)")
    for kind in ("actions", "styles"):
        rows = {}
        for phrase in record[kind]:
            share = _share(phrase["recognised"]) if measured else ""
            rows[phrase["name"]] = f"{phrase['clips']:>5}  {share}{phrase['example']}"
        lines += _section(kind, rows)
    return "\n".join(lines)


def _share(share: float | None) -> str:
    return f"{'-' if share is None else format(share, '.2f'):>4}  "


def verify_text(report: VerifyReport) -> str:
    """Format the table of `kinegraph verify`, which exists only if everything is valid."""
    lines = [f"{report.name} {report.version}", str(report.path)]
    for name, size in report.files.items():
        operators = report.operators.get(name)
        graph = f", {operators} operators as listed, loads, contract kept" if operators else ""
        lines.append(f"  ok  {name}: {size} bytes, SHA-256 agrees{graph}")
    lines.append(f"ok: {len(report.files)} files, {len(report.sessions)} graphs")
    return "\n".join(lines)


def _section(title: str, values: Mapping[str, object]) -> list[str]:
    if not values:
        return []
    width = max(len(key) for key in values)
    return ["", f"{title}:", *(f"  {key:<{width}}  {_value(value)}" for key, value in values.items())]


def _value(value: object) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def _megabytes(size: int) -> str:
    return f"{size / 1e6:.1f} MB"
