"""A timeline: sentences one after another, with constraints on the whole of it.

    part k = generate(sentence k, first frames = last frames of part k - 1, constraints that fall into part k)

A part begins at the origin and faces +Z, as every clip does. So what it is asked for is brought into its own frame:
times count from its beginning, places from where the part before ends. Parts overlap by the frames of a `StartPose`.
"""

from __future__ import annotations

import hashlib
from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any, Final

import numpy as np

from kinegraph.arrays import FloatArray
from kinegraph.clip import Clip
from kinegraph.concepts import Concept
from kinegraph.constraint_values import check_total_weight
from kinegraph.constraints import (
    Constraint,
    EndPose,
    JointTarget,
    Keyframe,
    Loop,
    Path,
    StartPose,
    Waypoint,
    latest_moment,
    pose_frames,
)
from kinegraph.diffusion.sampling import OnStep, subrange_progress
from kinegraph.errors import InvalidInputError
from kinegraph.feasibility import as_constraints
from kinegraph.graph import SemanticGraph
from kinegraph.layers import Layer, check_layers, notes_of, spans_of
from kinegraph.limits import MAX_PARTS, MAX_WEIGHT
from kinegraph.motion.body_frame import BodyFrame, append_part
from kinegraph.motion.skeleton import start_at_origin
from kinegraph.options import (
    Guidance,
    Steps,
    frame_count,
    resolve_options,
    sentence_seeds,
    sequence_caption,
    validate_lengths,
)
from kinegraph.part_memory import PartMemory, check_memory
from kinegraph.pipeline import MotionPipeline, check_call
from kinegraph.placements import misses_of
from kinegraph.text.parser import check_caption

PATH_STEP: Final = 0.2
"""Seconds between two points of a part's piece of a path."""


def generate_timeline(
    pipeline: MotionPipeline,
    texts: Sequence[str | SemanticGraph],
    *,
    seconds: float | Sequence[float],
    constraints: Sequence[Constraint] | None = None,
    constraint_weight: float = 1.0,
    layers: Sequence[Layer] = (),
    seed: int | None = None,
    seed_offsets: Sequence[int] | None = None,
    steps: Steps | None = None,
    guidance: Guidance | None = None,
    foot_fix: bool = True,
    strict: bool = False,
    timeout: float | None = None,
    on_step: OnStep | None = None,
    memory: PartMemory | None = None,
) -> Clip:
    """Make one clip of several sentences, each from the last pose of the one before, with constraints on the whole.

    Args:
        pipeline: a bundle that takes constraints.
        texts: 1 to `limits.MAX_PARTS` sentences or graphs; sentence k is generated with seed + seed_offsets[k].
        seconds: of each part, or one length for all.
        constraints: times from the beginning of the whole clip, places where they are in it.
        layers: concepts, with which every sentence that their span touches is composed (`MotionPipeline.compose`).
        constraint_weight: of all constraints against the texts; 0 is the clip without them, bit for bit. Each part
            begins in the last pose of the one before all the same.
        seed, steps, guidance, foot_fix, strict, timeout, on_step: as in `MotionPipeline.generate`.
        seed_offsets: one for each sentence; None is 0, 1, 2 ... What keeps its own is not changed by others.
        memory: parts that were made before, and need not be made again.

    Raises:
        InvalidInputError: as in `MotionPipeline.generate` and `layers.check_layers`; also a `Loop`, and times behind
            the end.
        UnknownWordsError, Cancelled, NonFiniteError: as in `MotionPipeline.generate`.
    """
    deadline = check_call(timeout, on_step, strict=strict)
    constraints, weight = as_constraints(constraints), check_total_weight(constraint_weight)
    lengths = validate_lengths(texts, seconds, MAX_PARTS, "a timeline")
    for text in texts:
        if not isinstance(text, SemanticGraph):
            check_caption(text)
    manifest, fps = pipeline.manifest, pipeline.manifest.fps
    if any(length is None for length in lengths):
        raise InvalidInputError("a timeline needs the seconds of each part")
    if any(isinstance(constraint, Loop) for constraint in constraints):
        raise InvalidInputError("a loop is for one sentence; for a timeline take `Clip.looped`")
    options: dict[str, Any] = {"steps": steps, "guidance": guidance, "foot_fix": foot_fix}
    first = resolve_options(manifest, seconds=lengths[0], seed=seed, **options).seed
    seeds = sentence_seeds(first, len(texts), seed_offsets)
    overlap = pose_frames(fps)
    asked = [frame_count(manifest, length) for length in lengths]
    # a part begins in the last frames of the one before, and is made with them
    frames = [min(count, manifest.frames.max - overlap * bool(index)) for index, count in enumerate(asked)]
    shortened = [
        f"sentence {index + 1} has {made / fps:g} s, the most of one behind another"
        for index, (count, made) in enumerate(zip(asked, frames, strict=True))
        if made < count
    ]
    ends = [float(end) for end in np.cumsum(frames) / fps]
    _check_times(constraints, ends[-1])
    layers = check_layers(layers, ends)
    shared = {**options, "strict": strict}
    pulling = _weighed(constraints, weight)
    memory = PartMemory() if memory is None else check_memory(memory)
    memory.begin()
    parts = _Parts(pipeline, shared, deadline.watch(on_step), len(texts), memory)
    whole: FloatArray | None = None
    clips: list[Clip] = []
    for index, (text, span) in enumerate(deadline.each(zip(texts, spans_of(ends), strict=True))):
        lead = 0 if whole is None else overlap
        frame = BodyFrame(np.zeros(3), 0.0) if whole is None else BodyFrame.of(whole[-overlap])
        wanted = localised(pulling, span, ends[-1], lead / fps, frame, 1 / fps)
        if whole is not None:
            # near the origin, however far the whole has come
            wanted = (StartPose(start_at_origin(whole[-overlap:]), fps=fps), *wanted)
        concepts = tuple(layer.concept for layer in layers if layer.touches(*span))
        clip = parts.make(index, text, concepts, wanted, seconds=(frames[index] + lead) / fps, seed=seeds[index])
        clips.append(clip)
        whole = clip.joints if whole is None else append_part(whole, clip.joints, lead)
    assert whole is not None
    unknown = {words.text.lower(): words for clip in clips for words in clip.unknown}
    notes = (*shortened, *_untold(constraints, ends), *notes_of(layers, ends))
    notes += tuple(note for clip in clips for note in clip.notes)
    return replace(
        clips[0],
        joints=whole,
        seed=first,
        text=sequence_caption([clip.text for clip in clips]),
        graph=clips[0].graph if len(clips) == 1 else None,
        unknown=tuple(unknown.values()),
        notes=tuple(dict.fromkeys(notes)),
        misses=misses_of(constraints, whole, fps),
    )


