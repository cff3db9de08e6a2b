"""Training motion that the model composed itself (EnergyMoGen's CompML, section 5.1): two actions at once, as a data
folder.

    python -m kinegraph_training.compml --data DATA/bandai --held-out DATA/held_out_pairs.json \
        --bundle runs/mine/bundle --count 300 --out data/composed --seed 1
    python -m kinegraph_training.train_denoisers --more data/composed ...

What is composed: an action of the legs or of one arm with a gesture of a free arm, both recorded in one manner, as long
as the recorded clip of the first. Pairs held out, and their mirror images, are never made; nor is an action in a manner
that was not recorded. A clip that jerks or skates more than `LIMIT` times as much as every recorded clip of its two
actions is drawn again, and so is one whose hands move less than the slowest recorded clip of the gesture by as much: a
bundle that waves faintly would teach it. Whether it shows what its captions say is not looked at: that would train on
the predicates that the benchmarks measure with. A stopped run goes on where it was; a larger --count adds to what is
there.
"""

from __future__ import annotations

import argparse
import hashlib
import io
import json
import sys
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from kinegraph.arrays import FloatArray
from numpy.typing import NDArray
from tqdm import tqdm

from kinegraph import MotionPipeline, __version__
from kinegraph.bundle.sessions import MAX_THREADS, available_cpus
from kinegraph.errors import InvalidInputError, KinegraphError, OutputError
from kinegraph.files import write_atomically
from kinegraph_training.data.clips import MotionClip, read_split
from kinegraph_training.data.folder import PreparedClip, write_data
from kinegraph_training.metrics import foot_skate, hand_speed, jerk
from kinegraph_training.synthetic.caption_grammar import concept_caption, splice_caption
from kinegraph_training.synthetic.compositions import HeldOut, drawn_pair, may_be_together, spliceable

LIMIT: Final = 1.5
"""Times the highest jerk and foot skate of recorded clips of the two actions; as much below the lowest hand speed."""
ATTEMPTS: Final = 8
"""Draws for one clip; one that fails them all is left out, and counted."""
PAIRS_DRAWN: Final = 10_000
"""Draws of two recorded clips until one may be composed; with fewer the data hold no such pair."""
MAX_COUNT: Final = 100_000


@dataclass(frozen=True)
class Wish:
    """What one clip shows."""

    contents: tuple[str, str]
    style: str
    concepts: tuple[str, str]
    """A sentence for each action."""
    captions: tuple[str, ...]
    """Several wordings of both; the first is the joint text of the composition."""
    seconds: float
    seed: int


@dataclass(frozen=True)
class Composer:
    """Makes clip k, whatever was made before: clips can be made in any order, by any number of threads."""

    pipe: MotionPipeline
    clips: Sequence[MotionClip]
    """Recorded clips that may be composed, of lengths that the bundle takes."""
    held_out: HeldOut
    seed: int
    highest: Mapping[str, NDArray[np.float64]]
    """Per content (2,): the highest jerk and foot skate of its recorded clips."""
    slowest: Mapping[tuple[str, str], float]
    """Per content and manner: the lowest hand speed of its recorded clips."""

    def wish(self, number: int, attempt: int) -> Wish:
        """Drawn from the generator of this clip and attempt.

        Raises:
            InvalidInputError: no two recorded clips may be composed.
        """
        rng = np.random.Generator(np.random.PCG64((self.seed, number, attempt)))
        clips = list(self.clips)
        for _ in range(PAIRS_DRAWN):
            first, second = drawn_pair(clips, rng)
            if may_be_together(first, second, self.held_out):
                both = (first.content, second.content)
                return Wish(
                    contents=both,
                    style=first.style,
                    concepts=(concept_caption(both[0], first.style, rng), concept_caption(both[1], first.style, rng)),
                    captions=splice_caption(*both, first.style, rng),
                    seconds=len(first.joints) / self.pipe.manifest.fps,
                    seed=int(rng.integers(2**32)),
                )
        raise InvalidInputError("the data hold no two actions of one manner that may be composed")

    def clean(self, joints: FloatArray, contents: tuple[str, str]) -> bool:
        """Whether a motion (frames, 22, 3) jerks and skates as recorded ones of either action do, or nearly so."""
        most = np.maximum(*(self.highest[content] for content in contents))
        # Feet that never touch the ground have no skate (NaN), and no fault.
        return jerk(joints) <= LIMIT * most[0] and not foot_skate(joints) > LIMIT * most[1]

    def lively(self, joints: FloatArray, gesture: tuple[str, str]) -> bool:
        """Whether the hands of a motion move nearly as much as in recorded clips of the gesture (content, manner)."""
        return hand_speed(joints) * LIMIT >= self.slowest[gesture]

    def make(self, number: int) -> tuple[Wish, FloatArray, int]:
        """The first clean attempt, and how many came before it; no frames if none was."""
        for attempt in range(ATTEMPTS):
            wish = self.wish(number, attempt)
            clip = self.pipe.compose(wish.concepts, text=wish.captions[0], seconds=wish.seconds, seed=wish.seed)
            gesture = (wish.contents[1], wish.style)
            if self.clean(clip.joints, wish.contents) and self.lively(clip.joints, gesture):
                return wish, clip.joints, attempt
        return wish, clip.joints[:0], ATTEMPTS


