"""`kinegraph parse | info | verify | bench`: look at a sentence's graph, or at a bundle."""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from kinegraph.cli.console import as_json
from kinegraph.cli.inputs import captions, check_only_jsonl, edited, input_graph, load
from kinegraph.errors import InvalidInputError, KinegraphError

# Everything that loads numpy or onnxruntime is imported where it is used: `--help` must be instant.
if TYPE_CHECKING:
    from kinegraph.bundle.reader import Bundle
    from kinegraph.bundle.verify import VerifyReport


def parse(options: argparse.Namespace) -> int:
    if options.jsonl is None:
        return _parse_one(options)
    check_only_jsonl(options)
    lines = captions(options.jsonl)
    pipeline = load(options.bundle, None, True)
    for place, caption in lines:
        try:
            graph = pipeline.parse(caption)
        except KinegraphError as error:
            # The type stays: only the message grows by the place.
            raise type(error)(f"{place}: {error}") from error
        print(as_json(graph.to_dict()))
    return 0


def _parse_one(options: argparse.Namespace) -> int:
    from kinegraph.files import check_target, write_atomically

    if options.svg is not None:
        check_target(options.svg, options.force, (".svg",))
    wish = input_graph(options.text, options.graph)
    graph = edited(load(options.bundle, None, True).parse(wish) if isinstance(wish, str) else wish, options.edits)
    if options.svg is None:
        print(as_json(graph.to_dict(), pretty=not options.json))
    else:
        from kinegraph.formats.graph_svg import graph_svg

        write_atomically(options.svg, graph_svg(graph).encode(), force=options.force)
        print(as_json({"file": str(options.svg)}) if options.json else options.svg)
    return 0


def info(options: argparse.Namespace) -> int:
    from kinegraph.bundle.reader import read_bundle

    record = info_record(read_bundle(options.bundle))
    print(as_json(record) if options.json else info_text(record))
    return 0


def verify(options: argparse.Namespace) -> int:
    from kinegraph.bundle.strict_json import to_plain
    from kinegraph.bundle.verify import verify_bundle

    report = verify_bundle(options.bundle)
    if options.json:
        print(as_json({**to_plain(report), "path": str(report.path)}))
    else:
        print(verify_text(report))
    return 0


def run_bench(options: argparse.Namespace) -> int:
    from kinegraph.bench import bench, table
    from kinegraph.bundle.strict_json import to_plain
    from kinegraph.files import check_target, write_atomically

    if options.repeats < 1:
        raise InvalidInputError(f"repeats must be 1 or more, not {options.repeats}")
    if options.json is not None:
        check_target(options.json, True, (".json",))
    report = bench(options.bundle, seconds=options.seconds, repeats=options.repeats, threads=options.threads)
    if options.json is not None:
        write_atomically(options.json, (as_json(to_plain(report), pretty=True) + "\n").encode())
    print(table(report))
    return 0


def info_record(bundle: Bundle) -> dict[str, Any]:
    """What `info` tells, as plain values."""
    from kinegraph.bundle.strict_json import to_plain

    manifest = to_plain(bundle.manifest)
    features = manifest["features"]
    return {
        "name": manifest["name"],
        "version": manifest["version"],
        "path": str(bundle.path),
        "precision": manifest["precision"],
        "licence": manifest["licence"],
        "provenance": manifest["provenance"],
        "scope": manifest["scope"],
        "seconds": list(bundle.manifest.seconds_limits),
        "fps": manifest["fps"],
        "features": {"layout": features["layout"], "heading": features["heading"]},
        "levels": manifest["levels"],
        "defaults": manifest["defaults"],
        "bytes": {name: entry["bytes"] for name, entry in manifest["files"].items()},
        "training": manifest["training"],
        "quality": manifest["quality"],
        "parity": manifest["parity"],
    }


def info_text(record: Mapping[str, Any]) -> str:
    """The table of `kinegraph info`."""
    sizes = record["bytes"]
    shortest, longest = record["seconds"]
    defaults = record["defaults"]
    lines = [
        f"{record['name']} {record['version']} ({record['precision']}, {_megabytes(sum(sizes.values()))})",
        record["path"],
        f"clips of {shortest:g} to {longest:g} seconds at {record['fps']:g} frames per second, "
        f"default {defaults['seconds']:g}; features {record['features']['layout']}",
    ]
    for name, level in record["levels"].items():
        lines.append(
            f"  {name:<9} {level['tokens']} tokens, {level['layers']} layers of width {level['width']}, "
            f"{defaults['steps'][name]} steps, guidance {defaults['guidance'][name]:g}"
        )
    lines += _section("what it can do, and what it cannot", record["scope"])
    lines += _section("licences", record["licence"])
    lines += _section("provenance", record["provenance"])
    lines += _section("training", record["training"])
    lines += _section("quality", record["quality"])
    lines += _section("parity (largest difference; int8: relative; mm: mean of joints)", record["parity"])
    lines += _section("files", {name: _megabytes(size) for name, size in sizes.items()})
    return "\n".join(lines)


def verify_text(report: VerifyReport) -> str:
    """The table of `kinegraph verify`; there is one only if all is well."""
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