@dataclass(frozen=True)
class _Parts:
    """Makes the parts of one timeline, but for those that are remembered."""

    pipeline: MotionPipeline
    shared: Mapping[str, Any]
    """Options of every part."""
    on_step: OnStep | None
    count: int
    memory: PartMemory

    def make(
        self,
        index: int,
        text: str | SemanticGraph,
        concepts: tuple[Concept, ...],
        wanted: Sequence[Constraint],
        **own: Any,
    ) -> Clip:
        """Make part `index`: the sentence alone, or composed with the concepts of layers."""
        options = {**self.shared, **own}
        progress = subrange_progress(self.on_step, index, self.count)

        def make() -> Clip:
            if not concepts:
                return self.pipeline.generate(text, constraints=wanted, on_step=progress, **options)
            return self.pipeline.compose([text, *concepts], constraints=wanted, on_step=progress, **options)

        key = (self.pipeline, text, concepts, repr(options), *map(_fingerprint, wanted))
        return self.memory.part(index, key, make)


def _weighed(constraints: Sequence[Constraint], weight: float) -> tuple[Constraint, ...]:
    """Weigh constraints by the weight of all of them; those of weight 0 pull nothing, and are left out.

    The poses in which parts begin are no constraints of the caller's, and keep their own weight.
    """
    weighed = [replace(constraint, weight=min(constraint.weight * weight, MAX_WEIGHT)) for constraint in constraints]
    return tuple(constraint for constraint in weighed if constraint.weight > 0)


def _check_times(constraints: Sequence[Constraint], whole: float) -> None:
    """Refuse times behind the end of the whole, which no part would see."""
    for index, constraint in enumerate(constraints):
        latest = latest_moment(constraint)
        if latest > whole + 1e-6:
            raise InvalidInputError(f"constraints[{index}]: {latest:g} s is behind the end, at {whole:g} s")


def _untold(constraints: Sequence[Constraint], ends: Sequence[float]) -> tuple[str, ...]:
    """Tell of joints whose place on the floor is given on one axis alone, which no later part can hold."""
    return tuple(
        f"{constraint.joint} behind the first sentence: one axis of the floor alone is not held; give both, or none"
        for constraint in constraints
        if isinstance(constraint, JointTarget)
        and (constraint.position[0] is None) != (constraint.position[2] is None)
        and constraint.interval[1] >= ends[0]
        and len(ends) > 1
    )


