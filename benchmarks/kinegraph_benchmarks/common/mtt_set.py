"""Timelines of three texts in the way of MTT, drawn from held-out clips or read from MTT's own files.

MTT is the benchmark of STMC (Petrovich et al., "Multi-Track Timeline Control for Text-Driven 3D Human Motion
Generation", 2024), on which EnergyMoGen measures composition (Tables 3, 6, 7, 9). 60 texts, each for some parts of the
body and with one captured motion, make 500 timelines:

    |------- first -------|------ second ------|
         |--- beside ---|                               within one of them or across both, with other parts of the body

Lengths are normal, 6 s on average; texts of more parts, and legs above all, are drawn more often for the first two.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import permutations
from pathlib import Path
from typing import Final

import numpy as np

from kinegraph.arrays import FloatArray
from kinegraph.errors import InvalidInputError
from kinegraph.intervals import ALIASES, Interval, parse_intervals
from kinegraph.motion.skeleton import JOINTS, canonicalise
from kinegraph_benchmarks.common.predicates import FPS
from kinegraph_training.data.clips import MotionClip
from kinegraph_training.synthetic.caption_grammar import PHRASES
from kinegraph_training.synthetic.compositions import NORMAL

TEXTS: Final = 60
TIMELINES: Final = 500
BODY: Final = ("left arm", "right arm", "legs", "head", "torso")
"""MTT's parts of the body, as `keeping.PARTS` names them."""
PART_WEIGHTS: Final = {"legs": 3, "left arm": 1, "right arm": 1, "head": 1, "torso": 1}
MEAN, DEVIATION = 6.0, 1.2
"""Seconds of an interval."""
SHORTEST, LONGEST = 1.0, 9.2
PLACES: Final = (("first", 2), ("second", 2), ("longer", 2), ("both", 1))
"""What the third text is beside, and how often."""
DRAWS_PER_TIMELINE: Final = 200
"""Draws after which no timeline is found any more: texts that leave no part of the body to others."""


@dataclass(frozen=True)
class MttText:
    """A text, the parts of the body that it is for, and how it was captured."""

    text: str
    parts: tuple[str, ...]
    """Of `BODY`."""
    motion: FloatArray | None = None
    """(frames, 22, 3) metres at 20 frames per second; None where it was not given."""

    @property
    def weight(self) -> int:
        """How often it is drawn as the first or second text."""
        return sum(PART_WEIGHTS[part] for part in self.parts)


@dataclass(frozen=True)
class MttTimeline:
    """Two texts one after the other, and one beside them."""

    first: Interval
    second: Interval
    beside: Interval

    @property
    def intervals(self) -> tuple[Interval, Interval, Interval]:
        """All three."""
        return self.first, self.second, self.beside

    @property
    def seconds(self) -> float:
        """Length."""
        return max(interval.end for interval in self.intervals)

    @property
    def texts(self) -> tuple[str, str, str]:
        """The three captions."""
        first, second, beside = (interval.caption for interval in self.intervals)
        return first, second, beside


@dataclass(frozen=True)
class MttSet:
    """Texts, and timelines of them."""

    texts: tuple[MttText, ...]
    timelines: tuple[MttTimeline, ...]

    @property
    def rows(self) -> dict[str, int]:
        """Text -> its row."""
        return {text.text: row for row, text in enumerate(self.texts)}


def texts_of_clips(clips: Sequence[MotionClip], count: int = TEXTS) -> list[MttText]:
    """Take the first caption of one clip for each action and style, clips without a style first.

    Args:
        clips: captured, of splits that no model was trained on; those whose action the table of actions does not know
            are left out.
        count: texts at most.
    """
    chosen: dict[tuple[str, str], MotionClip] = {}
    for clip in clips:
        if clip.action in PHRASES:
            chosen.setdefault((clip.style or NORMAL, clip.action), clip)
    plain_first = sorted(chosen, key=lambda pair: pair[0] != NORMAL)
    texts = {}
    for pair in plain_first:
        clip = chosen[pair]
        caption = clip.captions[0].strip().rstrip(".")
        texts.setdefault(caption, MttText(caption, parts_of(clip.action), clip.joints))
    return list(texts.values())[:count]


def parts_of(action: str) -> tuple[str, ...]:
    """Tell which parts of the body an action of the table moves."""
    entry = PHRASES[action]
    arms = tuple(f"{side} arm" for side in ((entry.side,) if entry.side else ("left", "right")))
    by_parts = {"legs": ("legs",), "arm": arms, "arms": ("left arm", "right arm"), "body": BODY}
    return by_parts[entry.parts]


def draw_timelines(texts: Sequence[MttText], count: int = TIMELINES, seed: int = 0) -> tuple[MttTimeline, ...]:
    """Draw timelines as MTT does.

    Args:
        texts: at least three.
        count: of timelines.
        seed: of all draws.

    Raises:
        InvalidInputError: too few texts, or none that leaves parts of the body to others.
    """
    if len(texts) < 3:
        raise InvalidInputError(f"timelines have three texts; there are {len(texts)}")
    rng = np.random.Generator(np.random.PCG64(seed))
    found: list[MttTimeline] = []
    for _ in range(DRAWS_PER_TIMELINE * count):
        if len(found) == count:
            return tuple(found)
        timeline = _draw_timeline(texts, rng)
        found += [] if timeline is None else [timeline]
    if len(found) == count:
        return tuple(found)
    raise InvalidInputError(f"{len(texts)} texts made {len(found)} of {count} timelines; take texts of other parts")


