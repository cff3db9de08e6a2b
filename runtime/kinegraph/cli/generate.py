"""`kinegraph generate | compose | sequence`: check the targets, make the clips, write them, report."""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from kinegraph.cli.console import Progress, as_json
from kinegraph.cli.inputs import concepts, edited, input_graph, load, take_files
from kinegraph.errors import OutputError

# Everything that loads numpy or onnxruntime is imported where it is used: `--help` must be instant.
if TYPE_CHECKING:
    from kinegraph.clip import Clip
    from kinegraph.pipeline import MotionPipeline


def generate(options: argparse.Namespace) -> int:
    """Clips of a sentence or a graph."""
    targets = _targets(options)
    wish = input_graph(options.text, options.graph)

    def make(pipeline: MotionPipeline, **wishes: Any) -> list[Clip]:
        graph = pipeline.parse(wish) if isinstance(wish, str) else wish
        graph = edited(graph, options.edits)
        if all(node.weight == 1 for node in graph.nodes):
            return pipeline.takes(graph, len(targets), **wishes)
        return _one_by_one(pipeline.generate, graph, len(targets), wishes)

    return _make(options, targets, make)


def compose(options: argparse.Namespace) -> int:
    """Clips of several concepts, and the picture of their energies."""
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
    from kinegraph.files import check_target
    from kinegraph.formats import check_installed

    check_target(path, force, (".png",))
    check_installed(".png")
    if path.resolve() in [target.resolve() for target in targets]:
        raise OutputError(f"--energy and -o name the same file {str(path)!r}; choose two")


def sequence(options: argparse.Namespace) -> int:
    """Clips of several sentences, one after another."""
    targets = _targets(options)
    return _make(
        options,
        targets,
        lambda pipeline, **wishes: _one_by_one(pipeline.sequence, options.texts, len(targets), wishes),
    )


def _one_by_one(make: Callable[..., Clip], wish: object, count: int, wishes: dict[str, Any]) -> list[Clip]:
    """Takes that cannot share a run; their seeds follow one another all the same."""
    from kinegraph.diffusion.sampling import subrange_progress

    def take(number: int, seed: int | None) -> Clip:
        return make(wish, **wishes | {"seed": seed, "on_step": subrange_progress(wishes["on_step"], number, count)})

    first = take(0, wishes["seed"])
    return [first, *(take(number, first.seed + number) for number in range(1, count))]


def _targets(options: argparse.Namespace) -> list[Path]:
    """Files to write. The cheapest check first, and nothing is computed for a file that cannot be written."""
    from kinegraph.formats import check_clip_target, check_names
    from kinegraph.motion.resampling import check_fps

    targets = take_files(options.output, options.takes)
    check_names(options.output.suffix.lower(), options.names)
    for target in targets:
        check_clip_target(target, options.force)
    if options.fps is not None:
        check_fps(options.fps)
    return targets


def _make(options: argparse.Namespace, targets: Sequence[Path], make: Callable[..., list[Clip]]) -> int:
    """Load, make, write, report."""
    start = time.perf_counter()
    pipeline = load(options.bundle, options.threads, getattr(options, "graph", None) is None)
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
    clip = clip.looped(foot_fix=options.foot_fix) if options.loop else clip
    clip = clip.in_place() if options.in_place else clip
    return clip if options.fps is None else clip.resampled(options.fps)
