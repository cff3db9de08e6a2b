"""From a sentence to a clip: the stages in order, as in GraphMotion's figure 2.

text  --parser-->   semantic graph            text/parser.py, graph.py
graph --encoder-->  conditions                conditioning.py   text encoder, graph attention (Eq. 1-3)
      --sampler-->  latents                   denoising.py      motion -> action -> specific; diffusion/
      --decoder-->  joints, feet, clip        decoding.py, motion/

Above 500 lines because all public calls are here, each with all its options and errors documented.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Hashable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from copy import copy
from dataclasses import dataclass, replace
from functools import cached_property, partial, wraps
from itertools import accumulate, pairwise
from operator import itemgetter
from pathlib import Path
from typing import TYPE_CHECKING, Any, ParamSpec, TypeVar

import onnxruntime

from kinegraph.arrays import FloatArray
from kinegraph.bundle.contract import FRAMES
from kinegraph.bundle.manifest import Manifest
from kinegraph.bundle.reader import read_bundle
from kinegraph.bundle.sessions import Sessions, open_sessions
from kinegraph.bundle.tables import bones_of
from kinegraph.bundle.vocabulary import Vocabulary
from kinegraph.clip import Clip
from kinegraph.concat_denoising import ConcatSampler
from kinegraph.concepts import AUTO, PARTS, CompositionSpec, Concept, SamplingPlan, validate_composition
from kinegraph.conditioning import ConditionEncoder, Conditions, GraphArrays, repeat_rows
from kinegraph.decoding import MotionDecoder
from kinegraph.denoising import LatentSampler, OnLatent
from kinegraph.diffusion.composition import CompositionWeights
from kinegraph.diffusion.sampling import OnStep, subrange_progress
from kinegraph.errors import InvalidGraphError, InvalidInputError, ModelError, UnknownWordsError
from kinegraph.graph import SemanticGraph
from kinegraph.interpretation import split_at_once, with_actions, with_words
from kinegraph.limits import MAX_CONCEPTS, MAX_PARTS, MAX_SHARED, MAX_TAKES
from kinegraph.motion.blending import blend_margins, stitch
from kinegraph.options import (
    LATENT,
    Deadline,
    GenerateOptions,
    Guidance,
    Steps,
    batch_seeds,
    part_seed,
    resolve_options,
    sentence_seeds,
    sequence_caption,
    validate_lengths,
    validate_sequence_method,
    with_margins,
    with_seconds,
)
from kinegraph.request import (
    AT_ONCE,
    IN_ONE_INTERVAL,
    MANY,
    MANY_AT_ONCE,
    NEVER_STOOD,
    STANDING,
    TOO_SHORT_IN_ORDER,
    TURNS_ARE_FREE,
    interpret,
    interpret_composition,
    parts_hands,
    share_frames,
    split_in_order,
)
from kinegraph.slot_conditioning import SlotEncoder
from kinegraph.text.parser import LazyParser, check_caption
from kinegraph.text.tokenizer import CaptionTokenizer
from kinegraph.text.vocabulary import find_seldom, find_slips, find_unknown
from kinegraph.unknown import Unknown, describe_unknown
from kinegraph.validation import check_callback, check_flag, short_repr

if TYPE_CHECKING:
    from kinegraph.constrained_denoising import Wanted
    from kinegraph.constraints import Constraint
    from kinegraph.intervals import Interval
    from kinegraph.part_memory import PartMemory

OnLevel = Callable[[str, Clip], None]
"""Called after a level of `contract.COARSE_DECODERS`, with its name and the clip as far as it has come."""


P = ParamSpec("P")
R = TypeVar("R")


def _with_typed_memory_errors(call: Callable[P, R]) -> Callable[P, R]:
    """Let a call raise `ModelError` where memory ends, also between the runs of models."""

    @wraps(call)
    def typed(*args: P.args, **kwargs: P.kwargs) -> R:
        try:
            return call(*args, **kwargs)
        except MemoryError as error:
            raise ModelError("memory ran out; ask for fewer or shorter clips at once") from error

    return typed


@dataclass(frozen=True)
class _EncodedPart:
    """A graph that is sampled at once, with any seed."""

    encoder: ConditionEncoder
    graph: SemanticGraph
    """As the user wrote it."""
    plan: SamplingPlan
    features: list[GraphArrays]
    """Of the plan's graphs."""
    options: GenerateOptions
    notes: tuple[str, ...]
    is_timed: bool
    """Whether the sentence says how long it takes."""
    alone: tuple[_EncodedPart, ...] = ()
    """Each of its actions told alone, where left and right hand do different things (`request.parts_hands`)."""

    @cached_property
    def conditions(self) -> Conditions:
        """Conditions of the plan's graphs; graph attention runs once for all takes."""
        return self.encoder.attend(self.features)

    def with_options(self, options: GenerateOptions) -> _EncodedPart:
        return replace(self, options=options)


@dataclass(frozen=True)
class _EncodedSentence:
    """A sentence as one part, or as parts that follow one another."""

    graph: SemanticGraph
    parts: tuple[_EncodedPart, ...]

    @property
    def notes(self) -> tuple[str, ...]:
        return tuple(dict.fromkeys(note for part in self.parts for note in part.notes))