def _draw_timeline(texts: Sequence[MttText], rng: np.random.Generator) -> MttTimeline | None:
    """Draw one timeline; None where no text fits beside the first two."""
    weights = np.array([text.weight for text in texts], dtype=np.float64)
    first, second = (int(row) for row in rng.choice(len(texts), size=2, p=weights / weights.sum()))
    lengths = [_draw_length(rng) for _ in range(2)]
    shares = np.array([share for _, share in PLACES], dtype=np.float64)
    place = PLACES[int(rng.choice(len(PLACES), p=shares / shares.sum()))][0]
    if place == "longer":
        place = "first" if lengths[0] > lengths[1] else "second"
    room, begin, taken = {
        "first": (lengths[0], 0.0, set(texts[first].parts)),
        "second": (lengths[1], lengths[0], set(texts[second].parts)),
        "both": (min(sum(lengths), LONGEST), 0.0, {*texts[first].parts, *texts[second].parts}),
    }[place]
    length = _draw_length(rng)
    fitting = [row for row, text in enumerate(texts) if row not in (first, second) and not taken & {*text.parts}]
    if not fitting or length > room:
        return None
    beside = texts[fitting[int(rng.integers(len(fitting)))]]
    start = begin + float(rng.uniform(0, room - length))
    whole = lengths[0] + lengths[1]
    return MttTimeline(
        _interval(texts[first], 0.0, lengths[0]),
        _interval(texts[second], lengths[0], whole),
        _interval(beside, start, min(start + length, whole)),
    )


def _draw_length(rng: np.random.Generator) -> float:
    return float(np.clip(round(rng.normal(MEAN, DEVIATION), 2), SHORTEST, LONGEST))


def _interval(text: MttText, start: float, end: float) -> Interval:
    return Interval(text.text, round(start, 2), round(end, 2), text.parts)


# MTT's own files


def read_mtt(folder: Path, motions: Path | None = None) -> MttSet:
    """Read MTT from the folder `mtt` of STMC's repository.

    Args:
        folder: with texts.txt (text # parts), MTT.txt (timelines, a blank line between two) and, for the captured
            motions, motions.txt (path # begin # end).
        motions: folder of the joints of AMASS as STMC extracts them: .npy files (frames, 22 or more, 3) at 20 frames
            per second, +Z up; None leaves the motions out.

    Raises:
        InvalidInputError: a file cannot be read, or is no such file.
    """
    captured = _read_motions(folder / "motions.txt", motions) if motions is not None else None
    texts = []
    for row, (text, *parts) in enumerate(_fields(folder / "texts.txt")):
        motion = None if captured is None or row >= len(captured) else captured[row]
        texts.append(MttText(text, tuple(ALIASES.get(part, part) for part in parts), motion))
    unknown = {part for text in texts for part in text.parts} - set(BODY)
    if unknown:
        raise InvalidInputError(f"{folder / 'texts.txt'}: {sorted(unknown)[0]!r} is no part of {', '.join(BODY)}")
    blocks = [block for block in _read(folder / "MTT.txt").split("\n\n") if block.strip()]
    names = [f"timeline {number} of {folder / 'MTT.txt'}" for number in range(1, len(blocks) + 1)]
    timelines = tuple(in_order(parse_intervals(block, name), name) for block, name in zip(blocks, names, strict=True))
    known = {text.text for text in texts}
    for timeline, name in zip(timelines, names, strict=True):
        for text in timeline.texts:
            if text not in known:
                raise InvalidInputError(f"{name}: {text!r} is not in texts.txt")
    return MttSet(tuple(texts), timelines)


def in_order(intervals: Sequence[Interval], where: str) -> MttTimeline:
    """Tell the first, the second and the text beside them of three intervals in any order.

    Raises:
        InvalidInputError: not three, or no two that follow one another from the beginning on.
    """
    for first, second, beside in permutations(intervals, 3) if len(intervals) == 3 else ():
        if first.start == 0 and second.start == first.end:
            return MttTimeline(first, second, beside)
    raise InvalidInputError(f"{where} must have three texts, two of them one after the other from 0 s on")


def _read_motions(path: Path, folder: Path) -> list[FloatArray]:
    """Read the captured motion of each text, brought to +Y up and to the origin."""
    found = []
    for fields in _fields(path):
        if len(fields) != 3:
            raise InvalidInputError(f"{path}: a line is path # begin # end, not {' # '.join(fields)[:80]!r}")
        name, begin, end = fields
        try:
            joints = np.load(folder / f"{name}.npy", allow_pickle=False)
            cut = joints[int(FPS * float(begin)) : int(FPS * float(end)), :JOINTS].astype(np.float32)
        except (OSError, ValueError) as error:
            raise InvalidInputError(f"{folder / name}.npy cannot be read: {error}") from error
        if cut.ndim != 3 or cut.shape[1:] != (JOINTS, 3) or len(cut) < 2:
            raise InvalidInputError(f"{folder / name}.npy must hold joints (frames, 22 or more, 3), not {joints.shape}")
        found.append(canonicalise(np.stack([cut[..., 0], cut[..., 2], -cut[..., 1]], axis=-1)))
    return found


def _fields(path: Path) -> Iterator[list[str]]:
    for line in _read(path).splitlines():
        if line.strip():
            yield [field.strip() for field in line.split("#")]


def _read(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8")
    except (OSError, ValueError) as error:
        raise InvalidInputError(f"{path} cannot be read: {error}") from error
