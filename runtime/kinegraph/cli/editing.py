"""`kinegraph edit | inbetween`: keep a part of a clip and change the rest, or go from one clip to another."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from typing import TYPE_CHECKING

from kinegraph.cli.constraints import parse_constraints, parse_interval
from kinegraph.cli.generate import SamplingOptions, check_targets, make_one_by_one, run_command
from kinegraph.errors import InvalidInputError

if TYPE_CHECKING:
    from kinegraph.clip import Clip
    from kinegraph.diffusion.sampling import OnStep
    from kinegraph.pipeline import MotionPipeline


def edit(args: argparse.Namespace) -> int:
    """Run `kinegraph edit`: keep parts of a saved clip, and make the rest anew."""
    from kinegraph.formats import read

    targets = check_targets(args)
    clip, keep = read(args.clip), parse_keep(args.keep)
    constraints = parse_constraints(args)
    sampling = SamplingOptions.from_args(args)

    def make_clips(pipeline: MotionPipeline, on_step: OnStep) -> list[Clip]:
        def make_clip(seed: int | None, on_step: OnStep | None) -> Clip:
            return pipeline.edit(
                clip,
                args.text,
                keep=keep,
                strength=args.strength,
                space=args.space,
                constraints=constraints,
                constraint_weight=args.constraint_weight,
                seed=seed,
                on_step=on_step,
                **sampling.keywords,
            )

        return make_one_by_one(make_clip, len(targets), sampling.seed, on_step)

    return run_command(args, targets, make_clips)


def inbetween(args: argparse.Namespace) -> int:
    """Run `kinegraph inbetween`: the motion from the end of one saved clip to the beginning of another."""
    from kinegraph.formats import read

    targets = check_targets(args)
    first, last = read(args.first), read(args.last)
    constraints = parse_constraints(args)
    sampling = SamplingOptions.from_args(args)

    def make_clips(pipeline: MotionPipeline, on_step: OnStep) -> list[Clip]:
        def make_clip(seed: int | None, on_step: OnStep | None) -> Clip:
            return pipeline.inbetween(
                first,
                last,
                args.seconds,
                args.text,
                space=args.space,
                constraints=constraints,
                constraint_weight=args.constraint_weight,
                seed=seed,
                on_step=on_step,
                **sampling.keywords,
            )

        return make_one_by_one(make_clip, len(targets), sampling.seed, on_step)

    return run_command(args, targets, make_clips)


def parse_keep(texts: Sequence[str]) -> list[str | tuple[float, float]]:
    """Read `--keep`: names of parts of the body, and spans like 0-1s.

    Raises:
        InvalidInputError: a moment instead of a span.
    """
    kept: list[str | tuple[float, float]] = []
    for text in texts:
        if not text[:1].isdigit():
            kept.append(text.strip().lower())
            continue
        span = parse_interval(text)
        if not isinstance(span, tuple):
            raise InvalidInputError(f"--keep {text[:40]!r}: write a span like 0-1s, or a part of the body like legs")
        kept.append(span)
    return kept
