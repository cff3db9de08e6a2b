"""Compose training clips of two actions at once with a trained bundle (EnergyMoGen's CompML, section 5.1).

    python -m kinegraph_training.compml --data DATA/bandai --held-out DATA/held_out_pairs.json \
        --bundle runs/mine/bundle --count 300 --out data/composed --seed 1
    python -m kinegraph_training.train_denoisers --more data/composed ...

Each clip combines an action of the legs or of one arm with a gesture of a free arm. Both were captured in one style.
The clip is as long as the captured clip of the first. Held-out pairs and their mirror images are never composed.

A clip is rejected and drawn again if its jerk or foot skate is more than `LIMIT` times the highest of captured clips of
its two actions. So is one whose hands are slower than 1 / `LIMIT` of the slowest captured clip of the gesture, as a
bundle that waves faintly would teach it. Whether a clip shows what its captions say is not checked: that would train on
the predicates that the benchmarks measure with.

The same command resumes a stopped run; a larger --count adds clips.
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
from numpy.typing import NDArray
from tqdm import tqdm

from kinegraph import MotionPipeline, __version__
from kinegraph.arrays import FloatArray
from kinegraph.bundle.sessions import MAX_THREADS, available_cpus
from kinegraph.errors import InvalidInputError, KinegraphError, OutputError
from kinegraph.files import write_atomically
from kinegraph_training.data.clips import AT_ONCE, MotionClip, read_split
from kinegraph_training.data.folder import PreparedClip, write_data
from kinegraph_training.metrics import foot_skate, hand_speed, jerk
from kinegraph_training.synthetic.caption_grammar import PHRASES, concept_caption, splice_caption
from kinegraph_training.synthetic.compositions import (
    NORMAL,
    HeldOut,
    by_style_and_action,
    can_splice,
    draw_of,
    draw_style,
)

LIMIT: Final = 1.5
"""Factor by which jerk and foot skate may exceed those of captured clips, and hand speed fall below theirs."""
ATTEMPTS: Final = 8
"""Motions generated for one clip; a clip whose motions are all rejected is left out, and counted."""
PAIRS_DRAWN: Final = 10_000
"""Pairs of captured clips drawn before the data count as holding none that can be composed."""
MAX_COUNT: Final = 100_000


@dataclass(frozen=True)
class CompositionRequest:
    """Composition of two actions, as asked of the bundle."""

    actions: tuple[str, str]
    """Labels of the carrier and of the gesture."""
    style: str
    concepts: tuple[str, str]
    """A sentence for each action."""
    captions: tuple[str, ...]
    """Sentences of both actions; the first is the joint text of the composition."""
    seconds: float
    seed: int


@dataclass(frozen=True)
class Composer:
    """Composer of clips by number: clip k depends on k and the seed alone, so that threads can work in any order."""

    pipe: MotionPipeline
    clips: Sequence[MotionClip]
    """Captured clips that can be composed, of lengths that the bundle takes."""
    held_out: HeldOut
    seed: int
    highest: Mapping[str, NDArray[np.float64]]
    """By action (2,): highest jerk and foot skate of its captured clips."""
    slowest: Mapping[tuple[str, str], float]
    """By action and style: lowest hand speed of its captured clips."""

    def draw_request(self, number: int, attempt: int) -> CompositionRequest:
        """Draw the request of one attempt at clip `number`.

        Raises:
            InvalidInputError: no two captured clips can be composed.
        """
        rng = np.random.Generator(np.random.PCG64((self.seed, number, attempt)))
        groups = by_style_and_action(self.clips)
        for _ in range(PAIRS_DRAWN):
            style = draw_style(groups, rng)
            first, second = (draw_of(groups[style], rng) for _ in range(2))
            both = (first.action, second.action)
            if both[0] != both[1] and can_splice(both[0], both[1:], self.held_out):
                return CompositionRequest(
                    actions=both,
                    style=first.style,
                    concepts=(concept_caption(both[0], first.style, rng), concept_caption(both[1], first.style, rng)),
                    captions=splice_caption(both, first.style, rng),
                    seconds=len(first.joints) / self.pipe.manifest.fps,
                    seed=int(rng.integers(2**32)),
                )
        raise InvalidInputError("the data hold no two actions of one style that can be composed")

    def is_clean(self, joints: FloatArray, actions: tuple[str, str]) -> bool:
        """Tell whether jerk and foot skate of a motion (frames, 22, 3) are within `LIMIT` of captured clips."""
        most = np.maximum(*(self.highest[action] for action in actions))
        # Feet that never touch the ground have no skate (NaN), and pass.
        return jerk(joints) <= LIMIT * most[0] and not foot_skate(joints) > LIMIT * most[1]

    def is_lively(self, joints: FloatArray, gesture: tuple[str, str]) -> bool:
        """Tell whether the hands of a motion are within `LIMIT` of captured clips of the gesture (action, style)."""
        return hand_speed(joints) * LIMIT >= self.slowest[gesture]

    def compose(self, number: int) -> tuple[CompositionRequest, FloatArray, int]:
        """Generate motions for clip `number` until one is accepted.

        Returns:
            The request, the joints (frames, 22, 3), and the number of rejected motions. There are no frames if all
            `ATTEMPTS` were rejected.
        """
        for attempt in range(ATTEMPTS):
            request = self.draw_request(number, attempt)
            clip = self.pipe.compose(
                request.concepts, text=request.captions[0], seconds=request.seconds, seed=request.seed
            )
            gesture = (request.actions[1], request.style or NORMAL)
            if self.is_clean(clip.joints, request.actions) and self.is_lively(clip.joints, gesture):
                return request, clip.joints, attempt
        return request, clip.joints[:0], ATTEMPTS


def make_composer(pipe: MotionPipeline, data: Path, held_out: Path, seed: int) -> Composer:
    """Make a composer from the `train` split of a data folder.

    Args:
        pipe: pipeline of the bundle.
        data: folder of captured clips.
        held_out: JSON file of pairs that must not be composed.
        seed: of all clips.

    Raises:
        InvalidInputError: files that cannot be read, or no style with two labelled actions.
    """
    shortest, longest = pipe.manifest.frames.min, pipe.manifest.frames.max
    clips = [clip for clip in read_split(data, "train") if clip.action in PHRASES]
    usable = [
        clip for clip in clips if PHRASES[clip.action].parts != "body" and shortest <= len(clip.joints) <= longest
    ]
    labels = {(clip.action, clip.style or NORMAL) for clip in usable}  # clips without a style go with the normal ones
    if len(labels) == len({style for _, style in labels}):
        raise InvalidInputError(f"{data} has no style with two labelled actions; nothing can be composed")
    measures: dict[str, list[tuple[float, float]]] = {}
    for clip in usable:
        measures.setdefault(clip.action, []).append((jerk(clip.joints), foot_skate(clip.joints)))
    # The row of zeros stands for actions whose feet are never on the floor (NaN).
    highest = {action: np.nanmax([(0.0, 0.0), *rows], axis=0) for action, rows in measures.items()}
    slowest: dict[tuple[str, str], float] = {}
    for clip in usable:
        label = (clip.action, clip.style or NORMAL)
        slowest[label] = min(slowest.get(label, np.inf), hand_speed(clip.joints))
    return Composer(pipe, usable, HeldOut.read(held_out), seed, highest, slowest)


def write_part(composer: Composer, number: int, path: Path) -> None:
    """Compose one clip and write it to a file of its own, until all are done."""
    request, joints, rejected = composer.compose(number)
    buffer = io.BytesIO()
    np.savez(
        buffer,
        joints=joints,
        captions=np.array(request.captions),
        labels=np.array([AT_ONCE.join(request.actions), request.style]),
        rejected=rejected,
    )
    write_atomically(path, buffer.getvalue())


def read_part(path: Path) -> tuple[PreparedClip, int]:
    """Read the file of one clip; returns the clip, and the number of motions rejected before it."""
    with np.load(path, allow_pickle=False) as stored:
        action, style = (str(label) for label in stored["labels"])
        captions = tuple(str(caption) for caption in stored["captions"])
        name = f"compml_{path.stem}"
        clip = PreparedClip(name, stored["joints"], captions, "composed", "train", action, style)
        return clip, int(stored["rejected"])


def claim_folder(out: Path, origin: Mapping[str, Any]) -> None:
    """Write the provenance of the clips before there are any, and refuse a folder of something else.

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


