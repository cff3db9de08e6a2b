"""Cases for constraints: sentences, and what else their clips must do, drawn from captured clips and made.

Targets of captured clips can be reached: a person did so. A case has the sentence of its clip's label, whose rules the
captured clip meets, and asks for one thing that the clip did: its path, a place on it, where a hand was, a pose.
Seeds are held out: no benchmark that settings were chosen by has seen them. Poses are first put on the bundle's body:
with other bones no motion of it could be in them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import cycle, islice, pairwise
from typing import Final

import numpy as np

from kinegraph import EndPose, JointTarget, Keyframe, Loop, Path, StartPose, Waypoint
from kinegraph.arrays import FloatArray
from kinegraph.constraints import Constraint
from kinegraph.motion.skeleton import JOINT_INDEX, PELVIS, canonicalise
from kinegraph_benchmarks.common.everyday_rules import meets
from kinegraph_benchmarks.common.predicates import FPS
from kinegraph_training.data.clips import MotionClip
from kinegraph_training.data.common_skeleton import rest_directions, to_common_skeleton

FIRST_SEED: Final = 70_000
SECONDS: Final = 4.0
"""Length of a clip at most; that of a shorter captured clip is taken."""
SHORTEST: Final = 2.0
POSE_FRAMES: Final = 4
GAITS: Final = {
    "walk": ("a person walks forward", ("forward",)),
    "run": ("a person runs forward", ("forward", "fast")),
    "walk-turn-left": ("a person walks and turns left", ("turn_left",)),
    "walk-turn-right": ("a person walks and turns right", ("turn_right",)),
}
"""Label -> sentence and rules."""
GESTURES: Final = {
    "raise-up-left-hand": ("a person raises the left hand", ("left_up",)),
    "raise-up-right-hand": ("a person raises the right hand", ("right_up",)),
    "raise-up-both-hands": ("a person raises both hands", ("both_up",)),
    "wave-left-hand": ("a person waves the left hand", ("waves_left",)),
    "wave-right-hand": ("a person waves the right hand", ("waves_right",)),
    "bow": ("a person bows", ("bows",)),
}
ALL: Final = {**GAITS, **GESTURES}
WALK_AND_WAVE: Final = ("a person walks forward while waving the right hand", ("forward", "waves_right"))
WALK_STRAIGHT: Final = ("a person walks forward", ("forward", "no_turn"))


@dataclass(frozen=True)
class Case:
    """One clip to make, with and without its constraints."""

    kind: str
    text: str
    rules: tuple[str, ...]
    """Of `everyday_rules`, which the clip must meet with the constraints as often as without."""
    seconds: float
    seed: int
    constraints: tuple[Constraint, ...]
    captured: FloatArray | None = None
    """(frames, 22, 3) metres: the clip that did all of it, if one did; as long as the case."""


def make_cases(clips: Sequence[MotionClip], count: int) -> dict[str, list[Case]]:
    """Make the cases of every kind.

    Args:
        clips: captured, of a split that no model was trained on.
        count: cases of each kind; clips are taken again with other seeds where there are fewer.
    """
    cases = {}
    for number, (kind, make) in enumerate(KINDS.items()):
        seeds = range(FIRST_SEED + 1000 * number, FIRST_SEED + 1000 * number + count)
        drawn = list(islice(make(clips), count))
        if not drawn:
            continue
        cases[kind] = [
            Case(kind, text, rules, seconds, seed, constraints, captured)
            for seed, (text, rules, seconds, constraints, captured) in zip(seeds, cycle(drawn), strict=False)
        ]
    return cases


def on_common_body(clips: Sequence[MotionClip]) -> list[MotionClip]:
    """Put captured clips of one body on the body that bundles of several data sets are trained on."""
    rests = rest_directions([clip.joints for clip in clips])
    return [replace(clip, joints=canonicalise(to_common_skeleton(clip.joints, rests))) for clip in clips]


_Drawn = Iterator[tuple[str, tuple[str, ...], float, tuple[Constraint, ...], FloatArray | None]]


def usable(clips: Sequence[MotionClip], labels: dict[str, tuple[str, tuple[str, ...]]]) -> list[MotionClip]:
    """List clips of some labels that are long enough and meet the rules of their label, labels in turn."""
    by_label = [
        [clip for clip in clips if clip.action == label and _length(clip) >= SHORTEST and meets(_cut(clip), rules)]
        for label, (_, rules) in labels.items()
    ]
    longest = max(map(len, by_label), default=0)
    return [pile[row] for row in range(longest) for pile in by_label if row < len(pile)]


def floor_path(joints: FloatArray) -> FloatArray:
    """Take the root's places on the floor: (frames, 2) metres."""
    return joints[:, PELVIS][:, [0, 2]]


def _cut(clip: MotionClip) -> FloatArray:
    """Cut a clip to the length of its case."""
    return clip.joints[: round(_length(clip) * FPS)]


def _length(clip: MotionClip) -> float:
    return min(SECONDS, len(clip.joints) / FPS)


def _captured_path(clips: Sequence[MotionClip]) -> _Drawn:
    """The path of a captured clip, a point every quarter of a second."""
    for clip in usable(clips, GAITS):
        joints, (text, rules) = _cut(clip), GAITS[clip.action]
        places = floor_path(joints)
        frames = np.unique(np.append(np.arange(0, len(places), 5), len(places) - 1))
        yield text, rules, _length(clip), (Path(places[frames], frames / FPS),), joints


