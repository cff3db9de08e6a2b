"""From a sentence to a clip; the stages in order, as in GraphMotion's figure 2.

text -> graph -> node features -> graph attention -> motion -> action -> specific latent -> features -> joints
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import onnxruntime

from kinegraph.arrays import FloatArray
from kinegraph.bundle.manifest import Manifest
from kinegraph.bundle.reader import read_bundle
from kinegraph.bundle.sessions import Sessions, open_sessions
from kinegraph.bundle.tables import bones_of
from kinegraph.clip import Clip
from kinegraph.concepts import CompositionSpec, Concept, validate_composition
from kinegraph.conditioning import Conditions, Encoders, repeated
from kinegraph.decoding import Decoders
from kinegraph.denoising import Denoisers, check_step_sizes
from kinegraph.diffusion.composition import CompositionWeights
from kinegraph.diffusion.sampling import OnStep, subrange_progress
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
"""Called after a level, of `contract.COARSE_DECODERS`, with its name and the clip as far as it has come."""


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
        self._sessions = sessions
        self._tokenizer = tokenizer
        self._tables = tables
        self._parser = parser

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
            threads: of every session; None chooses (`sessions.open_sessions`).
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
        return cls(bundle.manifest, sessions, tokenizer, bundle.tables, LazyParser.of(files))

    def parse(self, text: str) -> SemanticGraph:
        """The semantic graph of a sentence: look at it, edit it, hand it back to `generate`.

        Raises:
            InvalidInputError: blank, too long, or without a letter or digit.
            MissingExtraError: spaCy is not installed (`pip install "kinegraph[text]"`).
            BundleError: the bundle carries no parser.
        """
        check_caption(text)
        return self._parser().parse(text)

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
        """A clip for a sentence or a graph. The same arguments give the same clip, bit for bit.

        Args:
            text: a sentence, or its graph; weights of its edges count as `edits.edge_terms` says.
            seconds: length; None lets the sentence decide, as far as the bundle knows how long such motions take.
            seed: of the noise, 0 to 2**63 - 1; None draws one, to be found in the clip.
            steps: diffusion steps, one number or one per level.
            guidance: how strictly the text is followed, one number or one per level.
            foot_fix: hold feet that stand where they stand (`motion.feet`).
            on_step: called after every step with a `StepInfo`; returning False stops with `Cancelled`.
            on_level: called with each coarser level and the clip as far as it has come, where the bundle can decode it.

        Raises:
            InvalidInputError: text or an option is outside what the model takes; nothing has been run.
            Cancelled: `on_step` returned False.
            NonFiniteError: a model produced NaN or infinity.
        """
        options = resolve_options(
            self.manifest, seconds=seconds, seed=seed, steps=steps, guidance=guidance, foot_fix=foot_fix
        )
        graph = self._graph(text)
        encoded, mixture, options = self._encoders.weighted(graph, options, seconds is None)
        denoisers = self._denoisers(options, graph.caption, on_level)
        if mixture == CompositionWeights((1.0,)):
            latent = denoisers.guided(encoded, [options], on_step)
        else:
            latent = denoisers.composed(encoded, mixture, options, on_step)
        return replace(self._decoders.clips(latent, [options], [graph.caption])[0], graph=graph)

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
        """Several clips for one sentence: a `batch` of it alone, `count` takes, 1 to `limits.MAX_TAKES`."""
        wishes: dict[str, Any] = {"steps": steps, "guidance": guidance, "foot_fix": foot_fix}
        return self.batch([text], takes=count, seconds=seconds, seed=seed, on_step=on_step, **wishes)

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
        """Clips for many sentences, which share the runs of the models: all takes of the first, then of the second ...

        Clip k is what `generate` makes of its sentence with seed + k: in an fp32 bundle to 0.1 mm, because sums of a
        larger run are rounded in another order; in an int8 bundle roughly, because one scale spans a run.

        Args:
            texts: sentences or graphs; as they were parsed, without weights on their edges.
            takes: of each; `limits.MAX_TAKES` clips at most in all.
            seconds: one length, one per sentence, or None for what each asks for.
            seed, steps, guidance, foot_fix, on_step: as in `generate`.

        Raises:
            InvalidInputError, Cancelled, NonFiniteError: as in `generate`; also for too many clips, and for weights.
        """
        lengths = validate_lengths(texts, seconds, MAX_TAKES, "a batch")
        wishes: dict[str, Any] = {"seed": seed, "steps": steps, "guidance": guidance, "foot_fix": foot_fix}
        options = [resolve_options(self.manifest, seconds=length, **wishes) for length in lengths]
        seeds = batch_seeds(options[0].seed, len(options), takes)
        graphs = [self._graph(text) for text in texts]
        encoded, own = self._encoders.side_by_side(graphs, options, [length is None for length in lengths])
        each_clip = [replace(own[place // takes], seed=value) for place, value in enumerate(seeds)]
        latent = Denoisers(self._sessions, self.manifest).guided(repeated(encoded, takes), each_clip, on_step)
        own_graphs = [graph for graph in graphs for _ in range(takes)]
        clips = self._decoders.clips(latent, each_clip, [graph.caption for graph in own_graphs])
        return [replace(clip, graph=graph) for clip, graph in zip(clips, own_graphs, strict=True)]

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
        """One clip of several sentences, one after another, joined where poses are alike (`motion.joining`).

        Args:
            texts: 1 to 32 sentences or graphs; sentence k is generated with seed + k.
            seconds: of each part, before the joins: one length, one per sentence, or None for what each asks for.
            seed, steps, guidance, foot_fix: as in `generate`.
            on_step: as in `generate`; its `done` and `total` are those of all parts.

        Raises:
            InvalidInputError, Cancelled, NonFiniteError: as in `generate`.
        """
        lengths = validate_lengths(texts, seconds, MAX_PARTS, "a sequence")
        wishes: dict[str, Any] = {"steps": steps, "guidance": guidance, "foot_fix": foot_fix}
        options = [resolve_options(self.manifest, seconds=length, seed=seed, **wishes) for length in lengths]
        graphs = [self._graph(text) for text in texts]
        seeds = batch_seeds(options[0].seed, len(texts), takes=1)
        clips = [
            self.generate(
                graph, seconds=length, seed=own, on_step=subrange_progress(on_step, place, len(texts)), **wishes
            )
            for place, (graph, length, own) in enumerate(zip(graphs, lengths, seeds, strict=True))
        ]
        joints = stitch([clip.joints for clip in clips], self.manifest.fps, foot_fix=foot_fix)
        own = clips[0].graph if len(clips) == 1 else None
        return replace(clips[0], joints=joints, text=sequence_caption([clip.text for clip in clips]), graph=own)

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
        """A clip in which several motions happen at once, or do not (EnergyMoGen, Eq. 3, 4, 7-10).

        Args:
            concepts: up to 8; a negative weight is what must not happen. It takes what both have in common, too:
                -0.3 beside something alike ("walks", not "runs"), -1 against an action that the rest names.
            method: "latent" adds predictions (Eq. 7, 8), "semantic" mixes attention (Eq. 9), "fused" blends both
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
        what = validate_composition(concepts, method, text, lambdas, agd)
        options = resolve_options(
            self.manifest, seconds=seconds, seed=seed, steps=steps, guidance=guidance, foot_fix=foot_fix
        )
        encoded, mixture, options = self._mixed(what, options, seconds is None)
        caption = what.joint.caption if isinstance(what.joint, SemanticGraph) else what.joint
        latent = self._denoisers(options, caption, on_level).composed(encoded, mixture, options, on_step)
        return self._decoders.clips(latent, [options], [caption])[0]

    def _mixed(
        self, what: CompositionSpec, options: GenerateOptions, own_length: bool
    ) -> tuple[Conditions, CompositionWeights, GenerateOptions]:
        """What is composed, encoded; `own_length` asks the concepts for the length."""
        check_step_sizes(self._sessions, self.manifest, what.agd)
        graphs = [self._graph(text) for text, _ in what.parts]
        return self._encoders.mixed(what, graphs, options, own_length)

    @property
    def _encoders(self) -> Encoders:
        return Encoders(self._sessions, self._tokenizer, self.manifest, self._tables)

    @property
    def _decoders(self) -> Decoders:
        return Decoders(self._sessions, self.manifest, bones_of(self._tables))

    def _denoisers(self, options: GenerateOptions, caption: str, on_level: OnLevel | None) -> Denoisers:
        """The diffusion models, which tell `on_level` of every level that can be decoded."""

        def show(level: str, latent: FloatArray) -> None:
            if on_level is not None and level in self._sessions.coarse_decoders:
                on_level(level, self._decoders.clips(latent, [options], [caption], level)[0])

        return Denoisers(self._sessions, self.manifest, show)

    def _graph(self, text: str | SemanticGraph) -> SemanticGraph:
        return text if isinstance(text, SemanticGraph) else self.parse(text)
