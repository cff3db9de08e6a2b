"""Options of one call, validated before any model runs.

What a bundle is lives in `kinegraph.bundle.manifest`; what a call wants lives here. Calls of several sentences, a
sequence or a batch, have lengths, seeds and captions of their parts.
"""

from __future__ import annotations

import math
import re
import secrets
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Any, Final, TypeVar

from kinegraph.bundle.contract import FRAMES, LEVELS
from kinegraph.bundle.manifest import Manifest, ScheduleSpec
from kinegraph.diffusion.sampling import OnStep, StepInfo, is_stop
from kinegraph.errors import InvalidInputError, TimedOut
from kinegraph.limits import MAX_PARTS, MAX_TAKES
from kinegraph.text.turns import Turn
from kinegraph.validation import check_flag, finite_number, short_repr, whole_number

LATENT: Final = "latent"
SPACES: Final = (LATENT, FRAMES)
"""Where a clip is sampled: in the latent space of the autoencoders, or in skeleton space (`bundle.frames_part`)."""
MAX_GUIDANCE: Final = 20.0
SEQUENCE_METHODS: Final = ("blend", "continue", "energy")
"""How the parts of a sequence follow one another; see `MotionPipeline.sequence`."""
MAX_SEED: Final = 2**63
MAX_SEED_OFFSET: Final = 1_000_000
"""Of a sentence against the whole; parts of one sentence are further apart."""
_PART_SEED_STRIDE: Final = 1_000_003
"""Distance of the seeds of a sentence's parts, so that they are none of its next takes."""

Steps = int | Sequence[int] | Mapping[str, int]
"""One number for all levels, three in the order of `contract.LEVELS`, or some of them by name."""
Guidance = float | Sequence[float] | Mapping[str, float]

N = TypeVar("N", int, float)
T = TypeVar("T")


@dataclass(frozen=True)
class GenerateOptions:
    """Options of a call with the bundle's defaults filled in; made by `resolve_options`."""

    frames: int
    """Length of the clip."""
    seconds: float
    """`frames / fps`: what the caller asked for, to the nearest frame."""
    seed: int
    """Of the noise, 0 to 2**63 - 1."""
    steps: Mapping[str, int]
    """Diffusion steps of each level."""
    guidance: Mapping[str, float]
    """Guidance scale of each level; 0 is the unconditional model, 1 is no guidance."""
    foot_fix: bool = True
    """Whether standing feet are locked where they stand."""
    turn: Turn | None = None
    """How far the sentence turns the body."""
    shown: tuple[int, int] | None = None
    """First frame and the one behind the last of those that are not cut off again, by the joins of a sequence; None is
    all."""


def resolve_options(
    manifest: Manifest,
    *,
    seconds: float | None = None,
    seed: int | None = None,
    steps: Steps | None = None,
    guidance: Guidance | None = None,
    foot_fix: bool = True,
    space: str = LATENT,
) -> GenerateOptions:
    """Validate the options of a call and fill in the bundle's defaults.

    Args:
        manifest: of the bundle that will run.
        seconds: length of the clip.
        seed: 0 to 2**63 - 1; None draws one from the operating system, to be found in the result.
        steps: diffusion steps, see `Steps`.
        guidance: guidance scale, 0 to 20, see `Guidance`.
        foot_fix: whether standing feet are locked where they stand.
        space: of `SPACES`.

    Raises:
        InvalidInputError: naming the option, its value and what is allowed.
    """
    default_steps, default_guidance = _space_defaults(manifest, space)
    frames = frame_count(manifest, manifest.defaults.seconds if seconds is None else seconds)

    def validate_steps(value: object, name: str) -> int:
        return _validate_steps(value, name, manifest.schedule)

    return GenerateOptions(
        frames=frames,
        seconds=frames / manifest.fps,
        seed=validate_seed(seed),
        steps=_per_level(steps, "steps", default_steps, validate_steps),
        guidance=_per_level(guidance, "guidance", default_guidance, _validate_guidance),
        foot_fix=check_flag(foot_fix, "foot_fix"),
    )


def _space_defaults(manifest: Manifest, space: object) -> tuple[Mapping[str, int], Mapping[str, float]]:
    """Return the bundle's default steps and guidance in a space.

    Raises:
        InvalidInputError: no such space, or a bundle without skeleton space.
    """
    if not isinstance(space, str) or space not in SPACES:
        raise InvalidInputError(f"space must be one of {', '.join(SPACES)}, not {short_repr(space)}")
    if space == LATENT:
        return manifest.defaults.steps, manifest.defaults.guidance
    part = manifest.frames_part
    if part is None:
        raise InvalidInputError(
            f"bundle {manifest.name} {manifest.version} has no skeleton space; leave out space, or add it: "
            "python -m kinegraph_export.add_frames"
        )
    return {FRAMES: part.steps}, {FRAMES: part.guidance}