def composer(pipe: MotionPipeline, data: Path, held_out: Path, seed: int) -> Composer:
    """From the `train` split of a data folder.

    Raises:
        InvalidInputError: files that cannot be read, or fewer than two labelled actions in every manner.
    """
    shortest, longest = pipe.manifest.frames.min, pipe.manifest.frames.max
    usable = [clip for clip in spliceable(read_split(data, "train")) if shortest <= len(clip.joints) <= longest]
    if len({(clip.style, clip.content) for clip in usable}) == len({clip.style for clip in usable}):
        raise InvalidInputError(f"{data} has no manner with two labelled actions; nothing can be composed")
    found: dict[str, list[tuple[float, float]]] = {}
    for clip in usable:
        found.setdefault(clip.content, []).append((jerk(clip.joints), foot_skate(clip.joints)))
    # 0 beside NaN: an action whose feet were never on the floor
    highest = {content: np.nanmax([(0.0, 0.0), *rows], axis=0) for content, rows in found.items()}
    slowest: dict[tuple[str, str], float] = {}
    for clip in usable:
        kind = (clip.content, clip.style)
        slowest[kind] = min(slowest.get(kind, np.inf), hand_speed(clip.joints))
    return Composer(pipe, usable, HeldOut.read(held_out), seed, highest, slowest)


def write_part(own: Composer, number: int, path: Path) -> None:
    """One clip, kept until all are made."""
    wish, joints, rejected = own.make(number)
    buffer = io.BytesIO()
    np.savez(
        buffer,
        joints=joints,
        captions=np.array(wish.captions),
        labels=np.array(["+".join(wish.contents), wish.style]),
        rejected=rejected,
    )
    write_atomically(path, buffer.getvalue())


def read_part(path: Path) -> tuple[PreparedClip, int]:
    """What `write_part` wrote, and how many motions were rejected before it."""
    with np.load(path, allow_pickle=False) as stored:
        content, style = (str(label) for label in stored["labels"])
        captions = tuple(str(caption) for caption in stored["captions"])
        name = f"compml_{path.stem}"
        clip = PreparedClip(name, stored["joints"], captions, "composed", "train", content, style)
        return clip, int(stored["rejected"])


def begin(out: Path, origin: Mapping[str, Any]) -> None:
    """Say where the clips come from before there are any; refuse a folder of something else.

    Raises:
        OutputError: `out` holds other files, or clips of another origin.
    """
    path = out / "provenance.json"
    if path.is_file():
        known = json.loads(path.read_text(encoding="utf-8"))["origin"]
        other = [name for name in origin if known.get(name) != origin[name]]
        if other:
            raise OutputError(f"{out} was begun with another {', '.join(other)}; choose another folder")
    elif out.exists() and (not out.is_dir() or any(out.iterdir())):
        raise OutputError(f"{out} holds something else; choose another folder")
    try:
        (out / "parts").mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OutputError(f"{out} cannot be made ({error.strerror}); choose another folder") from error
    if not path.is_file():
        write_atomically(path, _json({"origin": origin}))


