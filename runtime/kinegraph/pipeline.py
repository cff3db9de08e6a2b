"""From a sentence to a clip: the stages in order, as in GraphMotion's figure 2.

text  --parser-->   semantic graph            text/parser.py, graph.py
graph --encoder-->  conditions                conditioning.py   text encoder, graph attention (Eq. 1-3)
      --sampler-->  latents                   denoising.py      motion -> action -> specific; diffusion/
      --decoder-->  joints, feet, clip        decoding.py, motion/
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import onnxruntime

from kinegraph.arrays import FloatArray
from kinegraph.bundle.manifest import Manifest
from kinegraph.bundle.reader import read_bundle
from kinegraph.bundle.sessions import Sessions, open_sessions
from kinegraph.bundle.tables import bones_of
from kinegraph.bundle.vocabulary import Vocabulary
from kinegraph.clip import Clip
from kinegraph.concepts import CompositionSpec, Concept, SamplingPlan, validate_composition
from kinegraph.conditioning import ConditionEncoder, Conditions, repeat_rows
from kinegraph.decoding import MotionDecoder
from kinegraph.denoising import LatentSampler, OnLatent
from kinegraph.diffusion.sampling import OnStep, subrange_progress
from kinegraph.errors import InvalidInputError, UnknownWordsError
from kinegraph.graph import SemanticGraph
from kinegraph.limits import MAX_PARTS, MAX_TAKES
from kinegraph.motion.blending import blend_margin, stitch
from kinegraph.options import (
    GenerateOptions,
    Guidance,
    Steps,
    batch_seeds,
    resolve_options,
    sequence_caption,
    validate_lengths,
    with_margins,
)
from kinegraph.text.parser import LazyParser, check_caption
from kinegraph.text.tokenizer import CaptionTokenizer
from kinegraph.text.vocabulary import find_unknown
from kinegraph.unknown import Unknown, describe_unknown

OnLevel = Callable[[str, Clip], None]
"""Called after a level of `contract.COARSE_DECODERS`, with its name and the clip as far as it has come."""


class MotionPipeline:
    """A loaded bundle. Any number of threads may share it; each call keeps its state to itself."""

    def __init__(
        self,
        manifest: Manifest,
        sessions: Sessions,
        tokenizer: CaptionTokenizer,
        tables: Mapping[str, FloatArray],
        parser: LazyParser,
        vocabulary: Vocabulary | None = None,
    ) -> None:
        self.manifest = manifest
        """What the bundle is: licence, limits, defaults, measured quality."""
        self.parser = parser
        """Text to graph; loaded at the first sentence."""
        self.vocabulary = vocabulary
        """What training showed; None where the bundle does not say."""
        self.encoder = ConditionEncoder(sessions, tokenizer, manifest, tables)
        """Graphs to conditions."""
        self.sampler = LatentSampler(sessions, manifest)
        """Conditions to latents."""
        self.decoder = MotionDecoder(sessions, manifest, bones_of(tables))
        """Latents to clips."""

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
            path: folder of a bundle; None is the one that comes with the package.
            threads: of every session; None chooses (`bundle.sessions.open_sessions`).
            session_options: the host's own onnxruntime options, instead of `threads`.

        Raises:
            BundleError: missing, altered or unusable; see its subclasses.
            InvalidInputError: `threads` is out of range.
        """
        bundle = read_bundle(None if path is None else Path(path))
        files = dict(bundle.files)
        bundle = replace(bundle, files={})  # so that only `files` holds the bytes, and a session's go when it is made
        sessions = open_sessions(bundle, threads=threads, options=session_options, files=files)
        tokenizer = CaptionTokenizer(files["tokenizer.json"])
        parser = LazyParser.from_files(files)
        return cls(bundle.manifest, sessions, tokenizer, bundle.tables, parser, bundle.vocabulary)

    def with_sessions(self, sessions: Sessions) -> MotionPipeline:
        """Make a pipeline that runs other sessions, with the same tokenizer, tables and parser.

        For hosts that wrap sessions: to count or time runs, or to keep what an encoder said.
        """
        encoder = self.encoder
        return MotionPipeline(self.manifest, sessions, encoder.tokenizer, encoder.tables, self.parser, self.vocabulary)

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
        if self.vocabulary is None:
            if strict:
                raise InvalidInputError(
                    f"strict needs a bundle that knows what it was shown, and {self.manifest.name!r} has no "
                    "vocabulary.npz; leave out strict, or add it: python -m kinegraph_export.vocabulary"
                )
            return ()
        spans = [span for text in texts for span in find_unknown(self.as_graph(text), self.vocabulary, self.encoder)]
        unknown = tuple({(span.text.lower(), span.reason): span for span in reversed(spans)}.values())[::-1]
        if unknown and strict:
            raise UnknownWordsError(
                f"not known: {describe_unknown(unknown)}; say it in known words (`kinegraph info --words` lists them), "
                "or leave out strict to take what comes nearest",
                unknown,
            )
        return unknown

    def generate(
        self,
        text: str | SemanticGraph,
        *,
        seconds: float | None = None,
        seed: int | None = None,
        steps: Steps | None = None,
        guidance: Guidance | None = None,
        foot_fix: bool = True,
        strict: bool = False,
        on_step: OnStep | None = None,
        on_level: OnLevel | None = None,
    ) -> Clip:
        """Make a clip for a sentence or a graph. The same arguments give the same clip, bit for bit.

        Args:
            text: a sentence, or its graph; weighted edges count as `concepts.weighted_edge_terms` says.
            seconds: length; None lets the sentence decide, as far as the bundle knows how long such motions take.
            seed: of the noise, 0 to 2**63 - 1; None draws one, to be found in the clip.
            steps: diffusion steps, one number or one per level.
            guidance: guidance scale (Eq. A), one number or one per level.
            foot_fix: lock standing feet where they stand (`motion.postprocess.lock_feet`).
            strict: refuse words that the bundle was never shown (`find_unknown`); without it the clip names them.
            on_step: called after every step with a `StepInfo`; returning False stops with `Cancelled`.
            on_level: called with each coarser level and the clip as far as it has come, where the bundle can decode it.

        Raises:
            InvalidInputError: text or an option is outside what the model takes; nothing has been run.
            UnknownWordsError: a word is unknown, and `strict` is set; nothing has been sampled.
            Cancelled: `on_step` returned False.
            NonFiniteError: a model produced NaN or infinity.
        """
        # 1. Check the request
        options = resolve_options(
            self.manifest, seconds=seconds, seed=seed, steps=steps, guidance=guidance, foot_fix=foot_fix
        )
        # 2. Text -> graph; weighted edges make it a composition (Eq. 7, 8)
        graph = self.as_graph(text)
        unknown = self.find_unknown(graph, strict=strict)
        plan = SamplingPlan.for_graph(graph)
        # 3. Text encoder and graph attention (Eq. 1-3); the sentence may tell the length
        conditions, options = self._encode(plan, options, own_length=seconds is None)
        # 4. Motion -> action -> specific latent; 5. latents -> features -> joints -> clip
        on_latent = self._on_latent(on_level, options, graph.caption)
        return replace(self._sample(graph, plan, conditions, options, on_step, on_latent), unknown=unknown)

    def takes(
        self,
        text: str | SemanticGraph,
        count: int,
        *,
        seconds: float | None = None,
        seed: int | None = None,
        steps: Steps | None = None,
        guidance: Guidance | None = None,
        foot_fix: bool = True,
        shared_run: bool = False,
        strict: bool = False,
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
            foot_fix=foot_fix,
            shared_run=shared_run,
            strict=strict,
            on_step=on_step,
        )

    def batch(
        self,
        texts: Sequence[str | SemanticGraph],
        *,
        takes: int = 1,
        seconds: float | Sequence[float] | None = None,
        seed: int | None = None,
        steps: Steps | None = None,
        guidance: Guidance | None = None,
        foot_fix: bool = True,
        shared_run: bool = False,
        strict: bool = False,
        on_step: OnStep | None = None,
    ) -> list[Clip]:
        """Make clips for many sentences: all takes of the first, then of the second ...

        Clip k is what `generate` makes of its sentence with seed + k, bit for bit.

        Args:
            texts: sentences or graphs.
            takes: of each; `limits.MAX_TAKES` clips at most in all.
            seconds: one length, one per sentence, or None for what each asks for.
            seed, steps, guidance, foot_fix, strict: as in `generate`.
            shared_run: let all clips share the runs of the models, which is faster. Sums of a larger run are rounded in
                another order, so a clip then equals that of `generate` to 0.1 mm in an fp32 bundle only; in an int8
                bundle one scale spans a run, and clips differ by `batch_mm` of the manifest's parity on average.
                Graphs must have no weighted edges and no negated actions.
            on_step: as in `generate`; its `done` and `total` are those of all clips.

        Raises:
            InvalidInputError, Cancelled, NonFiniteError: as in `generate`; also for too many clips, and for weights in
                a shared run.
        """
        lengths = validate_lengths(texts, seconds, MAX_TAKES, "a batch")
        options = [
            resolve_options(self.manifest, seconds=length, seed=seed, steps=steps, guidance=guidance, foot_fix=foot_fix)
            for length in lengths
        ]
        seeds = batch_seeds(options[0].seed, len(options), takes)
        graphs = [self.as_graph(text) for text in texts]
        unknown = self._unknown_of_each(graphs, strict)
        if shared_run:
            clips = self._sample_together(graphs, options, seeds, takes, lengths, on_step)
        else:
            clips = self._sample_apart(graphs, options, seeds, takes, lengths, on_step)
        return [replace(clip, unknown=unknown[index // takes]) for index, clip in enumerate(clips)]

    def sequence(
        self,
        texts: Sequence[str | SemanticGraph],
        *,
        seconds: float | Sequence[float] | None = None,
        seed: int | None = None,
        steps: Steps | None = None,
        guidance: Guidance | None = None,
        foot_fix: bool = True,
        strict: bool = False,
        on_step: OnStep | None = None,
    ) -> Clip:
        """Make one clip of several sentences, one after another, blended where poses are alike (`motion.blending`).

        Each part is made longer than asked by what the blends at its ends need, so that it keeps its length to 0.5 s.

        Args:
            texts: 1 to `limits.MAX_PARTS` sentences or graphs; sentence k is generated with seed + k.
            seconds: of each part: one length, one per sentence, or None for what each asks for.
            seed, steps, guidance, foot_fix, strict: as in `generate`.
            on_step: as in `generate`; its `done` and `total` are those of all parts.

        Raises:
            InvalidInputError, Cancelled, NonFiniteError: as in `generate`.
        """
        lengths = validate_lengths(texts, seconds, MAX_PARTS, "a sequence")
        options = [
            resolve_options(self.manifest, seconds=length, seed=seed, steps=steps, guidance=guidance, foot_fix=foot_fix)
            for length in lengths
        ]
        graphs = [self.as_graph(text) for text in texts]
        unknown = self.find_unknown(*graphs, strict=strict)
        seeds = batch_seeds(options[0].seed, len(texts), takes=1, most=MAX_PARTS)
        if len(graphs) == 1:
            plan = SamplingPlan.for_graph(graphs[0])
            conditions, only = self._encode(plan, options[0], own_length=lengths[0] is None)
            return replace(self._sample(graphs[0], plan, conditions, only, on_step), unknown=unknown)
        clips, leads, frames = [], [], []
        for index, (graph, length) in enumerate(zip(graphs, lengths, strict=True)):
            plan = SamplingPlan.for_graph(graph)
            conditions, part = self._encode(plan, options[index], own_length=length is None)
            lead, sampled = with_margins(
                part,
                self.manifest,
                first=index == 0,
                last=index == len(graphs) - 1,
                margin=blend_margin(self.manifest.fps),
            )
            progress = subrange_progress(on_step, index, len(graphs))
            clips.append(self._sample(graph, plan, conditions, replace(sampled, seed=seeds[index]), progress))
            leads.append(lead)
            frames.append(part.frames)
        joints = stitch(
            [clip.joints for clip in clips], self.manifest.fps, leads=leads, lengths=frames, foot_fix=foot_fix
        )
        text = sequence_caption([clip.text for clip in clips])
        return replace(clips[0], joints=joints, text=text, graph=None, unknown=unknown)

    def compose(
        self,
        concepts: Sequence[Concept | str | SemanticGraph],
        *,
        method: str = "fused",
        text: str | SemanticGraph | None = None,
        lambdas: tuple[float, float, float] | None = None,
        agd: tuple[float, float] | None = None,
        seconds: float | None = None,
        seed: int | None = None,
        steps: Steps | None = None,
        guidance: Guidance | None = None,
        foot_fix: bool = True,
        strict: bool = False,
        on_step: OnStep | None = None,
        on_level: OnLevel | None = None,
    ) -> Clip:
        """Make a clip in which several motions happen at once, or do not (EnergyMoGen, Eq. 3, 4, 7-10).

        Args:
            concepts: up to 8; a negative weight is what must not happen. It takes what both have in common, too:
                -0.3 beside something alike ("walks", not "runs"), -1 against an action that the rest names.
            method: "latent" adds predictions (Eq. 7, 8), "semantic" averages attention (Eq. 9), "fused" blends both
                with the joint text (Eq. 10) and takes away what is negated (Eq. 8).
            text: the joint text of "fused"; None joins the positive concepts with "while".
            lambdas: of "fused": shares of latent, semantic and joint text; default (0, 0.1, 0.9).
            agd: step sizes (gamma_attn, gamma_reg) of adaptive gradient descent (Eq. 3, 4), each 0 to 1: EnergyMoGen
                has (0.0004, 0.0004) for several concepts and (0.001, 0.002) for one sentence of several; the default
                bundle does best with (0.1, 0.1). None is off.
            seconds, seed, steps, guidance, foot_fix, strict, on_step, on_level: as in `generate`; negated concepts
                count for `strict`, too.

        Raises:
            InvalidInputError: a concept, weight or option is outside what can be composed, or the bundle has no
                graphs for `agd`; nothing has been run.
            Cancelled, NonFiniteError: as in `generate`.
        """
        spec = validate_composition(concepts, method, text, lambdas, agd)
        options = resolve_options(
            self.manifest, seconds=seconds, seed=seed, steps=steps, guidance=guidance, foot_fix=foot_fix
        )
        named = [concept.text for concept in (*spec.concepts, *spec.negated)]
        unknown = self.find_unknown(*named, *([] if text is None else [text]), strict=strict)
        conditions, plan, options = self.encode_composition(spec, options, own_length=seconds is None)
        caption = spec.joint.caption if isinstance(spec.joint, SemanticGraph) else spec.joint
        on_latent = self._on_latent(on_level, options, caption)
        latents = self.sampler.sample(conditions, plan.weights, [options], on_step, on_latent)
        return replace(self.decoder.decode(latents, [options], [caption])[0], unknown=unknown)

    def encode_composition(
        self, spec: CompositionSpec, options: GenerateOptions, *, own_length: bool
    ) -> tuple[Conditions, SamplingPlan, GenerateOptions]:
        """Parse and encode what is composed.

        Args:
            spec: what is composed.
            options: of the clip.
            own_length: whether the concepts tell the length of the clip.

        Returns:
            Conditions in the order of the plan's weights, the plan, and the options with the length.

        Raises:
            InvalidInputError: adaptive gradient descent is asked for and the bundle has no graphs for it.
        """
        self.sampler.validate_agd(spec.agd)
        plan = SamplingPlan.for_composition(spec, [self.as_graph(text) for text in spec.texts])
        conditions, options = self._encode(plan, options, own_length=own_length)
        return conditions, plan, options

    def as_graph(self, text: str | SemanticGraph) -> SemanticGraph:
        """Return a graph as it is, and parse a sentence."""
        return text if isinstance(text, SemanticGraph) else self.parse(text)

    def _unknown_of_each(self, graphs: Sequence[SemanticGraph], strict: bool) -> list[tuple[Unknown, ...]]:
        """Find what is unknown in each graph; with `strict`, refuse all of them together."""
        if strict:
            self.find_unknown(*graphs, strict=True)
        return [self.find_unknown(graph) for graph in graphs]

    def _encode(
        self, plan: SamplingPlan, options: GenerateOptions, *, own_length: bool
    ) -> tuple[Conditions, GenerateOptions]:
        features = self.encoder.encode_text(plan.graphs)
        if own_length:
            options = self.encoder.with_length(options, [features[index] for index in plan.length_from])
        return self.encoder.attend(features), options

    def _sample(
        self,
        graph: SemanticGraph,
        plan: SamplingPlan,
        conditions: Conditions,
        options: GenerateOptions,
        on_step: OnStep | None = None,
        on_latent: OnLatent | None = None,
    ) -> Clip:
        """Sample latents for one graph and decode them."""
        weights = None if plan.is_plain else plan.weights
        latents = self.sampler.sample(conditions, weights, [options], on_step, on_latent)
        return replace(self.decoder.decode(latents, [options], [graph.caption])[0], graph=graph)

    def _sample_apart(
        self,
        graphs: Sequence[SemanticGraph],
        options: Sequence[GenerateOptions],
        seeds: Sequence[int],
        takes: int,
        lengths: Sequence[float | None],
        on_step: OnStep | None,
    ) -> list[Clip]:
        """Make each clip of a batch in runs of its own."""
        clips = []
        for index, (graph, length) in enumerate(zip(graphs, lengths, strict=True)):
            plan = SamplingPlan.for_graph(graph)
            conditions, text_options = self._encode(plan, options[index], own_length=length is None)
            for number in range(index * takes, (index + 1) * takes):
                sample = replace(text_options, seed=seeds[number])
                progress = subrange_progress(on_step, number, len(seeds))
                clips.append(self._sample(graph, plan, conditions, sample, progress))
        return clips

    def _sample_together(
        self,
        graphs: Sequence[SemanticGraph],
        options: Sequence[GenerateOptions],
        seeds: Sequence[int],
        takes: int,
        lengths: Sequence[float | None],
        on_step: OnStep | None,
    ) -> list[Clip]:
        """Make all clips of a batch in shared runs."""
        if any(node.weight != 1 for graph in graphs for node in graph.nodes):
            raise InvalidInputError("clips that share one run cannot weigh edges; leave out shared_run")
        features = self.encoder.encode_text(graphs)
        sized = [
            self.encoder.with_length(option, [feature]) if length is None else option
            for option, feature, length in zip(options, features, lengths, strict=True)
        ]
        conditions = repeat_rows(self.encoder.attend(features), takes)
        samples = [replace(sized[index // takes], seed=value) for index, value in enumerate(seeds)]
        sampled_graphs = [graph for graph in graphs for _ in range(takes)]
        latents = self.sampler.sample(conditions, None, samples, on_step)
        clips = self.decoder.decode(latents, samples, [graph.caption for graph in sampled_graphs])
        return [replace(clip, graph=graph) for clip, graph in zip(clips, sampled_graphs, strict=True)]

    def _on_latent(self, on_level: OnLevel | None, options: GenerateOptions, caption: str) -> OnLatent:
        """Make the sampler's callback that decodes each coarser level for `on_level`."""

        def decode_level(level: str, latents: FloatArray) -> None:
            if on_level is not None and level in self.decoder.sessions.coarse_decoders:
                on_level(level, self.decoder.decode(latents, [options], [caption], level)[0])

        return decode_level