def frame_count(manifest: Manifest, seconds: float) -> int:
    """Convert seconds to frames, to the nearest.

    Raises:
        InvalidInputError: not a finite number, or outside what the model was trained on.
    """
    shortest, longest = manifest.seconds_limits
    allowed = f"must be {shortest:g} to {longest:g} seconds with this bundle"
    length = _validate_finite(seconds, "seconds", allowed)
    frames = length * manifest.fps
    # Compared before rounding to an int, which a huge product would turn into a number of 300 digits.
    if not manifest.frames.min - 0.5 <= frames <= manifest.frames.max + 0.5:
        raise InvalidInputError(f"seconds {allowed}, not {length:g}")
    return min(max(round(frames), manifest.frames.min), manifest.frames.max)


def validate_seed(seed: object) -> int:
    """Return the seed itself, or draw one for None.

    Raises:
        InvalidInputError: not a whole number from 0 to 2**63 - 1.
    """
    if seed is None:
        # 32 bits are plenty of takes, and short enough to type again.
        return secrets.randbelow(2**32)
    number = whole_number(seed)
    if number is None or not 0 <= number < MAX_SEED:
        raise InvalidInputError(f"seed must be a whole number from 0 to 2**63 - 1, not {short_repr(seed)}")
    return number


def _validate_steps(value: object, name: str, schedule: ScheduleSpec) -> int:
    most = schedule.train_steps
    steps = whole_number(value)
    if steps is None or not 1 <= steps <= most:
        raise InvalidInputError(f"{name} must be a whole number from 1 to {most}, not {short_repr(value)}")
    try:
        schedule.noise.timesteps(steps)
    except InvalidInputError as error:
        raise InvalidInputError(f"{name}: {error}") from error
    return steps


def _validate_guidance(value: object, name: str) -> float:
    allowed = f"must be 0 to {MAX_GUIDANCE:g}"
    scale = _validate_finite(value, name, allowed)
    if not 0 <= scale <= MAX_GUIDANCE:
        raise InvalidInputError(f"{name} {allowed}, not {scale:g}")
    return scale


def _per_level(
    value: object, name: str, defaults: Mapping[str, N], check: Callable[[object, str], N]
) -> Mapping[str, N]:
    if value is None:
        return defaults
    levels = [level for level in (*LEVELS, FRAMES) if level in defaults]  # the released MLD has the last of three alone
    if isinstance(value, Mapping):
        for level in value:
            if level not in levels:
                raise InvalidInputError(f"{name}: unknown level {short_repr(level)}; the levels are {levels}")
        by_level: dict[str, object] = dict(value)
    elif isinstance(value, list | tuple):
        if len(value) != len(levels):
            raise InvalidInputError(f"{name} must be one number or {len(levels)}, not {len(value)}")
        by_level = dict(zip(levels, value, strict=True))
    else:
        by_level = dict.fromkeys(levels, value)
    return MappingProxyType(
        {
            level: check(by_level[level], f"{name} of level {level}") if level in by_level else defaults[level]
            for level in levels
        }
    )


def _validate_finite(value: object, name: str, allowed: str) -> float:
    number = finite_number(value)
    if number is None:
        raise InvalidInputError(f"{name} {allowed}, not {short_repr(value)}")
    return number


def batch_seeds(first: int, texts: int, takes: object, most: int = MAX_TAKES) -> list[int]:
    """List the seeds of a batch, one after another.

    Args:
        first: seed of the first clip.
        texts: number of sentences.
        takes: of each sentence.
        most: clips allowed.

    Raises:
        InvalidInputError: takes that are not a whole number, more than `most` clips, or seeds past the largest.
    """
    number = whole_number(takes)
    if number is None or not 1 <= number <= most:
        raise InvalidInputError(f"takes must be a whole number from 1 to {most}, not {short_repr(takes)}")
    if texts * number > most:
        raise InvalidInputError(f"{texts} sentences of {number} takes; {most} clips at most in one call")
    return [validate_seed(first + index) for index in range(texts * number)]


def sentence_seeds(first: int, texts: int, offsets: object) -> list[int]:
    """List the seeds of the sentences of a sequence or timeline.

    Args:
        first: seed of the whole.
        texts: number of sentences.
        offsets: what each adds to it; None counts up from 0.

    Raises:
        InvalidInputError: not a whole number for each sentence, up to `MAX_SEED_OFFSET`, or seeds past the largest.
    """
    if offsets is None:
        return batch_seeds(first, texts, takes=1, most=MAX_PARTS)
    numbers = [whole_number(offset) for offset in offsets] if isinstance(offsets, list | tuple) else []
    allowed = [number for number in numbers if number is not None and 0 <= number <= MAX_SEED_OFFSET]
    if len(allowed) != texts or len(numbers) != texts:
        raise InvalidInputError(
            f"seed_offsets are {texts} whole numbers from 0 to {MAX_SEED_OFFSET}, one for each sentence, not "
            f"{short_repr(offsets)}"
        )
    return [validate_seed(first + number) for number in allowed]


