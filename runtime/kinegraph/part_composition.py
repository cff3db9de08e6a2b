"""Compose sentences by parts of the body: each is sampled alone, and legs, trunk and arms are joined.

The operators of EnergyMoGen (Eq. 7-10) look for one motion in which all happens, and networks were shown few. What
moves different parts of the body needs no such search (`motion.body_parts`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from kinegraph.clip import Clip
from kinegraph.concepts import PARTS, Concept, joint_caption, validate_composition, validate_concepts
from kinegraph.diffusion.sampling import OnStep, subrange_progress
from kinegraph.errors import InvalidInputError
from kinegraph.graph import SemanticGraph
from kinegraph.motion.body_parts import choose_parts, join_parts
from kinegraph.options import GenerateOptions
from kinegraph.request import of_separate_parts
from kinegraph.validation import short_repr

if TYPE_CHECKING:
    from kinegraph.pipeline import MotionPipeline


def check_parts(concepts: object, unused: Mapping[str, object]) -> tuple[Concept, ...]:
    """Check what is composed by parts of the body.

    Args:
        concepts: sentences, graphs or `Concept`s of weight 1.
        unused: arguments of `compose` that this method has no use for, by name; None where they are not given.

    Raises:
        InvalidInputError: another weight than 1, or an argument that is for other methods.
    """
    checked = validate_concepts(concepts)
    for name, value in unused.items():
        if value is not None:
            raise InvalidInputError(f"{name} is for other methods than {PARTS!r}; leave it out, or take another method")
    for concept in checked:
        if concept.weight != 1:
            raise InvalidInputError(
                f"method {PARTS!r} weighs and negates nothing, and {short_repr(concept.caption)} has the weight "
                f"{concept.weight:g}; leave it out, or take another method"
            )
    return checked


def choose_method(
    pipe: MotionPipeline, concepts: object, given: Mapping[str, object]
) -> tuple[str, tuple[Concept, ...]]:
    """Choose how to compose where the call does not say: by parts of the body if they are different ones.

    All of them happen in every clip of a gait and gestures so, and in a half or a tenth in one run (studio 0.9.0,
    `kinegraph_benchmarks.quality.composition`).

    Args:
        pipe: the bundle.
        concepts: sentences, graphs or `Concept`s.
        given: arguments of `compose` that parts have no use for, by name; None where they are not given.

    Returns:
        "parts" where no argument is given, two concepts or more have the weight 1 each, and all but one are for hands
        and arms of their own (`request.of_separate_parts`), else "fused"; and the concepts with their graphs.

    Raises:
        InvalidInputError: see `validate_concepts`.
    """
    checked = validate_concepts(concepts)
    plain = len(checked) > 1 and all(concept.weight == 1 for concept in checked)
    if not plain or any(value is not None for value in given.values()):
        return "fused", checked
    read = tuple(replace(concept, text=pipe.as_graph(concept.text)) for concept in checked)
    return (PARTS if of_separate_parts([concept.text for concept in read]) else "fused"), read  # type: ignore[misc]


def compose_parts(
    pipe: MotionPipeline,
    concepts: Sequence[Concept],
    options: GenerateOptions,
    sampling: Mapping[str, Any],
    on_step: OnStep | None,
    *,
    own_length: bool,
    may_leave_out: bool,
) -> Clip | None:
    """Sample each concept alone, from the same seed, and join the parts of the body that each does most with.

    Args:
        pipe: the bundle.
        concepts: of `check_parts`.
        options: of the clip.
        sampling: keywords of `MotionPipeline.generate`: steps, guidance and so on.
        on_step: called after every step of every concept.
        own_length: whether the concepts tell the length of the clip, as in `MotionPipeline.compose`.
        may_leave_out: whether a concept may have no part of the body.

    Returns:
        The clip; a note tells of a concept that has no part. None if there is one, and there may not be.

    Raises:
        Cancelled, NonFiniteError: as in `MotionPipeline.generate`.
    """
    if own_length:
        spec = validate_composition(concepts, "latent", None, None, None)
        _, _, options, _ = pipe.encode_composition(spec, options, own_length=True)
    clips = [
        pipe.generate(
            concept.text,
            seconds=options.seconds,
            seed=options.seed,
            on_step=subrange_progress(on_step, index, len(concepts)),
            **sampling,
        )
        for index, concept in enumerate(concepts)
    ]
    chosen = choose_parts([clip.joints for clip in clips])
    left_out = [concept.caption for index, concept in enumerate(concepts) if index not in chosen.values()]
    if left_out and not may_leave_out:
        return None
    told = [f"{caption!r}: the others do more with every part of the body, so it is left out" for caption in left_out]
    joined, joint = join_clips(clips, chosen), joint_caption(concepts)
    text = joint.caption if isinstance(joint, SemanticGraph) else joint
    return replace(joined, text=text, graph=None, notes=tuple(dict.fromkeys((*joined.notes, *told))))


def join_clips(clips: Sequence[Clip], chosen: Mapping[str, int]) -> Clip:
    """Join the parts of the body of some clips, as `choose_parts` says, with the notes of all; else it is the first."""
    notes = tuple(dict.fromkeys(note for clip in clips for note in clip.notes))
    return replace(clips[0], joints=join_parts([clip.joints for clip in clips], chosen), notes=notes)
