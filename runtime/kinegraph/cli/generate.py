"""`kinegraph generate | compose | sequence`: check the targets, make the clips, write them, report."""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

from kinegraph.cli.character import character_fps, check_character, load_character
from kinegraph.cli.console import Progress, as_json, one_line
from kinegraph.cli.constraints import describe_misses, miss_records, parse_constraints
from kinegraph.cli.inputs import apply_edits, load_pipeline, parse_concepts, read_text_or_graph, take_paths
from kinegraph.errors import InvalidInputError, OutputError
from kinegraph.unknown import describe_unknown

# Modules that load numpy or onnxruntime are imported where they are used: `--help` must be instant.
if TYPE_CHECKING:
    from kinegraph.clip import Clip
    from kinegraph.diffusion.sampling import OnStep
    from kinegraph.options import Guidance, Steps
    from kinegraph.pipeline import MotionPipeline

    MakeClips = Callable[[MotionPipeline, OnStep], list[Clip]]
    """Makes the clips of one command; `on_step` counts the steps of all of them."""


@dataclass(frozen=True)
class SamplingOptions:
    """Sampling options that the commands share; `MotionPipeline.generate` documents and checks them."""

    seed: int | None
    steps: Steps | None
    guidance: Guidance | None
    foot_fix: bool
    strict: bool

    @classmethod
    def from_args(cls, args: argparse.Namespace) -> Self:
        """Take the options of a command."""
        return cls(seed=args.seed, steps=args.steps, guidance=args.guidance, foot_fix=args.foot_fix, strict=args.strict)

    @property
    def keywords(self) -> dict[str, Any]:
        """Return the keywords of the calls that make one clip, but for the seed, which counts up from take to take."""
        return {"steps": self.steps, "guidance": self.guidance, "foot_fix": self.foot_fix, "strict": self.strict}


def generate(args: argparse.Namespace) -> int:
    """Run `kinegraph generate`: clips of a sentence or a graph."""
    targets = check_targets(args)
    text_or_graph = read_text_or_graph(args.text, args.graph)
    seconds: float | None = args.seconds
    constraints = parse_constraints(args)
    sampling = SamplingOptions.from_args(args)

    def make_clips(pipeline: MotionPipeline, on_step: OnStep) -> list[Clip]:
        graph = pipeline.parse(text_or_graph) if isinstance(text_or_graph, str) else text_or_graph
        graph = apply_edits(graph, args.edits)
        return pipeline.takes(
            graph,
            len(targets),
            constraints=constraints,
            constraint_weight=args.constraint_weight,
            seconds=seconds,
            seed=sampling.seed,
            space=args.space,
            on_step=on_step,
            **sampling.keywords,
        )

    return run_command(args, targets, make_clips)


def compose(args: argparse.Namespace) -> int:
    """Run `kinegraph compose`: clips of several concepts, and a picture of their energies."""
    targets = check_targets(args)
    if args.energy is not None:
        if args.space != "latent":
            raise InvalidInputError("--energy draws latent space; leave out --space, or the picture")
        _check_picture_target(args.energy, targets, args.force)
    concepts = parse_concepts(args.positive, args.negated)
    # an energy is of concepts in one run
    method = "fused" if args.energy is not None and args.method == "auto" else args.method
    constraints = parse_constraints(args)
    sampling = SamplingOptions.from_args(args)

    def make_clips(pipeline: MotionPipeline, on_step: OnStep) -> list[Clip]:
        def make_clip(seed: int | None, on_step: OnStep | None) -> Clip:
            return pipeline.compose(
                concepts,
                method=method,
                text=args.text,
                lambdas=args.lambdas,
                agd=args.agd,
                constraints=constraints,
                constraint_weight=args.constraint_weight,
                seconds=args.seconds,
                seed=seed,
                space=args.space,
                on_step=on_step,
                **sampling.keywords,
            )

        clips = make_one_by_one(make_clip, len(targets), sampling.seed, on_step)
        if args.energy is not None:
            from kinegraph.energy import energy_maps
            from kinegraph.formats.energy_png import save_energy_maps

            maps = energy_maps(
                pipeline,
                concepts,
                method=method,
                text=args.text,
                lambdas=args.lambdas,
                agd=args.agd,
                seconds=args.seconds,
                seed=clips[0].seed,
                steps=sampling.steps,
                guidance=sampling.guidance,
                on_step=on_step,
            )
            save_energy_maps(maps, args.energy, force=args.force)
        return clips

    return run_command(args, targets, make_clips)


def sequence(args: argparse.Namespace) -> int:
    """Run `kinegraph sequence`: clips of several sentences, one after another."""
    targets = check_targets(args)
    sampling = SamplingOptions.from_args(args)

    def make_clips(pipeline: MotionPipeline, on_step: OnStep) -> list[Clip]:
        def make_clip(seed: int | None, on_step: OnStep | None) -> Clip:
            return pipeline.sequence(
                args.texts,
                seconds=args.seconds,
                method=args.method,
                seed=seed,
                seed_offsets=args.seed_offsets,
                on_step=on_step,
                **sampling.keywords,
            )

        return make_one_by_one(make_clip, len(targets), sampling.seed, on_step)

    return run_command(args, targets, make_clips)


