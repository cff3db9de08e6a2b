"""The command line: `kinegraph generate | compose | sequence | view | play | parse | info | verify | bench`.

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
from typing import TYPE_CHECKING, Any, Final

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
from kinegraph.cli_input import captions, check_only_jsonl, concepts, edited, input_graph, take_files
from kinegraph.cli_output import Progress, as_json, info_record, info_text, one_line, verify_text
from kinegraph.errors import Cancelled, InvalidInputError, KinegraphError, MissingExtraError, OutputError

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
    for name, text, arguments, run in (
        ("generate", "make a clip from a sentence or a graph", add_generate, _generate),
        ("compose", "make a clip of several motions at once, or without some", add_compose, _compose),
        ("sequence", "make a clip of several sentences, one after another", add_sequence, _sequence),
        ("view", "show saved clips in the browser", add_view, _view),
        ("play", "make clips in the browser, on this machine", add_play, _play),
        ("parse", "print or draw the semantic graph of a sentence", add_parse, _parse),
        ("info", "what a bundle is: what it can do, licences, provenance, sizes, quality", add_bundle, _info),
        ("verify", "check every file, operator and session of a bundle", add_bundle, _verify),
        ("bench", "how fast a bundle is on this machine, stage by stage", add_bench, _bench),
    ):
        verb = verbs.add_parser(name, help=text)
        arguments(verb)
        verb.set_defaults(run=run)
    return parser


def _generate(options: argparse.Namespace) -> int:
    targets = _targets(options)
    wish = input_graph(options.text, options.graph)

    def make(pipeline: MotionPipeline, **wishes: Any) -> list[Clip]:
        graph = pipeline.parse(wish) if isinstance(wish, str) else wish
        graph = edited(graph, options.edits)
        if all(node.weight == 1 for node in graph.nodes):
            return pipeline.takes(graph, len(targets), **wishes)
        return _one_by_one(pipeline.generate, graph, len(targets), wishes)

    return _make(options, targets, make)


def _compose(options: argparse.Namespace) -> int:
    targets = _targets(options)
    if options.energy is not None:
        _check_energy(options.energy, targets, options.force)
    found = concepts(options.wanted, options.unwanted)
    own = {"method": options.method, "text": options.text, "lambdas": options.lambdas, "agd": options.agd}

    def make(pipeline: MotionPipeline, **wishes: Any) -> list[Clip]:
        clips = _one_by_one(pipeline.compose, found, len(targets), own | wishes)
        if options.energy is not None:
            from kinegraph.energy import energy_maps

            del wishes["foot_fix"]  # latents know no feet
            maps = energy_maps(pipeline, found, **own | wishes | {"seed": clips[0].seed})
            maps.save(options.energy, force=options.force)
        return clips

    return _make(options, targets, make)


def _check_energy(path: Path, targets: Sequence[Path], force: bool) -> None:
    """The picture beside the clip must be another file, and one that can be written."""
    from kinegraph.formats.atomic import check_target

    check_target(path, force, (".png",))
    if path.resolve() in [target.resolve() for target in targets]:
        raise OutputError(f"--energy and -o name the same file {str(path)!r}; choose two")


def _sequence(options: argparse.Namespace) -> int:
    targets = _targets(options)
    return _make(
        options,
        targets,
        lambda pipeline, **wishes: _one_by_one(pipeline.sequence, options.texts, len(targets), wishes),
    )


def _one_by_one(make: Callable[..., Clip], wish: object, count: int, wishes: dict[str, Any]) -> list[Clip]:
    """Takes that cannot share a run; their seeds follow one another all the same."""
    from kinegraph.diffusion.sampler import part_of

    def take(number: int, seed: int | None) -> Clip:
        return make(wish, **wishes | {"seed": seed, "on_step": part_of(wishes["on_step"], number, count)})

    first = take(0, wishes["seed"])
    return [first, *(take(number, first.seed + number) for number in range(1, count))]


def _targets(options: argparse.Namespace) -> list[Path]:
    """Files to write. The cheapest check first, and nothing is computed for a file that cannot be written."""
    from kinegraph.formats import check_names
    from kinegraph.motion.clip import check_target
    from kinegraph.motion.retiming import check_fps

    targets = take_files(options.output, options.takes)
    check_names(options.output.suffix.lower(), options.names)
    for target in targets:
        check_target(target, options.force)
    if options.fps is not None:
        check_fps(options.fps)
    return targets


def _make(options: argparse.Namespace, targets: Sequence[Path], make: Callable[..., list[Clip]]) -> int:
    """Load, make, write, report."""
    start = time.perf_counter()
    pipeline = _load(options.bundle, options.threads, getattr(options, "graph", None) is None)
    loaded = time.perf_counter()
    with Progress.on_stderr(quiet=options.quiet, forced=options.progress) as progress:
        clips = make(
            pipeline,
            seconds=options.seconds,
            seed=options.seed,
            steps=options.steps,
            guidance=options.guidance,
            foot_fix=options.foot_fix,
            on_step=progress.show,
        )
    clips = [_finished(clip, options) for clip in clips]
    made = time.perf_counter()
    for target, clip in zip(targets, clips, strict=True):
        writing = time.perf_counter()
        clip.save(target, force=options.force, names=options.names)
        record = {
            "file": str(target),
            "frames": len(clip.joints),
            "seconds": len(clip.joints) / clip.fps,
            "fps": clip.fps,
            "seed": clip.seed,
            "bundle": f"{pipeline.manifest.name} {pipeline.manifest.version}",
            "load_ms": round(1000 * (loaded - start), 1),
            "generate_ms": round(1000 * (made - loaded), 1),
            "write_ms": round(1000 * (time.perf_counter() - writing), 1),
        }
        _report(record, options)
    return 0


def _report(record: dict[str, Any], options: argparse.Namespace) -> None:
    if options.json:
        print(as_json(record))
    elif not options.quiet:
        print(
            f"{record['file']}: {record['frames']} frames, {record['seconds']:g} s, seed {record['seed']}; "
            f"{record['generate_ms']:.0f} ms after {record['load_ms']:.0f} ms of loading"
        )


def _finished(clip: Clip, options: argparse.Namespace) -> Clip:
    """As the file wants it: loop and travel first, the frame rate last."""
    clip = clip.looped() if options.loop else clip
    clip = clip.in_place() if options.in_place else clip
    return clip if options.fps is None else clip.resampled(options.fps)


def _view(options: argparse.Namespace) -> int:
    import tempfile
    import webbrowser

    from kinegraph.formats.atomic import check_target, write_atomically
    from kinegraph.formats.html import page
    from kinegraph.formats.npz import read_npz

    if options.output is not None:
        check_target(options.output, options.force, (".html",))
    data = page([read_npz(path) for path in options.clips])
    target = options.output or Path(tempfile.mkdtemp(prefix="kinegraph-")) / "clips.html"
    write_atomically(target, data)
    print(target)
    if options.browser:
        webbrowser.open(target.resolve().as_uri())
    return 0


def _play(options: argparse.Namespace) -> int:
    try:
        from kinegraph.play.server import listen, open_browser, serve
    except ModuleNotFoundError as error:
        raise MissingExtraError(f'kinegraph play needs {error.name}: pip install "kinegraph[text,play]"') from error

    def started(url: str) -> None:
        print(f"{url} (Ctrl+C ends it)", flush=True)
        if options.browser:
            open_browser(url)

    with listen(options.port) as listener:
        pipeline = _load(options.bundle, options.threads, True)
        try:
            serve(pipeline, listener, started)
        except KeyboardInterrupt:
            return 0  # how it is meant to end
    return 0


def _parse(options: argparse.Namespace) -> int:
    if options.jsonl is None:
        return _parse_one(options)
    check_only_jsonl(options)
    lines = captions(options.jsonl)
    pipeline = _load(options.bundle, None, True)
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
    graph = edited(_load(options.bundle, None, True).parse(wish) if isinstance(wish, str) else wish, options.edits)
    if options.svg is None:
        print(as_json(graph.to_dict(), pretty=not options.json))
    else:
        from kinegraph.formats.graph_svg import graph_svg

        write_atomically(options.svg, graph_svg(graph).encode())
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


def _load(bundle: Path | None, threads: int | None, parses: bool) -> MotionPipeline:
    from kinegraph.pipeline import MotionPipeline
    from kinegraph.text.analysis import import_in_background

    if parses:
        import_in_background()
    return MotionPipeline.load(bundle, threads=threads)


if __name__ == "__main__":
    sys.exit(main())
