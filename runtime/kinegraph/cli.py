"""The command line: `kinegraph generate | compose | parse | info | verify`.

Exit codes: 0 done; 2 wrong input, bundle or target (one line on stderr says what); 130 interrupted.
"""

from __future__ import annotations

import argparse
import io
import os
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Final

from kinegraph import __version__
from kinegraph.cli_input import captions, concepts, input_graph, level_numbers, level_steps
from kinegraph.cli_output import Progress, as_json, info_record, info_text, one_line, verify_text
from kinegraph.errors import Cancelled, KinegraphError

# Everything that loads numpy or onnxruntime is imported where it is used: `--help` must be instant.
if TYPE_CHECKING:
    from kinegraph.motion.clip import Clip
    from kinegraph.pipeline import MotionPipeline

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
    _add_generate(verbs.add_parser("generate", help="make a clip from a sentence or a graph"))
    _add_compose(verbs.add_parser("compose", help="make a clip of several motions at once, or without some"))
    _add_parse(verbs.add_parser("parse", help="print the semantic graph of a sentence as JSON"))
    _add_info(verbs.add_parser("info", help="what a bundle is: licences, provenance, sizes, quality"))
    _add_verify(verbs.add_parser("verify", help="check every file, operator and session of a bundle"))
    return parser


def _add_bundle(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--bundle", type=Path, metavar="DIR", help="a bundle's folder; default: the built-in one")
    parser.add_argument("--json", action="store_true", help="print one JSON object on one line")


def _add_generate(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("text", nargs="?", help="the sentence, e.g. 'a person walks forward and waves'")
    parser.add_argument("--graph", metavar="FILE", help="a graph in JSON instead of the text; - is stdin")
    _add_sampling(parser)
    parser.set_defaults(run=_generate)


def _add_compose(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--and",
        dest="wanted",
        action="append",
        default=[],
        metavar="TEXT[:WEIGHT]",
        help="a motion that should happen; several times for several",
    )
    parser.add_argument(
        "--not",
        dest="unwanted",
        action="append",
        default=[],
        metavar="TEXT[:WEIGHT]",
        help="a motion that should not; weight 0.5 unless told",
    )
    parser.add_argument("--method", default="fused", help="latent, semantic or fused (default)")
    parser.add_argument("--text", help="the joint sentence of fused; default: the wanted ones joined with 'while'")
    parser.add_argument(
        "--lambdas", type=level_numbers, metavar="L,S,M", help="shares of latent, semantic and joint text in fused"
    )
    _add_sampling(parser)
    parser.set_defaults(run=_compose)


def _add_sampling(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "-o",
        "--output",
        type=Path,
        required=True,
        metavar="FILE",
        help="the suffix says the format: .npz, .bvh, .png",
    )
    parser.add_argument("--seconds", type=float, metavar="S", help="length; without it the sentence decides")
    parser.add_argument("--seed", type=int, help="the same seed gives the same clip; default: a new one")
    parser.add_argument(
        "--steps", type=level_steps, metavar="N[,N,N]", help="diffusion steps: one number, or one per level"
    )
    parser.add_argument(
        "--guidance", type=level_numbers, metavar="X[,X,X]", help="guidance scale: one, or one per level"
    )
    parser.add_argument("--threads", type=int, metavar="N", help="threads a model may use")
    parser.add_argument("--force", action="store_true", help="overwrite the file if it is there")
    parser.add_argument("--progress", action="store_true", help="show progress even if stderr is no terminal")
    parser.add_argument("--quiet", action="store_true", help="print nothing but errors")
    _add_bundle(parser)


def _add_parse(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("text", nargs="?", help="the sentence")
    parser.add_argument(
        "--jsonl",
        type=Path,
        metavar="FILE",
        help='many: a caption or {"caption": "..."} on each line; prints one object on each line',
    )
    _add_bundle(parser)
    parser.set_defaults(run=_parse)


def _add_info(parser: argparse.ArgumentParser) -> None:
    _add_bundle(parser)
    parser.set_defaults(run=_info)


def _add_verify(parser: argparse.ArgumentParser) -> None:
    _add_bundle(parser)
    parser.set_defaults(run=_verify)


def _generate(options: argparse.Namespace) -> int:
    _check_target(options)
    wish = input_graph(options.text, options.graph)
    return _make(options, lambda pipeline, **wishes: pipeline.generate(wish, **wishes))


def _compose(options: argparse.Namespace) -> int:
    _check_target(options)
    found = concepts(options.wanted, options.unwanted)
    own = {"method": options.method, "text": options.text, "lambdas": options.lambdas}
    return _make(options, lambda pipeline, **wishes: pipeline.compose(found, **own, **wishes))


def _check_target(options: argparse.Namespace) -> None:
    """The cheapest check first, and nothing is computed for a file that cannot be written."""
    from kinegraph.motion.clip import check_target

    check_target(options.output, options.force)


def _make(options: argparse.Namespace, make: Callable[..., Clip]) -> int:
    """Load, make, write, report."""
    start = time.perf_counter()
    pipeline = _load(options.bundle, options.threads)
    loaded = time.perf_counter()
    with Progress.on_stderr(quiet=options.quiet, forced=options.progress) as progress:
        clip = make(
            pipeline,
            seconds=options.seconds,
            seed=options.seed,
            steps=options.steps,
            guidance=options.guidance,
            on_step=progress.show,
        )
    made = time.perf_counter()
    clip.save(options.output, force=options.force)
    record = {
        "file": str(options.output),
        "frames": len(clip.joints),
        "seconds": len(clip.joints) / clip.fps,
        "fps": clip.fps,
        "seed": clip.seed,
        "bundle": f"{pipeline.manifest.name} {pipeline.manifest.version}",
        "load_ms": round(1000 * (loaded - start), 1),
        "generate_ms": round(1000 * (made - loaded), 1),
        "write_ms": round(1000 * (time.perf_counter() - made), 1),
    }
    if options.json:
        print(as_json(record))
    elif not options.quiet:
        print(
            f"{record['file']}: {record['frames']} frames, {record['seconds']:g} s, seed {record['seed']}; "
            f"{record['generate_ms']:.0f} ms after {record['load_ms']:.0f} ms of loading"
        )
    return 0


def _parse(options: argparse.Namespace) -> int:
    lines = captions(options.text, options.jsonl)
    pipeline = _load(options.bundle, None)
    for place, caption in lines:
        try:
            graph = pipeline.parse(caption)
        except KinegraphError as error:
            if place:
                # The type stays: only the message grows by the place.
                raise type(error)(f"{place}: {error}") from error
            raise
        print(as_json(graph.to_dict(), pretty=not (options.json or options.jsonl)))
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


def _load(bundle: Path | None, threads: int | None) -> MotionPipeline:
    from kinegraph.pipeline import MotionPipeline

    return MotionPipeline.load(bundle, threads=threads)


if __name__ == "__main__":
    sys.exit(main())
