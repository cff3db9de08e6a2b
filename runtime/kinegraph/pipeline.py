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
from kinegraph.clip import Clip
from kinegraph.concepts import CompositionSpec, Concept, SamplingPlan, validate_composition
from kinegraph.conditioning import ConditionEncoder, Conditions, repeat_rows
from kinegraph.decoding import MotionDecoder
from kinegraph.denoising import LatentSampler, OnLatent
from kinegraph.diffusion.sampling import OnStep, subrange_progress
from kinegraph.errors import InvalidInputError
from kinegraph.graph import SemanticGraph
from kinegraph.limits import MAX_PARTS, MAX_TAKES
from kinegraph.motion.blending import stitch
from kinegraph.options import (
    GenerateOptions,
    Guidance,
    Steps,
    batch_seeds,
    resolve_options,
    sequence_caption,
    validate_lengths,
)
from kinegraph.text.parser import LazyParser, check_caption
from kinegraph.text.tokenizer import CaptionTokenizer

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
    ) -> None:
        self.manifest = manifest
        """What the bundle is: licence, limits, defaults, measured quality."""
        self.parser = parser
        """Text to graph; loaded at the first sentence."""
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
        return cls(bundle.manifest, sessions, tokenizer, bundle.tables, LazyParser.from_files(files))

    def with_sessions(self, sessions: Sessions) -> MotionPipeline:
        """Make a pipeline that runs other sessions, with the same tokenizer, tables and parser.

        For hosts that wrap sessions: to count or time runs, or to keep what an encoder said.
        """
        return MotionPipeline(self.manifest, sessions, self.encoder.tokenizer, self.encoder.tables, self.parser)

    def parse(self, text: str) -> SemanticGraph:
        """Parse a sentence into its semantic graph: look at it, edit it, hand it back to `generate`.

        Raises:
            InvalidInputError: blank, too long, or without a letter or digit.
            MissingExtraError: spaCy is not installed (`pip install "kinegraph[text]"`).
            BundleError: the bundle carries no parser.
        """
        check_caption(text)
        return self.parser().parse(text)

    def generate(
        self,
        text: str | SemanticGraph,
        *,
        seconds: float | None = None,
        seed: int | None = None,
        steps: Steps | None = None,
        guidance: Guidance | None = None,
        foot_fix: bool = True,
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
            on_step: called after every step with a `StepInfo`; returning False stops with `Cancelled`.
            on_level: called with each coarser level and the clip as far as it has come, where the bundle can decode it.

        Raises:
            InvalidInputError: text or an option is outside what the model takes; nothing has been run.
            Cancelled: `on_step` returned False.
            NonFiniteError: a model produced NaN or infinity.
        """
        # 1. Check the request
        options = resolve_options(
            self.manifest, seconds=seconds, seed=seed, steps=steps, guidance=guidance, foot_fix=foot_fix
        )
        # 2. Text -> graph; weighted edges make it a composition (Eq. 7, 8)
        graph = self.as_graph(text)
        plan = SamplingPlan.for_graph(graph)
        # 3. Text encoder and graph attention (Eq. 1-3); the sentence may tell the length
        conditions, options = self._encode(plan, options, own_length=seconds is None)
        # 4. Motion -> action -> specific latent
        on_latent = self._on_latent(on_level, options, graph.caption)
        weights = None if plan.is_plain else plan.weights
        latents = self.sampler.sample(conditions, weights, [options], on_step, on_latent)
        # 5. Latents -> features -> joints -> clip
        return replace(self.decoder.decode(latents, [options], [graph.caption])[0], graph=graph)

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
        on_step: OnStep | None = None,
    ) -> list[Clip]:
        """Make clips for many sentences in shared runs: all takes of the first, then of the second ...

        Clip k is what `generate` makes of its sentence with seed + k: in an fp32 bundle to 0.1 mm, because sums of a
        larger run are rounded in another order; in an int8 bundle roughly, because one scale spans a run.

        Args:
            texts: sentences or graphs as they were parsed, without weights on their edges.
            takes: of each; `limits.MAX_TAKES` clips at most in all.
            seconds: one length, one per sentence, or None for what each asks for.
            seed, steps, guidance, foot_fix, on_step: as in `generate`.

        Raises:
            InvalidInputError, Cancelled, NonFiniteError: as in `generate`; also for too many clips, and for weights.
        """
        lengths = validate_lengths(texts, seconds, MAX_TAKES, "a batch")
        options = [
            resolve_options(self.manifest, seconds=length, seed=seed, steps=steps, guidance=guidance, foot_fix=foot_fix)
            for length in lengths
        ]
        seeds = batch_seeds(options[0].seed, len(options), takes)
        graphs = [self.as_graph(text) for text in texts]
        if any(node.weight != 1 for graph in graphs for node in graph.nodes):
            raise InvalidInputError("clips that share one run cannot weigh edges; make weighted clips one by one")
        features = self.encoder.encode_text(graphs)
        for index, length in enumerate(lengths):
            if length is None:
                options[index] = self.encoder.with_length(options[index], [features[index]])
        conditions = repeat_rows(self.encoder.attend(features), takes)
        samples = [replace(options[index // takes], seed=value) for index, value in enumerate(seeds)]
        sampled_graphs = [graph for graph in graphs for _ in range(takes)]
        latents = self.sampler.sample(conditions, None, samples, on_step)
        clips = self.decoder.decode(latents, samples, [graph.caption for graph in sampled_graphs])
        return [replace(clip, graph=graph) for clip, graph in zip(clips, sampled_graphs, strict=True)]

    def sequence(
        self,
        texts: Sequence[str | SemanticGraph],
        *,
        seconds: float | Sequence[float] | None = None,
        seed: int | None = None,
        steps: Steps | None = None,
        guidance: Guidance | None = None,
        foot_fix: bool = True,
        on_step: OnStep | None = None,
    ) -> Clip:
        """Make one clip of several sentences, one after another, stitched where poses are alike (`motion.blending`).

        Args:
            texts: 1 to 32 sentences or graphs; sentence k is generated with seed + k.
            seconds: of each part, before the joins: one length, one per sentence, or None for what each asks for.
            seed, steps, guidance, foot_fix: as in `generate`.
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
        seeds = batch_seeds(options[0].seed, len(texts), takes=1)
        clips = [
            self.generate(
                graph,
                seconds=length,
                seed=part_seed,
                steps=steps,
                guidance=guidance,
                foot_fix=foot_fix,
                on_step=subrange_progress(on_step, index, len(texts)),
            )
            for index, (graph, length, part_seed) in enumerate(zip(graphs, lengths, seeds, strict=True))
        ]
        joints = stitch([clip.joints for clip in clips], self.manifest.fps, foot_fix=foot_fix)
        graph = clips[0].graph if len(clips) == 1 else None
        return replace(clips[0], joints=joints, text=sequence_caption([clip.text for clip in clips]), graph=graph)

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
            seconds, seed, steps, guidance, foot_fix, on_step, on_level: as in `generate`.

        Raises:
            InvalidInputError: a concept, weight or option is outside what can be composed, or the bundle has no
                graphs for `agd`; nothing has been run.
            Cancelled, NonFiniteError: as in `generate`.
        """
        spec = validate_composition(concepts, method, text, lambdas, agd)
        options = resolve_options(
            self.manifest, seconds=seconds, seed=seed, steps=steps, guidance=guidance, foot_fix=foot_fix
        )
        conditions, plan, options = self.encode_composition(spec, options, own_length=seconds is None)
        caption = spec.joint.caption if isinstance(spec.joint, SemanticGraph) else spec.joint
        on_latent = self._on_latent(on_level, options, caption)
        latents = self.sampler.sample(conditions, plan.weights, [options], on_step, on_latent)
        return self.decoder.decode(latents, [options], [caption])[0]

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

    def _encode(
        self, plan: SamplingPlan, options: GenerateOptions, *, own_length: bool
    ) -> tuple[Conditions, GenerateOptions]:
        features = self.encoder.encode_text(plan.graphs)
        if own_length:
            options = self.encoder.with_length(options, [features[index] for index in plan.length_from])
        return self.encoder.attend(features), options

    def _on_latent(self, on_level: OnLevel | None, options: GenerateOptions, caption: str) -> OnLatent:
        """Make the sampler's callback that decodes each coarser level for `on_level`."""

        def decode_level(level: str, latents: FloatArray) -> None:
            if on_level is not None and level in self.decoder.sessions.coarse_decoders:
                on_level(level, self.decoder.decode(latents, [options], [caption], level)[0])

        return decode_level