def describe_origin(pipe: MotionPipeline, data: Path, held_out: Path, seed: int) -> dict[str, Any]:
    """Describe everything that the clips depend on, and the licence that they fall under."""
    manifest = pipe.manifest
    weights = "".join(spec.sha256 for _, spec in sorted(manifest.files.items()))
    captured = b"".join((data / name).read_bytes() for name in ("train.npz", "index.jsonl"))
    return {
        "made_by": f"kinegraph_training.compml, kinegraph {__version__}",
        "bundle": f"{manifest.name} {manifest.version}",
        "bundle_sha256": hashlib.sha256(weights.encode()).hexdigest(),
        "data_sha256": hashlib.sha256(captured).hexdigest(),
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


def compose_all(composer: Composer, out: Path, count: int, jobs: int) -> dict[str, int]:
    """Compose the clips that are missing, and write the data folder.

    Args:
        composer: of the clips.
        out: data folder.
        count: clips to compose, those of earlier runs included.
        jobs: clips composed at a time.

    Returns:
        Numbers of `clips`, of clips `left_out`, and of `rejected` motions.
    """
    paths = [out / "parts" / f"{number:06d}.npz" for number in range(count)]
    missing = [(number, path) for number, path in enumerate(paths) if not path.is_file()]
    pool = ThreadPoolExecutor(jobs)
    try:
        futures = [pool.submit(write_part, composer, number, path) for number, path in missing]
        done = as_completed(futures)
        for future in tqdm(done, desc="composed", initial=count - len(missing), total=count, unit="clip"):
            future.result()
    finally:
        pool.shutdown(cancel_futures=True)
    parts = [read_part(path) for path in paths]
    clips = [clip for clip, _ in parts if len(clip.joints)]
    write_data(out, clips, composer.pipe.manifest.fps)
    return {
        "clips": len(clips),
        "left_out": count - len(clips),
        "rejected": sum(rejected for _, rejected in parts),
    }


def _json(value: object) -> bytes:
    return (json.dumps(value, indent=1, ensure_ascii=False) + "\n").encode()


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; returns 2 on bad input, with the reason on stderr, and 130 if interrupted."""
    parser = argparse.ArgumentParser(prog="kinegraph_training.compml", description=__doc__.split("\n\n")[0])
    parser.add_argument("--data", type=Path, required=True, help="captured motion: which actions, styles and lengths")
    parser.add_argument("--held-out", type=Path, required=True, help="JSON of action pairs that must not be composed")
    parser.add_argument("--bundle", help="folder or name of the bundle that composes (the default bundle)")
    parser.add_argument("--count", type=int, required=True, help="clips to make")
    parser.add_argument("--out", type=Path, required=True, help="data folder to write")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--jobs", type=int, default=available_cpus(), help="clips made at a time (default: all cores)")
    parsed = parser.parse_args(arguments)
    try:
        for name, most in (("count", MAX_COUNT), ("jobs", MAX_THREADS)):
            if not 1 <= getattr(parsed, name) <= most:
                raise InvalidInputError(f"--{name} must be 1 to {most}, not {getattr(parsed, name)}")
        if parsed.seed < 0:
            raise InvalidInputError(f"--seed must be 0 or more, not {parsed.seed}")
        pipe = MotionPipeline.load(parsed.bundle, threads=1)
        composer = make_composer(pipe, parsed.data, parsed.held_out, parsed.seed)
        origin = describe_origin(pipe, parsed.data, parsed.held_out, parsed.seed)
        claim_folder(parsed.out, origin)
        counts = compose_all(composer, parsed.out, parsed.count, parsed.jobs)
        write_atomically(parsed.out / "provenance.json", _json({"origin": origin, **counts}))
    except KinegraphError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print(f"stopped; the same command goes on from what is in {parsed.out}", file=sys.stderr)
        return 130
    print(
        f"{parsed.out}: {counts['clips']} clips, {counts['rejected']} motions drawn again, "
        f"{counts['left_out']} clips left out"
    )
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