def part_seed(seed: int, index: int) -> int:
    """Derive the seed of a part of one sentence; the first part has the sentence's own."""
    return (seed + index * _PART_SEED_STRIDE) % MAX_SEED


def with_seconds(options: GenerateOptions, manifest: Manifest, seconds: float) -> GenerateOptions:
    """Replace the length of a clip.

    Raises:
        InvalidInputError: see `frame_count`.
    """
    frames = frame_count(manifest, seconds)
    return replace(options, frames=frames, seconds=frames / manifest.fps)


def with_margins(options: GenerateOptions, manifest: Manifest, before: int, after: int) -> tuple[int, GenerateOptions]:
    """Lengthen a part of a sequence by what the blends at its ends need, as far as the model reaches.

    Args:
        options: of the part, with its own length.
        manifest: of the bundle.
        before, after: frames wanted before and after the part (`motion.blending.blend_margins`).

    Returns:
        Frames that come before the part, and the options with the longer length.
    """
    spare = manifest.frames.max - options.frames
    if before + after > spare:
        before = spare * before // (before + after)
        after = spare - before if after else 0
    frames = options.frames + before + after
    return before, replace(options, frames=frames, seconds=frames / manifest.fps)


def validate_sequence_method(method: object) -> str:
    """Return how the parts of a sequence follow one another, one of `SEQUENCE_METHODS`.

    Raises:
        InvalidInputError: another one.
    """
    if not isinstance(method, str) or method not in SEQUENCE_METHODS:
        raise InvalidInputError(f"method must be one of {', '.join(SEQUENCE_METHODS)}, not {short_repr(method)}")
    return method


def sequence_caption(captions: Sequence[str]) -> str:
    """Join captions to one of a sequence: "a person walks", "then bows" -> "a person walks, then bows"."""
    first, *others = captions
    return ", then ".join([first, *(re.sub(r"^\s*((and|then)\s+)+", "", other) for other in others)])


def validate_lengths(texts: object, seconds: object, most: int, what: str) -> list[Any]:
    """Return the length of every sentence of several; None where the sentence decides.

    Args:
        texts: of a sequence or a batch.
        seconds: one length, one per sentence, or None.
        most: sentences allowed.
        what: "a sequence" or "a batch", for messages.

    Raises:
        InvalidInputError: not a list of 1 to `most` sentences, or another number of lengths.
    """
    if isinstance(texts, str) or not isinstance(texts, Sequence):
        raise InvalidInputError(f"{what} takes a list of sentences")
    if not 1 <= len(texts) <= most:
        raise InvalidInputError(f"{what} has 1 to {most} sentences, not {len(texts)}")
    if not isinstance(seconds, list | tuple):
        return [seconds] * len(texts)
    if len(seconds) != len(texts):
        raise InvalidInputError(f"seconds has {len(seconds)} lengths for {len(texts)} sentences")
    return list(seconds)


@dataclass(frozen=True)
class Deadline:
    """Moment at which a call gives up; checked between sentences and after every diffusion step."""

    timeout: float | None
    """Seconds that the caller allows; None is no limit."""
    end: float
    """Of `time.monotonic`."""

    @staticmethod
    def start(timeout: object) -> Deadline:
        """Start the clock.

        Raises:
            InvalidInputError: `timeout` is neither None nor a number above 0.
        """
        if timeout is None:
            return Deadline(None, math.inf)
        seconds = finite_number(timeout)
        if seconds is None or seconds <= 0:
            raise InvalidInputError(f"timeout must be a number of seconds above 0, or None, not {short_repr(timeout)}")
        return Deadline(seconds, time.monotonic() + seconds)

    def check(self) -> None:
        """Give up if the time is over.

        Raises:
            TimedOut: it is.
        """
        if self.timeout is not None and time.monotonic() >= self.end:
            raise TimedOut(f"stopped after the timeout of {self.timeout:g} s; allow more, or ask for less at once")

    def each(self, items: Iterable[T]) -> Iterator[T]:
        """Check before each of several items."""
        for item in items:
            self.check()
            yield item

    def watch(self, on_step: OnStep | None) -> OnStep | None:
        """Check after every step, and ask the caller's `on_step` first; without a timeout it stays what it is."""
        if self.timeout is None:
            return on_step

        def after_step(info: StepInfo) -> bool | None:
            answer = None if on_step is None else on_step(info)
            if not is_stop(answer):
                self.check()
            return answer

        return after_step


def parse_numbers(text: str, kind: type[N]) -> N | tuple[N, ...]:
    """Parse an option written as text: "15" or, for several numbers, "15,15,20".

    Args:
        text: of a command line or a form.
        kind: int or float.

    Returns:
        One number, or all of them in order; their count and range are checked where the option is used.

    Raises:
        InvalidInputError: a part of it is not a number of that kind.
    """
    try:
        numbers = tuple(kind(part) for part in text.split(","))
    except ValueError:
        raise InvalidInputError(f"{text[:40]!r} is not a number, nor several like 15,15,20") from None
    return numbers[0] if len(numbers) == 1 else numbers