def origin_of(pipe: MotionPipeline, data: Path, held_out: Path, seed: int) -> dict[str, Any]:
    """Everything that a clip depends on, and the licence that comes with it."""
    manifest = pipe.manifest
    weights = "".join(spec.sha256 for _, spec in sorted(manifest.files.items()))
    recorded = b"".join((data / name).read_bytes() for name in ("train.npz", "index.jsonl"))
    return {
        "made_by": f"kinegraph_training.compml, kinegraph {__version__}",
        "bundle": f"{manifest.name} {manifest.version}",
        "bundle_sha256": hashlib.sha256(weights.encode()).hexdigest(),
        "data_sha256": hashlib.sha256(recorded).hexdigest(),
        "held_out_sha256": hashlib.sha256(held_out.read_bytes()).hexdigest(),
        "seed": seed,
        "method": "fused (EnergyMoGen, Eq. 10), default shares, joint text from the captions",
        "kept": f"jerk and foot skate at most {LIMIT:g} times the highest of recorded clips of either action, hands at "
        f"least 1/{LIMIT:g} as fast as the slowest of the gesture",
        "licence": {
            "of": "these clips are made by the weights below: use and pass them on under the same terms only",
            "weights": manifest.licence.weights,
            "data": manifest.licence.data,
        },
    }


def compose_all(own: Composer, out: Path, count: int, jobs: int) -> dict[str, int]:
    """Make what is missing and write the data folder.

    Returns:
        How many clips there are, how many are left out, and how many motions were rejected.
    """
    paths = [out / "parts" / f"{number:06d}.npz" for number in range(count)]
    missing = [(number, path) for number, path in enumerate(paths) if not path.is_file()]
    pool = ThreadPoolExecutor(jobs)
    try:
        waiting = [pool.submit(write_part, own, number, path) for number, path in missing]
        done = as_completed(waiting)
        for one in tqdm(done, desc="composed", initial=count - len(missing), total=count, unit="clip"):
            one.result()
    finally:
        pool.shutdown(cancel_futures=True)
    parts = [read_part(path) for path in paths]
    clips = [clip for clip, _ in parts if len(clip.joints)]
    write_data(out, clips, own.pipe.manifest.fps)
    return {
        "clips": len(clips),
        "left_out": count - len(clips),
        "rejected": sum(rejected for _, rejected in parts),
    }


def _json(value: object) -> bytes:
    return (json.dumps(value, indent=1, ensure_ascii=False) + "\n").encode()


def main(arguments: Sequence[str] | None = None) -> int:
    """The command line; 2 on bad input, with the reason on stderr; 130 interrupted."""
    parser = argparse.ArgumentParser(prog="kinegraph_training.compml", description=__doc__.split("\n\n")[0])
    parser.add_argument("--data", type=Path, required=True, help="recorded motion: which actions, manners and lengths")
    parser.add_argument("--held-out", type=Path, required=True, help="JSON of action pairs that must not be composed")
    parser.add_argument("--bundle", type=Path, help="folder of the bundle that composes; the default bundle without it")
    parser.add_argument("--count", type=int, required=True, help="clips to make")
    parser.add_argument("--out", type=Path, required=True, help="data folder to write")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--jobs", type=int, default=available_cpus(), help="clips made at a time (default: all cores)")
    given = parser.parse_args(arguments)
    try:
        for name, most in (("count", MAX_COUNT), ("jobs", MAX_THREADS)):
            if not 1 <= getattr(given, name) <= most:
                raise InvalidInputError(f"--{name} must be 1 to {most}, not {getattr(given, name)}")
        if given.seed < 0:
            raise InvalidInputError(f"--seed must be 0 or more, not {given.seed}")
        pipe = MotionPipeline.load(given.bundle, threads=1)
        own = composer(pipe, given.data, given.held_out, given.seed)
        origin = origin_of(pipe, given.data, given.held_out, given.seed)
        begin(given.out, origin)
        counts = compose_all(own, given.out, given.count, given.jobs)
        write_atomically(given.out / "provenance.json", _json({"origin": origin, **counts}))
    except KinegraphError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print(f"stopped; the same command goes on from what is in {given.out}", file=sys.stderr)
        return 130
    made, missing, rejected = counts.values()
    print(f"{given.out}: {made} clips, {rejected} motions drawn again, {missing} clips left out")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