def timeline(args: argparse.Namespace) -> int:
    """Run `kinegraph timeline`: read the file of intervals, and make its clips."""
    from kinegraph.intervals import read_intervals

    targets = check_targets(args)
    intervals = read_intervals(args.file)
    constraints = parse_constraints(args)
    sampling = SamplingOptions.from_args(args)

    def make_clips(pipeline: MotionPipeline, on_step: OnStep) -> list[Clip]:
        def make_clip(seed: int | None, on_step: OnStep | None) -> Clip:
            return pipeline.timeline(
                intervals,
                overlap=args.overlap,
                constraints=constraints,
                constraint_weight=args.constraint_weight,
                space=args.space,
                seed=seed,
                on_step=on_step,
                **sampling.keywords,
            )

        return make_one_by_one(make_clip, len(targets), sampling.seed, on_step)

    return run_command(args, targets, make_clips)


def make_one_by_one(
    make_clip: Callable[[int | None, OnStep | None], Clip], count: int, seed: int | None, on_step: OnStep
) -> list[Clip]:
    """Make clips of consecutive seeds; without a seed the first clip draws one."""
    from kinegraph.diffusion.sampling import subrange_progress

    first = make_clip(seed, subrange_progress(on_step, 0, count))
    others = (make_clip(first.seed + index, subrange_progress(on_step, index, count)) for index in range(1, count))
    return [first, *others]


def check_targets(args: argparse.Namespace) -> list[Path]:
    """List the files to write, and refuse those that cannot be written before anything is computed for them."""
    from kinegraph.formats import check_clip_target, check_names, check_root
    from kinegraph.validation import check_fps

    # The cheapest checks come first.
    targets = take_paths(args.output, args.takes)
    check_names(args.output.suffix.lower(), args.names)
    check_root(args.output.suffix.lower(), args.root)
    check_character(args)
    for target in targets:
        check_clip_target(target, args.force)
    if args.fps is not None:
        check_fps(args.fps)
    return targets


def _check_picture_target(path: Path, targets: Sequence[Path], force: bool) -> None:
    """Refuse a picture that cannot be written, or that is the same file as a clip."""
    from kinegraph.formats.energy_png import check_energy_target

    check_energy_target(path, force)
    if path.resolve() in [target.resolve() for target in targets]:
        raise OutputError(f"--energy and -o name the same file {str(path)!r}; choose two")


def run_command(args: argparse.Namespace, targets: Sequence[Path], make_clips: MakeClips) -> int:
    """Load the bundle, make the clips, write and report them."""
    start = time.perf_counter()
    character = None if args.character is None else load_character(args.character, args.map)
    # Only `generate` has --graph; with it no sentence is parsed.
    pipeline = load_pipeline(args.bundle, args.threads, parses=getattr(args, "graph", None) is None)
    loaded = time.perf_counter()
    with Progress.on_stderr(quiet=args.quiet, forced=args.progress) as progress:
        clips = make_clips(pipeline, progress.show)
    clips = [_post_process(clip, args) for clip in clips]
    generated = time.perf_counter()
    if not args.quiet:
        _tell_unknown(clips, targets)
    for target, clip in zip(targets, clips, strict=True):
        write_start = time.perf_counter()
        if character is None:
            clip.save(target, force=args.force, names=args.names, root=args.root)
            frames, fps = clip.frames, clip.fps
        else:
            shown = clip.onto(character, fps=character_fps(args.fps), root=args.root)
            shown.save(target, force=args.force)
            frames, fps = shown.frames, shown.fps
        record = {
            "file": str(target),
            "frames": frames,
            "seconds": frames / fps,
            "fps": fps,
            "seed": clip.seed,
            "bundle": f"{pipeline.manifest.name} {pipeline.manifest.version}",
            "unknown": [words.to_dict() for words in clip.unknown],
            "notes": list(clip.notes),
            "misses": miss_records(clip.misses),
            "load_ms": round(1000 * (loaded - start), 1),
            "generate_ms": round(1000 * (generated - loaded), 1),
            "write_ms": round(1000 * (time.perf_counter() - write_start), 1),
        }
        _report(record, args)
        if not args.json and not args.quiet:
            for line in describe_misses(clip.misses):
                print(f"  {one_line(line)}")
    return 0


def _post_process(clip: Clip, args: argparse.Namespace) -> Clip:
    """Apply --loop, --in-place and --fps: loop and travel first, the frame rate last."""
    clip = clip.looped(foot_fix=args.foot_fix) if args.loop else clip
    clip = clip.in_place() if args.in_place else clip
    # a character's motion is resampled when it is put on
    return clip if args.fps is None or args.character is not None else clip.resampled(args.fps)


def _tell_unknown(clips: Sequence[Clip], targets: Sequence[Path]) -> None:
    """Print on stderr what of the text the bundle was never shown, and what it could not honour.

    Takes of one text share what is unknown, and most notes; what is told of one take alone has its file before it.
    """
    if clips[0].unknown:
        print(f"kinegraph: not known: {one_line(describe_unknown(clips[0].unknown))}", file=sys.stderr)
    shared = [note for note in clips[0].notes if all(note in clip.notes for clip in clips)]
    of_one = [
        f"{target}: {note}"
        for target, clip in zip(targets, clips, strict=True)
        for note in clip.notes
        if note not in shared
    ]
    for note in (*shared, *of_one):
        print(f"kinegraph: {one_line(note)}", file=sys.stderr)


def _report(record: dict[str, Any], args: argparse.Namespace) -> None:
    if args.json:
        print(as_json(record))
    elif not args.quiet:
        print(
            f"{record['file']}: {record['frames']} frames, {record['seconds']:g} s, seed {record['seed']}; "
            f"{record['generate_ms']:.0f} ms after {record['load_ms']:.0f} ms of loading"
        )