@dataclass(frozen=True, init=False, eq=False, repr=False)
class MotionPipeline:
    """A loaded bundle. Any number of threads may share it; each call keeps its state to itself, and nothing can be set.

    A process that forks may go on to use it in the child, too.
    """

    manifest: Manifest
    """What the bundle is: licence, limits, defaults, measured quality."""
    parser: LazyParser
    """Text to graph; loaded at the first sentence."""
    vocabulary: Vocabulary | None
    """What training showed; None where the bundle does not say."""
    encoder: ConditionEncoder
    """Graphs to conditions."""
    sampler: LatentSampler
    """Conditions to latents."""
    decoder: MotionDecoder
    """Latents to clips."""

    def __init__(
        self,
        manifest: Manifest,
        sessions: Sessions,
        tokenizer: CaptionTokenizer,
        tables: Mapping[str, FloatArray],
        parser: LazyParser,
        vocabulary: Vocabulary | None = None,
    ) -> None:
        is_ours = manifest.family == "kinegraph"
        parts = {
            "manifest": manifest,
            "parser": parser,
            "vocabulary": vocabulary,
            "encoder": (ConditionEncoder if is_ours else SlotEncoder)(sessions, tokenizer, manifest, tables),
            "sampler": (LatentSampler if is_ours else ConcatSampler)(sessions, manifest),
            "decoder": MotionDecoder(sessions, manifest, bones_of(tables)),
        }
        for name, part in parts.items():
            object.__setattr__(self, name, part)  # the way around `frozen`, as dataclasses go themselves

    @classmethod
    def load(
        cls,
        path: str | Path | None = None,
        *,
        threads: int | None = None,
        session_options: onnxruntime.SessionOptions | None = None,
    ) -> MotionPipeline:
        """Read a bundle, check every byte, and make its sessions.

        Args:
            path: folder of a bundle, or the name of an installed one ("studio"); None is the default bundle. Only a
                text can be a name, and it goes before a folder of that name here: write "./studio" for the folder.
            threads: of every session; None chooses (`bundle.sessions.open_sessions`).
            session_options: the host's own onnxruntime options, instead of `threads`.

        Raises:
            BundleError: missing, altered or unusable; see its subclasses.
            InvalidInputError: `path` is none, `threads` is out of range, or `session_options` are none.
        """
        if not isinstance(path, str | os.PathLike | None):
            raise InvalidInputError(
                f"a bundle is loaded from the path of a folder or by its name, not from {short_repr(path)}"
            )
        bundle = read_bundle(path if path is None or isinstance(path, str) else Path(path))
        files = dict(bundle.files)
        bundle = replace(bundle, files={})  # so that only `files` holds the bytes, and a session's go when it is made
        sessions = open_sessions(bundle, threads=threads, options=session_options, files=files)
        tokenizer = CaptionTokenizer(files["tokenizer.json"], bundle.manifest.text.max_pieces)
        parser = LazyParser.from_files(files)
        return cls(bundle.manifest, sessions, tokenizer, bundle.tables, parser, bundle.vocabulary)

    def with_sessions(self, sessions: Sessions) -> MotionPipeline:
        """Make a pipeline that runs other sessions, with the same tokenizer, tables and parser.

        For hosts that wrap sessions: to count or time runs, or to keep what an encoder said.
        """
        encoder = self.encoder
        return MotionPipeline(self.manifest, sessions, encoder.tokenizer, encoder.tables, self.parser, self.vocabulary)

    def in_space(self, space: str) -> MotionPipeline:
        """Make a pipeline that samples in a space of `options.SPACES`: this one for "latent".

        Raises:
            InvalidInputError: no such space, or the bundle has no skeleton space.
        """
        if isinstance(space, str) and space == LATENT:
            return self
        resolve_options(self.manifest, space=space)
        from kinegraph.frame_denoising import FrameDecoder, FrameSampler

        other = copy(self)
        sessions, manifest = self.sampler.sessions, self.manifest
        object.__setattr__(other, "sampler", FrameSampler(sessions, manifest))
        object.__setattr__(other, "decoder", FrameDecoder(sessions, manifest, self.decoder.bones))
        return other

    @_with_typed_memory_errors
    def parse(self, text: str) -> SemanticGraph:
        """Parse a sentence into its semantic graph: look at it, edit it, hand it back to `generate`.

        Raises:
            InvalidInputError: blank, too long, or without a letter or digit.
            MissingExtraError: spaCy is not installed (`pip install "kinegraph[text]"`).
            BundleError: the bundle carries no parser.
        """
        check_caption(text)
        return self.parser().parse(text)

    def find_unknown(self, *texts: str | SemanticGraph, strict: bool = False) -> tuple[Unknown, ...]:
        """Find what the bundle was never shown in sentences or graphs, the same words once.

        Args:
            texts: sentences or graphs.
            strict: refuse them instead of returning.

        Returns:
            Unknown words with the known phrases nearest to them; none if the bundle has no vocabulary.

        Raises:
            UnknownWordsError: something is unknown, and `strict` is set.
            InvalidInputError: `strict` is set and the bundle has no vocabulary; also as in `parse`.
        """
        return _once_each(self._unknown_of_each(texts, strict))

    @_with_typed_memory_errors
    def generate(
        self,
        text: str | SemanticGraph,
        *,
        seconds: float | None = None,
        seed: int | None = None,
        steps: Steps | None = None,
        guidance: Guidance | None = None,
        space: str = LATENT,
        foot_fix: bool = True,
        constraints: Sequence[Constraint] | None = None,
        constraint_weight: float = 1.0,
        constraint_fix: bool = True,
        strict: bool = False,
        timeout: float | None = None,
        on_step: OnStep | None = None,
        on_level: OnLevel | None = None,
    ) -> Clip:
        """Make a clip for a sentence or a graph. The same arguments give the same clip, bit for bit.

        Negated actions ("without waving") are taken away (Eq. 8). A length in words ("for four seconds") holds where
        `seconds` is not given. Actions in order ("walks, then bows") are made one by one and joined. A turn goes as far
        as the sentence says ("by 90 degrees", "around"), and is held back where it does not say (`text.turns`,
        `motion.turning`). Where left and right hand do different things at once, each action is sampled alone, and
        their parts of the body are joined (`motion.body_parts`). What the sentence asks for and does not get stands in
        the clip's `notes`.

        Args:
            text: a sentence, or its graph; weighted edges count as `concepts.weighted_edge_terms` says.
            seconds: length; None lets the sentence decide, as far as the bundle knows how long such motions take.
            seed: of the noise, 0 to 2**63 - 1; None draws one, to be found in the clip.
            steps: diffusion steps, one number or one per level.
            guidance: guidance scale (Eq. A), one number or one per level.
            space: "latent", or "frames" for skeleton space, where the bundle has it: the motion features themselves are
                sampled (EnergyMoGen, appendix B), slower, and at one level.
            foot_fix: lock standing feet where they stand (`motion.postprocess.lock_feet`).
            constraints: what the clip has to do besides (`kinegraph.constraints`): paths, places of joints, poses. The
                clip tells how far it is from each (`Clip.misses`). Actions in order are then sampled at once. Skeleton
                space holds them at every step.
            constraint_weight: of all constraints against the text, 0 to 100; 0 is the clip without them, bit for bit.
            constraint_fix: close in the joints what the model leaves of the way (`motion.reaching`).
            strict: refuse words that the bundle was never shown (`find_unknown`), constraints that nobody can meet, and
                those missed by 5 cm; without it the clip names them.
            timeout: seconds that the call may take, checked between sentences and after every step; None is no limit.
            on_step: called after every step with a `StepInfo`; returning False stops with `Cancelled`.
            on_level: called with each coarser level and the clip as far as it has come, where the bundle can decode it;
                not for a clip made of parts.

        Raises:
            InvalidInputError: text or an option is outside what the model takes; nothing has been run.
            MissedConstraintError: a constraint was missed by 5 cm, and `strict` is set.
            UnknownWordsError: a word is unknown, and `strict` is set; nothing has been sampled.
            Cancelled: `on_step` returned False, or as `TimedOut`, the timeout is over.
            NonFiniteError: a model produced NaN or infinity.
        """
        # 1. Check the request
        deadline = check_call(timeout, on_step, on_level, strict=strict)
        options = resolve_options(
            self.manifest, seconds=seconds, seed=seed, steps=steps, guidance=guidance, foot_fix=foot_fix, space=space
        )
        pipe = self.in_space(space)
        wanted = pipe._check_constraints(constraints, constraint_weight, constraint_fix, strict=strict)
        # 2. Text -> graph; what it asks for: words, lengths, negations, weighted edges (Eq. 7, 8)
        graph = self.as_graph(text)
        unknown = self.find_unknown(graph, strict=strict)
        # 3. Text encoder and graph attention (Eq. 1-3); the sentence may tell the length
        encoded = self._encode_sentence(
            graph, options, own_length=seconds is None, is_known=not unknown, in_order=wanted is None or not wanted.acts
        )
        deadline.check()
        # 4. Motion -> action -> specific latent; 5. latents -> features -> joints -> clip
        clip = pipe._make_clip(encoded, options.seed, deadline.watch(on_step), on_level, wanted)
        return replace(clip, unknown=unknown)

    def takes(
        self,
        text: str | SemanticGraph,
        count: int,
        *,
        seconds: float | None = None,
        seed: int | None = None,
        steps: Steps | None = None,
        guidance: Guidance | None = None,
        space: str = LATENT,
        foot_fix: bool = True,
        constraints: Sequence[Constraint] | None = None,
        constraint_weight: float = 1.0,
        constraint_fix: bool = True,
        shared_run: bool = False,
        strict: bool = False,
        timeout: float | None = None,
        on_step: OnStep | None = None,
    ) -> list[Clip]:
        """Make several clips for one sentence: a `batch` of it alone, `count` takes, 1 to `limits.MAX_TAKES`."""
        return self.batch(
            [text],
            takes=count,
            seconds=seconds,
            seed=seed,
            steps=steps,
            guidance=guidance,
            space=space,
            foot_fix=foot_fix,
            constraints=constraints,
            constraint_weight=constraint_weight,
            constraint_fix=constraint_fix,
            shared_run=shared_run,
            strict=strict,
            timeout=timeout,
            on_step=on_step,
        )

    @_with_typed_memory_errors
    def batch(
        self,
        texts: Sequence[str | SemanticGraph],
        *,
        takes: int = 1,
        seconds: float | Sequence[float] | None = None,
        seed: int | None = None,
        steps: Steps | None = None,
        guidance: Guidance | None = None,
        space: str = LATENT,
        foot_fix: bool = True,
        constraints: Sequence[Constraint] | None = None,
        constraint_weight: float = 1.0,
        constraint_fix: bool = True,
        shared_run: bool = False,
        strict: bool = False,
        timeout: float | None = None,
        on_step: OnStep | None = None,
    ) -> list[Clip]:
        """Make clips for many sentences: all takes of the first, then of the second ...

        Clip k is what `generate` makes of its sentence with seed + k, bit for bit.

        Args:
            texts: sentences or graphs.
            takes: of each; `limits.MAX_TAKES` clips at most in all.
            seconds: one length, one per sentence, or None for what each asks for.
            seed, steps, guidance, space, foot_fix, strict, timeout: as in `generate`.
            constraints, constraint_weight, constraint_fix: of every clip, as in `generate`; not in a shared run.
            shared_run: let up to 32 clips share the runs of the models: faster. Sums of a larger run are rounded in
                another order, so a clip then equals that of `generate` to 0.1 mm in an fp32 bundle only; in an int8
                bundle one scale spans a run, and clips differ by `batch_mm` of the manifest's parity on average.
                Graphs must have no weighted edges and no negated actions.
            on_step: as in `generate`; its `done` and `total` are those of all clips.

        Raises:
            InvalidInputError, Cancelled, NonFiniteError: as in `generate`; also for too many clips, and for weights in
                a shared run.
        """
        deadline = check_call(timeout, on_step, strict=strict, shared_run=shared_run)
        on_step = deadline.watch(on_step)
        pipe = self.in_space(space)
        wanted = pipe._check_constraints(constraints, constraint_weight, constraint_fix, strict=strict)
        if shared_run and wanted is not None:
            raise InvalidInputError("clips that share one run cannot have constraints; leave out shared_run")
        lengths = validate_lengths(texts, seconds, MAX_TAKES, "a batch")
        options = self._resolve_each(lengths, seed=seed, steps=steps, guidance=guidance, foot_fix=foot_fix, space=space)
        seeds = batch_seeds(options[0].seed, len(options), takes)
        graphs = [self.as_graph(text) for text in deadline.each(texts)]
        unknown = self._unknown_of_each(graphs, strict)
        sentences = [
            self._encode_sentence(
                graph, option, own_length=length is None, is_known=not words, in_order=wanted is None or not wanted.acts
            )
            for graph, option, length, words in deadline.each(zip(graphs, options, lengths, unknown, strict=True))
        ]
        if shared_run:
            clips = pipe._make_together(sentences, seeds, takes, on_step)
        else:
            clips = [
                pipe._make_clip(
                    sentences[index // takes], value, subrange_progress(on_step, index, len(seeds)), wanted=wanted
                )
                for index, value in enumerate(seeds)
            ]
        return [replace(clip, unknown=unknown[index // takes]) for index, clip in enumerate(clips)]

    @_with_typed_memory_errors
    def sequence(
        self,
        texts: Sequence[str | SemanticGraph],
        *,
        method: str = "blend",
        seconds: float | Sequence[float] | None = None,
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
        """Make one clip of several sentences, one after another.

        Args:
            texts: 1 to `limits.MAX_PARTS` sentences or graphs; sentence k is generated with seed + seed_offsets[k].
            method: "blend" makes parts by themselves, longer by what blends at their ends need, and blends them where
                poses are alike (`motion.blending`); a part keeps its length to 0.5 s. "continue" begins each part in
                the last pose of the one before, as `stream` does: nothing is blended, and a part has its length to the
                frame, but at most 0.2 s less than the longest clip. It takes four times as long, and its joins are less
                calm (measured). "energy" samples all parts in one run of skeleton space, where the bundle has it:
                neighbours share 0.8 s, and their scores add up there (EnergyMoGen, Eq. 11); it takes neither a memory
                nor seed offsets, and holds no turn to what a sentence says.
            seconds: of each part: one length, one per sentence, or None for what each asks for.
            seed, steps, guidance, foot_fix, strict, timeout: as in `generate`.
            seed_offsets: one for each sentence; None is 0, 1, 2 ... What keeps its own is not changed by others.
            on_step: as in `generate`; its `done` and `total` are those of all parts.
            memory: parts that were made before, and need not be made again.

        Raises:
            InvalidInputError, Cancelled, NonFiniteError: as in `generate`; also for a bundle without what a method
                needs: gradients of its decoders, or skeleton space.
        """
        deadline = check_call(timeout, on_step, strict=strict)
        method = validate_sequence_method(method)
        if memory is not None:
            from kinegraph.part_memory import check_memory

            check_memory(memory).begin()
        for name, value in (("memory", memory), ("seed_offsets", seed_offsets)):
            if method == "energy" and value is not None:
                raise InvalidInputError(
                    f'{name} is for parts that are made one by one; method "energy" makes all at once, of one noise'
                )
        on_step = deadline.watch(on_step)
        lengths = validate_lengths(texts, seconds, MAX_PARTS, "a sequence")
        if method == "continue":
            from kinegraph.constrained_denoising import require_gradients

            require_gradients(self.sampler)
        pipe = self.in_space(FRAMES if method == "energy" else LATENT)
        options = self._resolve_each(
            lengths, seed=seed, steps=steps, guidance=guidance, foot_fix=foot_fix, space=pipe.sampler.space
        )
        graphs = [self.as_graph(text) for text in deadline.each(texts)]
        unknown_of_each = self._unknown_of_each(graphs, strict)
        unknown = _once_each(unknown_of_each)
        seeds = sentence_seeds(options[0].seed, len(texts), seed_offsets)
        sentences = [
            self._encode_sentence(graph, option, own_length=length is None, is_known=not words)
            for graph, option, length, words in deadline.each(
                zip(graphs, options, lengths, unknown_of_each, strict=True)
            )
        ]
        notes = tuple(dict.fromkeys(note for sentence in sentences for note in sentence.notes))
        if len(sentences) == 1 and (method == "blend" or len(sentences[0].parts) == 1):
            return replace(pipe._make_clip(sentences[0], seeds[0], on_step), unknown=unknown, seed=options[0].seed)
        parts = [
            (part, part_seed(sentence_seed, index))
            for sentence, sentence_seed in zip(sentences, seeds, strict=True)
            for index, part in enumerate(sentence.parts)
        ]
        of_sentence = [index for index, sentence in enumerate(sentences) for _ in sentence.parts]
        text = sequence_caption([graph.caption for graph in graphs])
        if method == "energy":
            clip = pipe._energy_parts(parts, on_step)
        else:
            make_parts = self._continue_parts if method == "continue" else self._make_parts
            clip = make_parts(parts, on_step, memory, of_sentence)
        notes = tuple(dict.fromkeys((*notes, *clip.notes)))
        graph = graphs[0] if len(graphs) == 1 else None
        return replace(clip, text=text, graph=graph, unknown=unknown, notes=notes, seed=options[0].seed)

    @_with_typed_memory_errors
    def compose(
        self,
        concepts: Sequence[Concept | str | SemanticGraph],
        *,
        method: str = AUTO,
        text: str | SemanticGraph | None = None,
        lambdas: tuple[float, float, float] | None = None,
        agd: tuple[float, float] | None = None,
        seconds: float | None = None,
        seed: int | None = None,
        steps: Steps | None = None,
        guidance: Guidance | None = None,
        space: str = LATENT,
        foot_fix: bool = True,
        constraints: Sequence[Constraint] | None = None,
        constraint_weight: float = 1.0,
        constraint_fix: bool = True,
        strict: bool = False,
        timeout: float | None = None,
        on_step: OnStep | None = None,
        on_level: OnLevel | None = None,
    ) -> Clip:
        """Make a clip in which several motions happen at once, or do not (EnergyMoGen, Eq. 3, 4, 7-10).

        Args:
            concepts: up to 8, each a part of what happens (`conditioning.as_partial`), unless only one is positive. A
                negative weight is what must not happen. It takes what both have in common, too:
                -0.5 beside something alike ("walks", not "runs"), -1 against an action that the rest names.
            method: "latent" adds predictions (Eq. 7, 8), "semantic" averages attention (Eq. 9), "fused" blends both
                with the joint text (Eq. 10) and takes away what is negated (Eq. 8). "parts" samples each concept alone
                and joins legs, trunk and arms of those that do most with them (`part_composition`): surest where they
                move different parts of the body. It takes weights of 1 alone, no text, lambdas, agd or constraints,
                and calls no on_level. "auto" is "parts" where that is so: nothing of these is given, and all concepts
                but one are of hands and arms, each of its own ("walks", "raises the left hand", "waves the right
                hand"), and each does most with a part of the body; else "fused".
            text: the joint text of "fused"; None joins the positive concepts with "while".
            lambdas: of "fused": shares of latent, semantic and joint text; default (0.3, 0.3, 0.4).
            agd: step sizes (gamma_attn, gamma_reg) of adaptive gradient descent (Eq. 3, 4), each 0 to 1: EnergyMoGen
                has (0.0004, 0.0004) for several concepts and (0.001, 0.002) for one sentence of several. With the
                default bundle nothing up to (0.01, 0.01) is told from chance, and (0.1, 0.1) spoils it. None is off.
            seconds, seed, steps, guidance, space, foot_fix, constraints, constraint_weight, constraint_fix, strict,
                timeout, on_step, on_level: as in `generate`; negated concepts count for `strict`, too.

        Raises:
            InvalidInputError: a concept, weight or option is outside what can be composed, or the bundle has no
                graphs for `agd`; nothing has been run.
            Cancelled, NonFiniteError: as in `generate`.
        """
        deadline = check_call(timeout, on_step, on_level, strict=strict)
        is_held = constraints is not None and not (isinstance(constraints, list | tuple) and not constraints)
        unused = {"text": text, "lambdas": lambdas, "agd": agd, "constraints": constraints if is_held else None}
        is_auto = isinstance(method, str) and method == AUTO
        if is_auto:
            from kinegraph.part_composition import choose_method

            method, concepts = choose_method(self, concepts, unused)
        if isinstance(method, str) and method == PARTS:
            from kinegraph.part_composition import check_parts, compose_parts

            checked = [replace(each, text=self.as_graph(each.text)) for each in check_parts(concepts, unused)]
            unknown = self.find_unknown(*(concept.text for concept in checked), strict=strict)
            sampling: dict[str, Any] = {"steps": steps, "guidance": guidance, "foot_fix": foot_fix, "space": space}
            options = resolve_options(self.manifest, seconds=seconds, seed=seed, **sampling)
            own_length, watch = seconds is None, deadline.watch(on_step)
            made = compose_parts(
                self, checked, options, sampling, watch, own_length=own_length, may_leave_out=not is_auto
            )
            if made is not None:
                return replace(made, unknown=unknown)
            method, seed = "fused", options.seed  # a concept has no part of its own: all in one run
        spec = validate_composition(concepts, method, text, lambdas, agd)
        options = resolve_options(
            self.manifest, seconds=seconds, seed=seed, steps=steps, guidance=guidance, foot_fix=foot_fix, space=space
        )
        pipe = self.in_space(space)
        wanted = pipe._check_constraints(constraints, constraint_weight, constraint_fix, strict=strict)
        named = [concept.text for concept in (*spec.concepts, *spec.negated)]
        unknown = self.find_unknown(*named, *([] if text is None else [text]), strict=strict)
        conditions, plan, options, notes = pipe.encode_composition(spec, options, own_length=seconds is None)
        deadline.check()
        caption = spec.joint.caption if isinstance(spec.joint, SemanticGraph) else spec.joint
        on_latent = self._on_latent(on_level, options, caption)
        notes = tuple(dict.fromkeys((*notes, *(note for graph in plan.graphs for note in self._notes_of(graph)))))
        notes += (MANY_AT_ONCE,) if len(spec.concepts) >= MANY else ()
        watch = deadline.watch(on_step)
        clip = pipe._decode_sample(conditions, plan.weights, options, caption, wanted, watch, on_latent)
        return replace(clip, unknown=unknown, notes=(*notes, *clip.notes))

    @_with_typed_memory_errors
    def timeline(
        self,
        intervals: Sequence[Interval],
        *,
        overlap: float | None = None,
        seed: int | None = None,
        steps: Steps | None = None,
        guidance: Guidance | None = None,
        space: str = LATENT,
        foot_fix: bool = True,
        constraints: Sequence[Constraint] | None = None,
        constraint_weight: float = 1.0,
        constraint_fix: bool = True,
        strict: bool = False,
        timeout: float | None = None,
        on_step: OnStep | None = None,
    ) -> Clip:
        """Make one clip of texts that each hold from one moment to another (STMC's timelines; EnergyMoGen, Eq. 11).

        In skeleton space, intervals overlap as they like, for the whole body or for parts of it: all are denoised in
        one run, each on its own frames. In latent space, texts that begin and end together are composed (Eq. 7-10),
        and what follows one another is joined as in `sequence`.

        Args:
            intervals: in any order; something happens at every moment from 0 on. `intervals.read_intervals` reads a
                file.
            overlap: seconds that intervals which follow one another share, half on either side; None is 0.8. Of
                skeleton space alone.
            constraints: what the whole has to do besides, in skeleton space.
            seed, steps, guidance, space, foot_fix, constraint_weight, constraint_fix, strict, timeout, on_step: as in
                `generate`.

        Raises:
            InvalidInputError, Cancelled, NonFiniteError: as in `generate`; also intervals that are too short or
                too long for the model, or intervals and constraints that latent space cannot take.
        """
        from kinegraph.intervals import check_intervals

        deadline = check_call(timeout, on_step, strict=strict)
        timeline = check_intervals(intervals)
        pipe = self.in_space(space)
        most = round(max(each.end for each in timeline) * self.manifest.fps)
        wanted = pipe._check_constraints(constraints, constraint_weight, constraint_fix, strict=strict, most=most)
        if wanted is not None and space == LATENT:
            raise InvalidInputError(
                'constraints on intervals are for space="frames"; in latent space give them to `generate`, or to '
                "`kinegraph.timeline.generate_timeline` for sentences one after another"
            )
        options = self._resolve_each(
            [each.end - each.start for each in timeline],
            seed=seed,
            steps=steps,
            guidance=guidance,
            foot_fix=foot_fix,
            space=space,
        )
        graphs = [self.as_graph(each.text) for each in deadline.each(timeline)]
        unknown = self._unknown_of_each(graphs, strict)
        if len(timeline) == 1 and not timeline[0].parts and overlap is None:
            in_order = wanted is None or not wanted.acts
            sentence = self._encode_sentence(
                graphs[0], options[0], own_length=False, is_known=not unknown[0], in_order=in_order
            )
            clip = pipe._make_clip(sentence, options[0].seed, deadline.watch(on_step), wanted=wanted)
            return replace(clip, unknown=unknown[0])
        parts = [
            self._encode_part(graph, option, own_length=False, is_known=not words)
            for graph, option, words in deadline.each(zip(graphs, options, unknown, strict=True))
        ]
        clip = pipe._make_timeline(timeline, parts, options[0].seed, overlap, deadline.watch(on_step), wanted)
        in_order = any(len(split_in_order(part.graph)) > 1 for part in parts)
        told = (*(note for part in parts for note in part.notes), *([IN_ONE_INTERVAL] if in_order else []))
        notes = tuple(dict.fromkeys([*told, *clip.notes]))
        text = "; ".join(each.caption for each in timeline)
        return replace(clip, text=text, unknown=_once_each(unknown), notes=notes)

    @_with_typed_memory_errors
    def edit(
        self,
        clip: Clip,
        text: str | SemanticGraph,
        *,
        keep: Sequence[str | tuple[float, float]] | str | tuple[float, float],
        strength: float = 1.0,
        seed: int | None = None,
        steps: Steps | None = None,
        guidance: Guidance | None = None,
        space: str = LATENT,
        foot_fix: bool = True,
        constraints: Sequence[Constraint] | None = None,
        constraint_weight: float = 1.0,
        constraint_fix: bool = True,
        strict: bool = False,
        timeout: float | None = None,
        on_step: OnStep | None = None,
    ) -> Clip:
        """Keep a part of a clip, and let a sentence make the rest anew.

        What is kept pulls like a constraint, or in skeleton space is held at every step; the last of `Clip.misses`
        tells how far it moved.

        Args:
            clip: to edit, 0.8 to 9.8 s with the default bundle; the result has its length.
            text: what happens in the rest.
            keep: parts of the body (`keeping.PARTS`: "legs", "left arm" ...), over the whole clip, and spans (begin,
                end) of seconds, in which the whole body is kept. Legs stay where they are in the world, arms, head and
                torso relative to the pelvis.
            strength: share of the steps of the finest level that are taken, above 0 to 1. Below 1 they begin at the
                clip with noise added (SDEdit), so that more of it stays; 1 begins at pure noise.
            seed, steps, guidance, space, foot_fix, constraints, constraint_weight, constraint_fix, strict, timeout,
                on_step: as in `generate`.

        Raises:
            InvalidInputError: as in `generate`; also for a clip that is too long, nothing to keep or nothing to change,
                or a bundle without an encoder, which latent space needs.
            Cancelled, NonFiniteError: as in `generate`.
        """
        from kinegraph.clip_editing import check_edit

        deadline = check_call(timeout, on_step, strict=strict)
        pipe = self.in_space(space)
        wanted = pipe._check_wanted(constraints, constraint_weight, constraint_fix, strict=strict)
        wanted, seconds = check_edit(clip, keep, strength, wanted, pipe.sampler)
        options = resolve_options(
            self.manifest,
            seconds=seconds,
            seed=seed,
            steps=steps,
            guidance=guidance,
            foot_fix=foot_fix,
            space=space,
        )
        graph = self.as_graph(text)
        unknown = self.find_unknown(graph, strict=strict)
        encoded = self._encode_sentence(graph, options, own_length=False, is_known=not unknown, in_order=False)
        deadline.check()
        return replace(pipe._make_clip(encoded, options.seed, deadline.watch(on_step), wanted=wanted), unknown=unknown)

    def inbetween(
        self,
        start: Clip | FloatArray,
        end: Clip | FloatArray,
        seconds: float,
        text: str | SemanticGraph,
        *,
        placed: bool = False,
        seed: int | None = None,
        steps: Steps | None = None,
        guidance: Guidance | None = None,
        space: str = LATENT,
        foot_fix: bool = True,
        constraints: Sequence[Constraint] | None = None,
        constraint_weight: float = 1.0,
        constraint_fix: bool = True,
        strict: bool = False,
        timeout: float | None = None,
        on_step: OnStep | None = None,
    ) -> Clip:
        """Make the motion between two poses: `generate` with a `StartPose` and an `EndPose`.

        With `space="frames"` they are held at every step, see `generate`.

        Args:
            start: a clip, of which the end counts, or joints (22, 3) or (frames, 22, 3), metres.
            end: a clip, of which the start counts, or joints.
            seconds: of the clip.
            text: what happens.
            placed: let the end be where it is relative to the start; False is anywhere on the floor.
            constraints: further ones.
            seed, steps, guidance, space, foot_fix, constraint_weight, constraint_fix, strict, timeout, on_step: as in
                `generate`.

        Raises:
            InvalidInputError, Cancelled, NonFiniteError: as in `generate`.
        """
        from kinegraph.clip_editing import between

        resolve_options(self.manifest, seconds=seconds)
        ends = between(start, end, seconds, self.manifest.fps, placed=check_flag(placed, "placed"))
        if not isinstance(constraints, list | tuple | None):
            raise InvalidInputError(f"constraints is a list or None, not {short_repr(constraints)}")
        return self.generate(
            text,
            seconds=seconds,
            seed=seed,
            steps=steps,
            guidance=guidance,
            space=space,
            foot_fix=foot_fix,
            constraints=[*ends, *(constraints or ())],
            constraint_weight=constraint_weight,
            constraint_fix=constraint_fix,
            strict=strict,
            timeout=timeout,
            on_step=on_step,
        )

    def stream(
        self,
        texts: Iterable[str | SemanticGraph],
        *,
        seconds: float | None = None,
        seed: int | None = None,
        steps: Steps | None = None,
        guidance: Guidance | None = None,
        space: str = LATENT,
        foot_fix: bool = True,
        strict: bool = False,
        timeout: float | None = None,
        on_step: OnStep | None = None,
    ) -> Iterator[FloatArray]:
        """Yield frame after frame of one sentence after another, each from the last pose of the one before.

        Nothing is cut or blended, and memory stays flat, however long it runs.

        Args:
            texts: sentences or graphs; `itertools.cycle` makes them endless.
            seconds: of each part, to the frame, but at most 0.2 s less than the longest clip behind the first. None
                lets each sentence decide; parts behind the first are then 0.2 s shorter, for they begin in what is
                shown.
            seed: part k is generated with seed + k; None draws one.
            steps, guidance, space, foot_fix, strict, on_step: as in `generate`.
            timeout: seconds that each part may take.

        Yields:
            Joints (22, 3) metres of each frame, in one world; `manifest.fps` of them a second.

        Raises:
            InvalidInputError, Cancelled, NonFiniteError: as in `generate`, when the part is due.
        """
        from kinegraph.clip_editing import stream_frames

        try:
            parts = None if isinstance(texts, str | bytes | SemanticGraph) else iter(texts)
        except TypeError:
            parts = None
        if parts is None:
            raise InvalidInputError("a stream takes sentences one after another, such as a list")
        first = resolve_options(self.manifest, seconds=seconds, seed=seed).seed
        options: dict[str, Any] = {
            "steps": steps,
            "guidance": guidance,
            "space": space,
            "foot_fix": foot_fix,
            "strict": strict,
            "timeout": timeout,
            "on_step": on_step,
        }
        return stream_frames(self, parts, seconds=seconds, seed=first, options=options)

    def encode_composition(
        self, spec: CompositionSpec, options: GenerateOptions, *, own_length: bool
    ) -> tuple[Conditions, SamplingPlan, GenerateOptions, tuple[str, ...]]:
        """Parse, interpret and encode what is composed.

        Args:
            spec: what is composed.
            options: of the clip.
            own_length: whether the concepts tell the length of the clip.

        Returns:
            Conditions in the order of the plan's weights, the plan, the options with the length, and what the sentences
            ask for and do not get.

        Raises:
            InvalidInputError: the networks of the bundle cannot compute a term.
        """
        plan, features, options, notes = self._plan_composition(spec, options, own_length=own_length)
        return self.encoder.attend(features), plan, options, notes

    def _plan_composition(
        self, spec: CompositionSpec, options: GenerateOptions, *, own_length: bool
    ) -> tuple[SamplingPlan, list[GraphArrays], GenerateOptions, tuple[str, ...]]:
        """Parse and interpret what is composed, see `encode_composition`; its features are not yet attended."""
        self.sampler.validate_composition(spec.lambdas, spec.agd)
        read = [self._spelled(self.as_graph(text)) for text in spec.texts]
        graphs, slips = [graph for graph, _ in read], [slip for _, told in read for slip in told]
        said = None if own_length else options.seconds
        asked = interpret_composition(spec, graphs, self.manifest, self.vocabulary, said)
        plan = SamplingPlan.for_composition(asked.spec, asked.graphs)
        if asked.seconds is not None:
            options = with_seconds(options, self.manifest, asked.seconds)
        options = replace(options, turn=asked.turn)
        features, options = self._encode(plan, options, own_length=own_length and asked.seconds is None)
        return plan, features, options, tuple(dict.fromkeys((*slips, *asked.notes)))

    def _spelled(self, graph: SemanticGraph) -> tuple[SemanticGraph, tuple[str, ...]]:
        """Spell the words of a graph as they are read, and tell which were not: "rusn" is "runs"."""
        slips = {} if self.vocabulary is None else find_slips(graph, self.vocabulary, self.encoder)
        try:
            spelled = with_words(graph, slips) if slips else graph
        except InvalidGraphError:  # no room for a longer word
            return graph, ()
        return spelled, tuple(
            f"{graph.caption[start:end]!r} is read as {word!r}" for (start, end), word in slips.items()
        )

    def as_graph(self, text: str | SemanticGraph) -> SemanticGraph:
        """Return a graph as it is, and parse a sentence."""
        return text if isinstance(text, SemanticGraph) else self.parse(text)

    def _resolve_each(self, lengths: Iterable[float | None], **sampling: Any) -> list[GenerateOptions]:
        """Resolve the options of sentences that differ in length alone; `sampling` goes to `resolve_options`."""
        return [resolve_options(self.manifest, seconds=length, **sampling) for length in lengths]

    def _unknown_spans(self, graph: SemanticGraph, vocabulary: Vocabulary) -> list[Unknown]:
        spans = list(find_unknown(graph, vocabulary, self.encoder))
        if all(action.negated for action in graph.actions):  # what is left is to stand still, if that is known
            first = graph.actions[0]
            standing = find_unknown(STANDING, vocabulary, self.encoder)[:1]
            spans += [replace(span, text=first.text, start=first.start, end=first.end) for span in standing]
        return spans

    def _unknown_of_each(self, texts: Sequence[str | SemanticGraph], strict: bool) -> list[tuple[Unknown, ...]]:
        """Find what is unknown in each text; with `strict`, refuse all of them together. See `find_unknown`."""
        if self.vocabulary is None:
            if strict:
                raise InvalidInputError(
                    f"strict needs a bundle that knows what it was shown, and {self.manifest.name!r} has no "
                    "vocabulary.npz; leave out strict, or add it: python -m kinegraph_export.vocabulary"
                )
            return [()] * len(texts)
        of_each = [_once_each([self._unknown_spans(self.as_graph(text), self.vocabulary)]) for text in texts]
        unknown = _once_each(of_each)
        if unknown and strict:
            raise UnknownWordsError(
                f"not known: {describe_unknown(unknown)}; say it in known words (`kinegraph info --words` lists them), "
                "or leave out strict to take what comes nearest",
                unknown,
            )
        return of_each

    def _notes_of(self, graph: SemanticGraph) -> tuple[str, ...]:
        """Tell what the networks have no room for, and what of a graph seldom comes out as asked."""
        seldom = () if self.vocabulary is None else find_seldom(graph, self.vocabulary)
        return (*self.encoder.left_out(graph), *seldom)

    def _encode(
        self, plan: SamplingPlan, options: GenerateOptions, *, own_length: bool
    ) -> tuple[list[GraphArrays], GenerateOptions]:
        """Encode the text of a plan; the sentences may tell the length."""
        features = self.encoder.encode_text(plan.graphs, plan.partial)
        if own_length:
            options = self.encoder.with_length(options, [features[index] for index in plan.length_from])
        return features, options

    def _encode_part(
        self, graph: SemanticGraph, options: GenerateOptions, *, own_length: bool, is_known: bool
    ) -> _EncodedPart:
        """Interpret and encode a graph that is sampled at once.

        The length of what is not known is a guess, and at most the default length.
        """
        spelled, slips = self._spelled(graph)
        request = interpret(spelled, self.manifest, self.vocabulary, None if own_length else options.seconds)
        if request.wanted == STANDING and self.find_unknown(STANDING):
            request = replace(request, negated=(), notes=(*request.notes, NEVER_STOOD))
        if request.seconds is not None:
            options = with_seconds(options, self.manifest, request.seconds)
        plan = request.plan
        features, sized = self._encode(plan, options, own_length=own_length and request.seconds is None)
        if not is_known and sized.frames > options.frames:
            sized = options
        sized = replace(sized, turn=request.turn)
        notes = (*slips, *request.notes, *self._notes_of(request.wanted))
        return _EncodedPart(self.encoder, graph, plan, features, sized, notes, request.is_timed)

    def _encode_sentence(
        self, graph: SemanticGraph, options: GenerateOptions, *, own_length: bool, is_known: bool, in_order: bool = True
    ) -> _EncodedSentence:
        """Interpret and encode a sentence, whole or in parts that follow one another."""
        whole = self._encode_part(graph, options, own_length=own_length, is_known=is_known)
        graphs = split_in_order(graph)
        is_short = whole.options.frames < self.manifest.frames.min * len(graphs)
        if len(graphs) > 1 and (not in_order or (is_short and not own_length)):
            note = TOO_SHORT_IN_ORDER if in_order else AT_ONCE
            return _EncodedSentence(graph, (replace(whole, notes=(*whole.notes, note)),))
        if len(graphs) == 1:
            return _EncodedSentence(graph, (self._with_each_alone(whole) if in_order else whole,))
        parts = [
            self._with_each_alone(self._encode_part(part, options, own_length=True, is_known=is_known))
            for part in graphs
        ]
        is_free = own_length and (whole.is_timed or is_short)  # the lengths in words are those of the parts
        total = sum(part.options.frames for part in parts) if is_free else whole.options.frames
        shares = share_frames(total, [part.options for part in parts], self.manifest)
        return _EncodedSentence(graph, tuple(map(_EncodedPart.with_options, parts, shares)))

    def _with_each_alone(self, part: _EncodedPart) -> _EncodedPart:
        """Encode each action alone, too, where left and right hand do different things; nothing weighted or negated."""
        if not parts_hands(part.graph) or not part.plan.is_plain or len(part.graph.actions) > MAX_CONCEPTS:
            return part
        told: list[SemanticGraph] = []
        with suppress(InvalidGraphError):  # near the longest caption there is no room for who does it
            told = split_at_once(part.graph)
        alone = [self._encode_part(graph, part.options, own_length=False, is_known=True) for graph in told]
        return replace(part, alone=tuple(alone))

    def _make_clip(
        self,
        sentence: _EncodedSentence,
        seed: int,
        on_step: OnStep | None = None,
        on_level: OnLevel | None = None,
        wanted: Wanted | None = None,
    ) -> Clip:
        """Sample and decode an encoded sentence."""
        if wanted is not None and not wanted.acts and wanted.kept is None:
            return self._make_untouched(sentence, seed, on_step, on_level, wanted)
        if len(sentence.parts) > 1:
            seeded = [(part, part_seed(seed, index)) for index, part in enumerate(sentence.parts)]
            clip = replace(self._make_parts(seeded, on_step), text=sentence.graph.caption)
        else:
            (part,) = sentence.parts
            on_latent = self._on_latent(on_level, part.options, sentence.graph.caption)
            clip = self._sample(part, seed, on_step, on_latent, wanted)
        return replace(clip, graph=sentence.graph, notes=(*sentence.notes, *clip.notes))

    def _make_untouched(
        self, sentence: _EncodedSentence, seed: int, on_step: OnStep | None, on_level: OnLevel | None, wanted: Wanted
    ) -> Clip:
        """Make the clip without constraints that all weigh nothing, and tell how far it is from them."""
        fitting = wanted.for_clip(sum(part.options.frames for part in sentence.parts), self.manifest.fps)
        clip = self._make_clip(sentence, seed, on_step, on_level)
        return replace(clip, misses=fitting.misses(clip.joints, self.manifest.fps), notes=(*clip.notes, *fitting.notes))

    def _make_parts(
        self,
        parts: Sequence[tuple[_EncodedPart, int]],
        on_step: OnStep | None,
        memory: PartMemory | None = None,
        of_sentence: Sequence[int] = (),
    ) -> Clip:
        """Sample parts, each with its seed and as much longer as the blends need, and stitch them.

        A memory gives back those that it has; `of_sentence` tells to which sentence each part belongs.
        """
        alone = [part for part, _ in parts]
        leads, longer = self._with_margins(alone)
        clips = []
        for index, (sized, (_, seed)) in enumerate(zip(longer, parts, strict=True)):
            make = partial(self._sample, sized, seed, subrange_progress(on_step, index, len(parts)))
            clips.append(make() if memory is None else memory.part(of_sentence[index], _key(self, sized, seed), make))
        return self._stitch(clips, leads, alone)

    def _with_margins(self, parts: Sequence[_EncodedPart]) -> tuple[list[int], list[_EncodedPart]]:
        """Make parts that follow one another longer by what their blends need; returns the frames before each, too."""
        leads, longer = [], []
        for index, part in enumerate(parts):
            before, after = blend_margins(self.manifest.fps, first=index == 0, last=index == len(parts) - 1)
            lead, options = with_margins(part.options, self.manifest, before, after)
            leads.append(lead)
            longer.append(part.with_options(replace(options, shown=(lead, lead + part.options.frames))))
        return leads, longer

    def _stitch(self, clips: Sequence[Clip], leads: Sequence[int], parts: Sequence[_EncodedPart]) -> Clip:
        """Join the clips of parts as `_with_margins` made them longer."""
        lengths, foot_fix = [part.options.frames for part in parts], parts[0].options.foot_fix
        joints = stitch(
            [clip.joints for clip in clips], self.manifest.fps, leads=leads, lengths=lengths, foot_fix=foot_fix
        )
        notes = tuple(note for clip in clips for note in clip.notes)
        return replace(clips[0], joints=joints, graph=None, notes=notes)

    def _continue_parts(
        self,
        parts: Sequence[tuple[_EncodedPart, int]],
        on_step: OnStep | None,
        memory: PartMemory | None = None,
        of_sentence: Sequence[int] = (),
    ) -> Clip:
        """Sample parts, each with its seed and from the last frames of the one before; see `_make_parts`."""
        from kinegraph.constraints import pose_frames
        from kinegraph.motion.body_frame import append_part

        overlap = pose_frames(self.manifest.fps)
        clips: list[Clip] = []
        joints: FloatArray | None = None
        for index, (part, seed) in enumerate(parts):
            begin = None if joints is None else joints[-overlap:]
            _, options = with_margins(part.options, self.manifest, 0 if joints is None else overlap, 0)
            sized, progress = part.with_options(options), subrange_progress(on_step, index, len(parts))
            make = partial(self._sample_from, begin, sized, seed, progress)
            key = _key(self, sized, seed, b"" if begin is None else begin.tobytes())
            clips.append(make() if memory is None else memory.part(of_sentence[index], key, make))
            joints = clips[-1].joints if joints is None else append_part(joints, clips[-1].joints, overlap)
        assert joints is not None
        notes = tuple(note for clip in clips for note in clip.notes)
        return replace(clips[0], joints=joints, graph=None, notes=notes, misses=())

    def _sample_from(self, begin: FloatArray | None, part: _EncodedPart, seed: int, on_step: OnStep | None) -> Clip:
        """Sample a part that begins in frames (n, 22, 3), if any; see `_sample`."""
        from kinegraph.clip_editing import begin_in

        wanted = None if begin is None else begin_in(begin, self.sampler)
        return self._sample(part, seed, on_step, wanted=wanted)

    def _energy_parts(self, parts: Sequence[tuple[_EncodedPart, int]], on_step: OnStep | None) -> Clip:
        """Sample parts in one run of skeleton space, from the noise of the first seed (EnergyMoGen, Eq. 11)."""
        from kinegraph.intervals import Interval

        ends = [0.0, *accumulate(part.options.seconds for part, _ in parts)]
        timeline = [
            Interval(part.graph, start, end) for (part, _), (start, end) in zip(parts, pairwise(ends), strict=True)
        ]
        return self._make_timeline(timeline, [part for part, _ in parts], parts[0][1], None, on_step)

    def _sample(
        self,
        part: _EncodedPart,
        seed: int,
        on_step: OnStep | None = None,
        on_latent: OnLatent | None = None,
        wanted: Wanted | None = None,
    ) -> Clip:
        """Sample latents for one graph and decode them; what each hand does alone, where that will do."""
        if part.alone and wanted is None:
            joined = self._sample_each_alone(part, seed, on_step)
            if joined is not None:
                return joined
        weights = None if part.plan.is_plain else part.plan.weights
        options = replace(part.options, seed=seed)
        caption = part.graph.caption
        clip = self._decode_sample(part.conditions, weights, options, caption, wanted, on_step, on_latent)
        many = (MANY_AT_ONCE,) if parts_hands(part.graph) else ()
        return replace(clip, graph=part.graph, notes=(*clip.notes, *many))

    def _sample_each_alone(self, part: _EncodedPart, seed: int, on_step: OnStep | None) -> Clip | None:
        """Sample the actions of a part alone, and join their parts of the body.

        What has no part of the body is sampled together with what has the legs ("walks and turns left"). None where
        that leaves nothing to join.
        """
        from kinegraph.motion.body_parts import LEGS, choose_parts
        from kinegraph.part_composition import join_clips

        def sample(each: _EncodedPart, number: int) -> Clip:
            options = replace(part.options, turn=each.options.turn)
            return self._sample(each.with_options(options), seed, subrange_progress(on_step, number, count))

        count = len(part.alone)
        clips = [sample(each, number) for number, each in enumerate(part.alone)]
        chosen = choose_parts([clip.joints for clip in clips])
        if set(chosen.values()) != set(range(count)):
            together = {chosen[LEGS], *(index for index in range(count) if index not in chosen.values())}
            graph: SemanticGraph | None = None
            with suppress(InvalidGraphError):  # no action is left of the words
                graph = None if len(together) == count else with_actions(part.graph, together)
            if graph is None:
                return None
            legs = self._encode_part(graph, part.options, own_length=False, is_known=True)
            clips = [sample(legs, count - 1), *(clips[index] for index in range(count) if index not in together)]
            chosen = choose_parts([clip.joints for clip in clips])
            if set(chosen.values()) != set(range(len(clips))):
                return None
        return replace(join_clips(clips, chosen), text=part.graph.caption, graph=part.graph)

    def _decode_sample(
        self,
        conditions: Conditions,
        weights: CompositionWeights | None,
        options: GenerateOptions,
        caption: str,
        wanted: Wanted | None,
        on_step: OnStep | None,
        on_latent: OnLatent | None,
    ) -> Clip:
        """Sample one clip and decode it, under constraints if there are any."""
        if wanted is None:
            latents = self.sampler.sample(conditions, weights, [options], on_step, on_latent)
            return self.decoder.decode(latents, [options], [caption])[0]
        fitting = wanted.for_clip(options.frames, self.manifest.fps)
        stages = (self.sampler, self.decoder)
        if self.sampler.space != LATENT:
            from kinegraph.frame_inpainting import sample_held

            return sample_held(*stages, conditions, weights, options, caption, fitting, on_step)
        from kinegraph.constrained_denoising import sample_constrained

        return sample_constrained(*stages, conditions, weights, options, caption, fitting, on_step, on_latent)

    def _check_constraints(
        self, constraints: object, weight: object, fix: object, *, strict: bool, most: int | None = None
    ) -> Wanted | None:
        """Check constraints as far as that goes without a clip; None where there are none, and then nothing is loaded.

        `most` is the frames that the clip has at most; None is what the bundle makes at a time.

        Raises:
            InvalidInputError: see `constrained_denoising.Wanted.check`.
        """
        if constraints is None or (isinstance(constraints, list | tuple) and not constraints):
            return None
        return self._check_wanted(constraints, weight, fix, strict=strict, most=most)

    def _check_wanted(
        self, constraints: object, weight: object, fix: object, *, strict: bool, most: int | None = None
    ) -> Wanted:
        """Check constraints, or none, as far as that goes without a clip; see `_check_constraints`."""
        from kinegraph.constrained_denoising import Wanted

        return Wanted.check(constraints, weight, fix, strict, self.sampler, most)

    def _make_together(
        self, sentences: Sequence[_EncodedSentence], seeds: Sequence[int], takes: int, on_step: OnStep | None
    ) -> list[Clip]:
        """Make all clips of a batch in shared runs; parts of sentences take part as clips of their own.

        Sentences whose actions are sampled alone are made in runs of their own.
        """
        apart = [index for index, sentence in enumerate(sentences) if any(part.alone for part in sentence.parts)]
        if apart:
            return self._make_some_apart(sentences, seeds, takes, apart, on_step)
        sized = [
            self._with_margins(sentence.parts) if len(sentence.parts) > 1 else ([0], [*sentence.parts])
            for sentence in sentences
        ]
        parts = [part for _, longer in sized for part in longer]
        if not all(part.plan.is_plain for part in parts):
            raise InvalidInputError(
                "clips that share one run cannot weigh edges or negate actions; leave out shared_run"
            )
        conditions = repeat_rows(self.encoder.attend([array for part in parts for array in part.features]), takes)
        own_seeds = [
            seed if len(sentence.parts) == 1 else part_seed(seed, place)
            for index, sentence in enumerate(sentences)
            for place in range(len(sentence.parts))
            for seed in seeds[index * takes : (index + 1) * takes]
        ]
        sampled = [part for part in parts for _ in range(takes)]
        options = [replace(part.options, seed=seed) for part, seed in zip(sampled, own_seeds, strict=True)]
        runs = [slice(first, first + MAX_SHARED) for first in range(0, len(sampled), MAX_SHARED)]
        made: list[Clip] = []
        for index, run in enumerate(runs):
            progress = subrange_progress(on_step, index, len(runs))
            latents = self.sampler.sample(conditions.map(itemgetter(run)), None, options[run], progress)
            made += self.decoder.decode(latents, options[run], [part.graph.caption for part in sampled[run]])
        clips: list[Clip] = []
        for sentence, (leads, longer) in zip(sentences, sized, strict=True):
            own, made = made[: len(longer) * takes], made[len(longer) * takes :]
            for take in range(takes):
                of_clip = own[take::takes]
                clip = self._stitch(of_clip, leads, sentence.parts) if len(of_clip) > 1 else of_clip[0]
                notes = (*sentence.notes, *clip.notes)
                clips.append(replace(clip, text=sentence.graph.caption, graph=sentence.graph, notes=notes))
        return clips

    def _make_some_apart(
        self,
        sentences: Sequence[_EncodedSentence],
        seeds: Sequence[int],
        takes: int,
        apart: Sequence[int],
        on_step: OnStep | None,
    ) -> list[Clip]:
        """Make the clips of some sentences by themselves, and all others in shared runs."""
        own = [seeds[index * takes : (index + 1) * takes] for index in range(len(sentences))]
        others = [index for index in range(len(sentences)) if index not in apart]
        runs = len(apart) * takes + bool(others)
        progress = (subrange_progress(on_step, number, runs) for number in range(runs))
        clips = {
            index: [self._make_clip(sentences[index], seed, next(progress)) for seed in own[index]] for index in apart
        }
        if others:
            rest = [seed for index in others for seed in own[index]]
            made = self._make_together([sentences[index] for index in others], rest, takes, next(progress))
            clips |= {index: made[place * takes : (place + 1) * takes] for place, index in enumerate(others)}
        return [clip for index in range(len(sentences)) for clip in clips[index]]

    def _make_timeline(
        self,
        timeline: Sequence[Interval],
        parts: Sequence[_EncodedPart],
        seed: int,
        overlap: float | None,
        on_step: OnStep | None,
        wanted: Wanted | None = None,
    ) -> Clip:
        """Make the clip of a timeline, see `timeline`; `parts` are its encoded intervals."""
        if self.sampler.space != LATENT:
            from kinegraph.frame_timeline import EncodedInterval, make_timeline

            encoded = [
                EncodedInterval(part.features, None if part.plan.is_plain else part.plan.weights, each)
                for each, part in zip(timeline, parts, strict=True)
            ]
            turn = parts[0].options.turn if len(parts) == 1 else None  # of several, each has its own frames
            options = replace(parts[0].options, seed=seed, turn=turn)
            stages = (self.encoder, self.sampler, self.decoder)
            clip = make_timeline(*stages, encoded, options, overlap, on_step, wanted)
            turns = len(parts) > 1 and any(part.options.turn and part.options.turn.is_said for part in parts)
            return replace(clip, notes=(*clip.notes, TURNS_ARE_FREE)) if turns else clip
        if overlap is not None:
            raise InvalidInputError('overlap is for space="frames"; in latent space parts are blended as in a sequence')
        groups = self._compose_groups(timeline, parts)
        if len(groups) == 1:
            clip = self._sample(groups[0], seed, on_step)
            return clip if len(timeline) == 1 else replace(clip, graph=None)
        return self._make_parts([(part, seed + index) for index, part in enumerate(groups)], on_step)

    def _compose_groups(self, timeline: Sequence[Interval], parts: Sequence[_EncodedPart]) -> list[_EncodedPart]:
        """Compose the intervals of a timeline that begin and end together (Eq. 7-10).

        Raises:
            InvalidInputError: intervals that overlap otherwise, or are for parts of the body.
        """
        from kinegraph.intervals import groups_at_once

        groups = groups_at_once(timeline)
        if groups is None:
            raise InvalidInputError(
                "in latent space, intervals begin and end together or follow one another, and are for the whole body; "
                'take space="frames" for others, where the bundle has it'
            )
        left, composed = iter(parts), []
        for group in groups:
            first, *others = [next(left) for _ in group]
            if others:
                graphs = [first.graph, *(part.graph for part in others)]
                spec = validate_composition([Concept(graph) for graph in graphs], "fused", None, None, None)
                plan, features, options, _ = self._plan_composition(spec, first.options, own_length=False)
                first = replace(first, plan=plan, features=features, options=options)
            composed.append(first)
        return composed

    def _on_latent(self, on_level: OnLevel | None, options: GenerateOptions, caption: str) -> OnLatent:
        """Make the sampler's callback that decodes each coarser level for `on_level`."""

        def decode_level(level: str, latents: FloatArray) -> None:
            if on_level is not None and level in self.decoder.sessions.coarse_decoders:
                on_level(level, self.decoder.decode(latents, [options], [caption], level)[0])

        return decode_level


def _key(pipeline: MotionPipeline, part: _EncodedPart, seed: int, begins: bytes = b"") -> Hashable:
    """All that a part depends on: with another beginning, given by its frames, it is another one."""
    return (pipeline, part.graph, part.plan, repr(part.options), seed, begins)


def check_call(
    timeout: object, on_step: object, on_level: object = None, *, strict: object, shared_run: object = False
) -> Deadline:
    """Check what callers ask besides motion, and start the clock.

    Raises:
        InvalidInputError: a callback is no function, a flag no bool, or a timeout no number above 0.
    """
    check_callback(on_step, "on_step")
    check_callback(on_level, "on_level")
    check_flag(strict, "strict")
    check_flag(shared_run, "shared_run")
    return Deadline.start(timeout)


def _once_each(of_each: Sequence[Sequence[Unknown]]) -> tuple[Unknown, ...]:
    """Join what is unknown in several texts, the same words once."""
    spans = [span for unknown in of_each for span in unknown]
    return tuple({(span.text.lower(), span.reason): span for span in reversed(spans)}.values())[::-1]