def localised(
    constraints: Sequence[Constraint],
    span: tuple[float, float],
    whole: float,
    lead: float,
    frame: BodyFrame,
    frame_seconds: float = 0.0,
) -> tuple[Constraint, ...]:
    """Bring the constraints that fall into a part into its own frame.

    Args:
        constraints: of the whole clip.
        span: begin and end of the part, seconds of the whole clip.
        whole: seconds of the whole clip.
        lead: seconds of the part before `span` begins, which overlap with the part before.
        frame: of the part.
        frame_seconds: time of one frame: a path ends with the last frame, which begins so much before the end.
    """
    begin, end = span
    is_last = end >= whole - 1e-9
    found: list[Constraint] = []
    for constraint in constraints:
        match constraint:
            case StartPose():
                found += [constraint] if begin == 0 else []
            case EndPose():
                found += [constraint] if is_last else []
            case Path():
                piece = _piece(constraint, span, whole - frame_seconds, lead, frame)
                found += [path for path in piece if _has_frame(path, end - begin + lead, frame_seconds)]
            case JointTarget():
                found += _held(constraint, span, is_last, lead, frame)
            case Waypoint() if _is_in(constraint.seconds, span, is_last):
                heading = constraint.heading
                own = None if heading is None else heading - float(np.degrees(frame.heading))
                x, z = frame.floor_to_body(constraint.position)
                moment = constraint.seconds - begin + lead
                found.append(replace(constraint, seconds=moment, position=(float(x), float(z)), heading=own))
            case Keyframe() if _is_in(constraint.seconds, span, is_last):
                joints = frame.to_body(constraint.joints).astype(np.float32)
                found.append(replace(constraint, seconds=constraint.seconds - begin + lead, joints=joints))
            case _:
                pass
    return tuple(found)


def _is_in(moment: float, span: tuple[float, float], is_last: bool) -> bool:
    """A moment between two parts belongs to the later one."""
    return span[0] <= moment < span[1] or (is_last and moment >= span[1])


def _held(
    target: JointTarget, span: tuple[float, float], is_last: bool, lead: float, frame: BodyFrame
) -> list[Constraint]:
    """The part's share of a joint that is held at a place."""
    begin, end = target.interval
    if begin == end:
        if not _is_in(begin, span, is_last):
            return []
        moments: float | tuple[float, float] = begin - span[0] + lead
    else:
        first, last = max(begin, span[0]), min(end, span[1])
        if last <= first:
            return []
        moments = (first - span[0] + lead, last - span[0] + lead)
    position = frame.to_body([0.0 if value is None else value for value in target.position]).tolist()
    if frame.heading == 0:  # the first part has the axes of the whole
        own = [None if wanted is None else place for wanted, place in zip(target.position, position, strict=True)]
        return [replace(target, position=(own[0], own[1], own[2]), seconds=moments)]
    if target.position[0] is None or target.position[2] is None:
        # in a part that is turned, an axis of the floor that is free is no axis of the part
        free = (None, position[1], None)
        return [replace(target, position=free, seconds=moments)] if target.position[1] is not None else []
    height = None if target.position[1] is None else position[1]
    return [replace(target, position=(position[0], height, position[2]), seconds=moments)]


def _piece(path: Path, span: tuple[float, float], whole: float, lead: float, frame: BodyFrame) -> list[Path]:
    """The part's piece of a path."""
    moments = path.moments(whole)
    first, last = max(float(moments[0]), span[0]), min(float(moments[-1]), span[1])
    if last - first < 1e-6:
        return []
    inside = moments[(moments > first) & (moments < last)]
    grid = np.arange(first, last, PATH_STEP)
    times = np.unique(np.round(np.concatenate([grid, inside, [first, last]]), 6))
    heading = path.heading
    if isinstance(heading, np.ndarray):
        angles = path.headings(times, whole)
        heading = None if angles is None else np.degrees(angles - frame.heading)
    points = frame.floor_to_body(path.positions(times, whole))
    return [Path(points, times - span[0] + lead, heading, path.weight)]


def _has_frame(path: Path, length: float, frame_seconds: float) -> bool:
    """Tell whether a frame of a part of some seconds falls into its piece of a path, which may begin after the last."""
    if not frame_seconds:
        return True
    frames = round(length / frame_seconds)
    times = np.arange(frames, dtype=np.float64) * frame_seconds
    return bool(path.covers(times, (frames - 1) * frame_seconds).any())


def _fingerprint(constraint: Constraint) -> Hashable:
    """All that a constraint says, as a value that can be compared; arrays by their hash."""
    values = (getattr(constraint, field.name) for field in fields(constraint))
    return (type(constraint), *(_hashed(value) if isinstance(value, np.ndarray) else value for value in values))


def _hashed(array: np.ndarray[Any, Any]) -> Hashable:
    return (array.shape, array.dtype.str, hashlib.sha256(array.tobytes()).digest())
