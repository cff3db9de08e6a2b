"""The command line: `kinegraph generate | compose | sequence | view | play | parse | info | verify | bench`.

Exit codes: 0 done; 2 wrong input, bundle or target (one line on stderr says what); 130 interrupted.
"""

from __future__ import annotations

import argparse
import io
import os
import sys
from collections.abc import Sequence
from typing import Final

from kinegraph import __version__
from kinegraph.cli_arguments import (
    add_bench,
    add_bundle,
    add_compose,
    add_generate,
    add_parse,
    add_play,
    add_sequence,
    add_view,
)
from kinegraph.cli_input import captions, check_only_jsonl, edited, input_graph, load
from kinegraph.cli_making import compose, generate, sequence
from kinegraph.cli_output import as_json, info_record, info_text, one_line, verify_text
from kinegraph.cli_pages import play, view
from kinegraph.errors import Cancelled, InvalidInputError, KinegraphError

# Everything that loads numpy or onnxruntime is imported where it is used: `--help` must be instant.

EXIT_ERROR: Final = 2
EXIT_INTERRUPTED: Final = 130
EXIT_BROKEN_PIPE: Final = 141
"""128 + SIGPIPE, what a shell reports for a program that wrote to a closed pipe."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command; returns the exit code (argparse itself exits with 0 or 2)."""
    options = _parser().parse_args(arguments)
    if isinstance(sys.stdout, io.TextIOWrapper):
        # A terminal without Unicode shows an escape instead of ending the program.
        sys.stdout.reconfigure(errors="backslashreplace")
    try:
        code: int = options.run(options)
        sys.stdout.flush()
    except BrokenPipeError:
        # The reader (head, less) has gone. Python would complain once more while closing stdout.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return EXIT_BROKEN_PIPE
    except (KeyboardInterrupt, Cancelled):
        print("kinegraph: cancelled", file=sys.stderr)
        return EXIT_INTERRUPTED
    except KinegraphError as error:
        print(f"kinegraph: error: {one_line(error)}", file=sys.stderr)
        return EXIT_ERROR
    return code


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="kinegraph", description="A sentence in, a clip of human motion out, on a plain CPU."
    )
    parser.add_argument("--version", action="version", version=f"kinegraph {__version__}")
    verbs = parser.add_subparsers(title="commands", required=True, metavar="COMMAND")
    for name, text, arguments, run in (
        ("generate", "make a clip from a sentence or a graph", add_generate, generate),
        ("compose", "make a clip of several motions at once, or without some", add_compose, compose),
        ("sequence", "make a clip of several sentences, one after another", add_sequence, sequence),
        ("view", "show saved clips in the browser", add_view, view),
        ("play", "make clips in the browser, on this machine", add_play, play),
        ("parse", "print or draw the semantic graph of a sentence", add_parse, _parse),
        ("info", "what a bundle is: what it can do, licences, provenance, sizes, quality", add_bundle, _info),
        ("verify", "check every file, operator and session of a bundle", add_bundle, _verify),
        ("bench", "how fast a bundle is on this machine, stage by stage", add_bench, _bench),
    ):
        verb = verbs.add_parser(name, help=text)
        arguments(verb)
        verb.set_defaults(run=run)
    return parser


def _parse(options: argparse.Namespace) -> int:
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
    from kinegraph.formats.atomic import check_target, write_atomically

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


def _info(options: argparse.Namespace) -> int:
    from kinegraph.bundle import read_bundle

    record = info_record(read_bundle(options.bundle))
    print(as_json(record) if options.json else info_text(record))
    return 0


def _verify(options: argparse.Namespace) -> int:
    from kinegraph.strict_json import plain
    from kinegraph.verify import verify_bundle

    report = verify_bundle(options.bundle)
    if options.json:
        print(as_json({**plain(report), "path": str(report.path)}))
    else:
        print(verify_text(report))
    return 0


def _bench(options: argparse.Namespace) -> int:
    from kinegraph.bench import bench, table
    from kinegraph.formats.atomic import check_target, write_atomically
    from kinegraph.strict_json import plain

    if options.repeats < 1:
        raise InvalidInputError(f"repeats must be 1 or more, not {options.repeats}")
    if options.json is not None:
        check_target(options.json, True, (".json",))
    report = bench(options.bundle, seconds=options.seconds, repeats=options.repeats, threads=options.threads)
    if options.json is not None:
        write_atomically(options.json, (as_json(plain(report), pretty=True) + "\n").encode())
    print(table(report))
    return 0


if __name__ == "__main__":
    sys.exit(main())