def _drawn_path(_: Sequence[MotionClip]) -> _Drawn:
    """Arcs and S-curves of 2.5 to 4.5 m, at an even pace, as somebody draws them."""
    along = np.linspace(0.0, 1.0, 25)
    for bend in (-1.2, -0.8, -0.4, 0.4, 0.8, 1.2):
        for length in (2.5, 3.5, 4.5):
            for shape in (along, np.sin(2 * np.pi * along) / 2):
                heading = bend * shape
                steps = np.stack([np.sin(heading), np.cos(heading)], axis=-1)[1:] * (length / 24)
                points = np.concatenate([np.zeros((1, 2)), np.cumsum(steps, axis=0)])
                yield "a person walks forward", ("forward",), SECONDS, (Path(points),), None


def _waypoint(clips: Sequence[MotionClip]) -> _Drawn:
    """Where a captured clip is in its middle and at its end."""
    for clip in usable(clips, GAITS):
        joints, (text, rules) = _cut(clip), GAITS[clip.action]
        places = floor_path(joints)
        frames = (len(places) // 2, len(places) - 1)
        yield text, rules, _length(clip), tuple(_at(places[frame], frame) for frame in frames), joints


def _at(place: FloatArray, frame: int) -> Waypoint:
    return Waypoint(frame / FPS, (float(place[0]), float(place[1])))


def _hand(clips: Sequence[MotionClip]) -> _Drawn:
    """Where a hand of a captured gesture is at 60 % of its time."""
    for clip in usable(clips, {label: ALL[label] for label in GESTURES if label != "bow"}):
        joints, (text, rules) = _cut(clip), GESTURES[clip.action]
        frame = round(0.6 * len(joints))
        side = "left" if "left" in clip.action else "right"
        yield text, rules, _length(clip), (_joint(joints, f"{side}_wrist", frame),), joints


def _foot(clips: Sequence[MotionClip]) -> _Drawn:
    """Where a foot of a captured walk stands at half its time."""
    for clip in usable(clips, GAITS):
        joints, (text, rules) = _cut(clip), GAITS[clip.action]
        frame = len(joints) // 2
        names = ("left_foot", "right_foot")
        standing = min(names, key=lambda name: joints[frame, JOINT_INDEX[name], 1])
        yield text, rules, _length(clip), (_joint(joints, standing, frame),), joints


def _joint(joints: FloatArray, name: str, frame: int) -> JointTarget:
    x, y, z = (float(value) for value in joints[frame, JOINT_INDEX[name]])
    return JointTarget(name, (x, y, z), frame / FPS)


def _keyframe(clips: Sequence[MotionClip]) -> _Drawn:
    """The pose of a captured gesture at half its time."""
    for clip in usable(clips, GESTURES):
        joints, (text, rules) = _cut(clip), GESTURES[clip.action]
        frame = len(joints) // 2
        yield text, rules, _length(clip), (Keyframe(frame / FPS, joints[frame]),), joints


def _start(clips: Sequence[MotionClip]) -> _Drawn:
    """The end of one captured clip, before a sentence of the next label."""
    chosen = usable(clips, ALL)
    for clip, following in pairwise(chosen):
        text, rules = ALL[following.action]
        yield text, rules, SECONDS, (StartPose(_cut(clip)[-POSE_FRAMES:]),), None


def _end(clips: Sequence[MotionClip]) -> _Drawn:
    """The beginning of one captured clip, after a sentence of the next label."""
    chosen = usable(clips, ALL)
    for clip, before in pairwise(chosen):
        text, rules = ALL[before.action]
        yield text, rules, SECONDS, (EndPose(_cut(clip)[:POSE_FRAMES]),), None


def _loop(_: Sequence[MotionClip]) -> _Drawn:
    for text, rules in ALL.values():
        yield text, rules, SECONDS, (Loop(),), None


def _path_and_wave(clips: Sequence[MotionClip]) -> _Drawn:
    """The path of a captured walk, while waving."""
    walks = {label: GAITS[label] for label in ("walk",)}
    text, rules = WALK_AND_WAVE
    for clip in usable(clips, walks):
        places = floor_path(_cut(clip))
        frames = np.unique(np.append(np.arange(0, len(places), 5), len(places) - 1))
        yield text, rules, _length(clip), (Path(places[frames], frames / FPS),), None


def _keyframe_and_straight(clips: Sequence[MotionClip]) -> _Drawn:
    """A pose of a captured walk wherever it is, while going straight on."""
    text, rules = WALK_STRAIGHT
    for clip in usable(clips, {"walk": WALK_STRAIGHT}):
        joints = _cut(clip)
        frame = len(joints) // 2
        yield text, rules, _length(clip), (Keyframe(frame / FPS, joints[frame], anywhere=True),), joints


KINDS: Final[dict[str, Callable[[Sequence[MotionClip]], _Drawn]]] = {
    "path": _captured_path,
    "drawn path": _drawn_path,
    "waypoint": _waypoint,
    "hand": _hand,
    "foot": _foot,
    "keyframe": _keyframe,
    "start": _start,
    "end": _end,
    "loop": _loop,
    "path + wave": _path_and_wave,
    "keyframe + straight": _keyframe_and_straight,
}
"""Kind -> generator of sentence, rules, seconds, constraints, and the clip that did it all."""
