"""From a sentence to a clip; the stages in order, as in GraphMotion's figure 2.

text -> graph -> node features -> graph attention -> motion -> action -> specific latent -> features -> joints
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import onnxruntime
from numpy.typing import NDArray

from kinegraph.bundle import read_bundle
from kinegraph.concepts import Concept, checked_concepts, checked_lambdas, joint_caption
from kinegraph.conditions import (
    Conditions,
    GraphArrays,
    conditions,
    for_level,
    graph_arrays,
    padded,
    stacked,
    without_anything,
    without_text,
)
from kinegraph.contract import LEVELS
from kinegraph.decoding import decode, finite
from kinegraph.diffusion.composition import Wiring, composition, mixed
from kinegraph.diffusion.ddim import DdimCoefficients
from kinegraph.diffusion.guidance import guided
from kinegraph.diffusion.sampler import LevelPlan, OnStep, Predict, PredictorFor, coarse_to_fine, initial_noise
from kinegraph.duration import with_own_length
from kinegraph.edits import edge_terms
from kinegraph.graph import SemanticGraph
from kinegraph.manifest import Manifest
from kinegraph.motion.clip import Clip
from kinegraph.motion.feet import planted_feet
from kinegraph.network import RowNetwork, modulations, row_network
from kinegraph.options import GenerateOptions, Guidance, Steps, generate_options
from kinegraph.sessions import Sessions, open_sessions
from kinegraph.tables import DURATION, bones_of
from kinegraph.text.parser import LazyParser, check_caption
from kinegraph.text.tokens import CaptionTokenizer

FloatArray = NDArray[np.float32]


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
        sessions = open_sessions(bundle, threads=threads, options=session_options)
        tokenizer = CaptionTokenizer(bundle.files["tokenizer.json"])
        return cls(bundle.manifest, sessions, tokenizer, bundle.tables, LazyParser(bundle.files.get("parser.bin")))

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

        Raises:
            InvalidInputError: text or an option is outside what the model takes; nothing has been run.
            Cancelled: `on_step` returned False.
            NonFiniteError: a model produced NaN or infinity.
        """
        options = generate_options(
            self.manifest, seconds=seconds, seed=seed, steps=steps, guidance=guidance, foot_fix=foot_fix
        )
        graph = text if isinstance(text, SemanticGraph) else self.parse(text)
        terms = edge_terms(graph)
        arrays = [self._arrays(each) for each, _ in terms]
        if seconds is None:
            options = with_own_length(options, self._tables.get(DURATION), self.manifest, arrays[:1])
        encoded, weights = self._encode(arrays), [weight for _, weight in terms]
        if weights == [1.0]:
            latent = self._sample(encoded, [options], on_step)
        else:
            latent = self._composed(encoded, weights, [], (1.0, 0.0, 0.0), options, on_step)
        return self._clip(latent, options, graph.caption)

    def compose(
        self,
        concepts: Sequence[Concept | str | SemanticGraph],
        *,
        method: str = "fused",
        text: str | SemanticGraph | None = None,
        lambdas: tuple[float, float, float] | None = None,
        seconds: float | None = None,
        seed: int | None = None,
        steps: Steps | None = None,
        guidance: Guidance | None = None,
        foot_fix: bool = True,
        on_step: OnStep | None = None,
    ) -> Clip:
        """A clip in which several motions happen at once, or do not (EnergyMoGen, Eq. 7-10).

        Args:
            concepts: up to 8; a negative weight is what must not happen.
            method: "latent" adds predictions (Eq. 7, 8), "semantic" mixes attention (Eq. 9), "fused" blends both
                with the joint text (Eq. 10).
            text: the joint text of "fused"; None joins the positive concepts with "while".
            lambdas: of "fused": shares of latent, semantic and joint text; default (0.1, 0.7, 0.2).
            seconds, seed, steps, guidance, foot_fix, on_step: as in `generate`.

        Raises:
            InvalidInputError: a concept, weight or option is outside what can be composed; nothing has been run.
            Cancelled, NonFiniteError: as in `generate`.
        """
        found = checked_concepts(concepts)
        shares = checked_lambdas(method, lambdas, text, found)
        options = generate_options(
            self.manifest, seconds=seconds, seed=seed, steps=steps, guidance=guidance, foot_fix=foot_fix
        )
        joint = joint_caption(found) if text is None else text
        wanted = [concept.text for concept in found] + ([joint] if shares[2] else [])
        graphs = [each if isinstance(each, SemanticGraph) else self.parse(each) for each in wanted]
        terms = [edge_terms(graph) for graph in graphs]
        arrays = [[self._arrays(each) for each, _ in own] for own in terms]
        if seconds is None:
            wanted_ones = [own[0] for own, concept in zip(arrays, found, strict=False) if concept.weight > 0]
            options = with_own_length(options, self._tables.get(DURATION), self.manifest, wanted_ones)
        encoded = self._encode([each for own in arrays for each in own])
        weights = [one.weight * part for one, own in zip(found, terms, strict=False) for _, part in own]
        joint_weights = [part for own in terms[len(found) :] for _, part in own]
        latent = self._composed(encoded, weights, joint_weights, shares, options, on_step)
        caption = joint.caption if isinstance(joint, SemanticGraph) else joint
        return self._clip(latent, options, caption)

    def _composed(
        self,
        encoded: Conditions,
        weights: Sequence[float],
        joint: Sequence[float],
        shares: tuple[float, float, float],
        options: GenerateOptions,
        on_step: OnStep | None,
    ) -> FloatArray:
        """Latent of the finest level from several graphs, one run per step whatever the method.

        Rows of `encoded` come in the order of `weights`, then of `joint`, the graphs of the joint text.
        """

        def predictor_for(number: int, times: DdimCoefficients, coarse: FloatArray | None) -> Predict:
            name = LEVELS[number]
            apart = coarse is not None and self.manifest.defaults.guidance_base == "empty"
            plan = composition(weights, shares, options.guidance[name], coarse=apart, joint_weights=joint)
            seen = for_level(encoded, self.manifest.levels[name].nodes)
            first = Conditions(*(part[:1] for part in vars(seen).values()))
            known = stacked(stacked(self._base(first), without_text(first)), seen)
            rows = len(plan.mix)
            shared = None if coarse is None else np.repeat(coarse, len(known.kind), axis=0)
            network = self._network(name, known, shared, plan.wiring, np.full(rows, options.frames), times)
            return lambda latent, step: mixed(network(np.repeat(latent, rows, axis=0), step), plan.mix)

        return self._sampled([options], predictor_for, on_step)

    def _clip(self, latent: FloatArray, options: GenerateOptions, text: str) -> Clip:
        bones = bones_of(self._tables)
        (joints,) = decode(self._sessions.decoder, self.manifest, bones, latent, [options.frames])
        joints = planted_feet(joints, self.manifest.fps) if options.foot_fix else joints
        bundle = f"{self.manifest.name} {self.manifest.version}"
        return Clip(joints=joints, fps=self.manifest.fps, seed=options.seed, text=text, bundle=bundle)

    def _arrays(self, graph: SemanticGraph) -> GraphArrays:
        tokens = self._tokenizer.encode(graph.caption)
        feeds = {"input_ids": tokens.ids[None], "attention_mask": tokens.mask[None]}
        hidden, pooled = self._sessions.text_encoder.run(["hidden", "pooled"], feeds)
        return graph_arrays(graph, tokens, hidden[0], pooled[0])

    def _encode(self, arrays: Sequence[GraphArrays]) -> Conditions:
        """Graph attention over a batch of graphs."""
        (nodes,) = self._sessions.graph_encoder.run(["nodes_out"], padded(arrays))
        return conditions(arrays, finite(nodes, "the graph encoder"))

    def _sample(self, encoded: Conditions, options: Sequence[GenerateOptions], on_step: OnStep | None) -> FloatArray:
        """Latents of the finest level, (B, C, z); all samples of a batch share steps and guidance."""
        first = options[0]
        frames = np.array([each.frames for each in options])

        def predictor_for(number: int, times: DdimCoefficients, coarse: FloatArray | None) -> Predict:
            name = LEVELS[number]
            return self._predictor(name, encoded, coarse, frames, times, first.guidance[name])

        return self._sampled(options, predictor_for, on_step)

    def _sampled(
        self, options: Sequence[GenerateOptions], predictor_for: PredictorFor, on_step: OnStep | None
    ) -> FloatArray:
        """All levels, each sample from the noise of its own seed."""
        plans = [
            LevelPlan(name, spec.tokens, spec.latent_width, options[0].steps[name])
            for name, spec in ((name, self.manifest.levels[name]) for name in LEVELS)
        ]
        per_sample = [initial_noise(each.seed, plans) for each in options]
        noises = [np.stack(level) for level in zip(*per_sample, strict=True)]
        return coarse_to_fine(plans, noises, predictor_for, self.manifest.schedule.noise, on_step)[-1]

    def _predictor(
        self,
        name: str,
        encoded: Conditions,
        coarse: FloatArray | None,
        frames: NDArray[np.int64],
        times: DdimCoefficients,
        scale: float,
    ) -> Predict:
        """Guided noise prediction of one level: rows are the unconditional predictions of all samples, then theirs."""
        seen = for_level(encoded, self.manifest.levels[name].nodes)
        known = stacked(self._base(seen), seen)
        twice = None if coarse is None else np.concatenate([coarse, coarse])
        network = self._network(name, known, twice, Wiring.straight(2 * len(frames)), np.tile(frames, 2), times)

        def predict(latent: FloatArray, step: int) -> FloatArray:
            unconditional, conditional = np.split(network(np.concatenate([latent, latent]), step), 2)
            return guided(unconditional, conditional, scale)

        return predict

    def _base(self, seen: Conditions) -> Conditions:
        """What guidance leads away from."""
        return without_anything(seen) if self.manifest.defaults.guidance_base == "empty" else without_text(seen)

    def _network(
        self,
        name: str,
        known: Conditions,
        coarse: FloatArray | None,
        wiring: Wiring,
        frames: NDArray[np.int64],
        times: DdimCoefficients,
    ) -> RowNetwork:
        sessions = self._sessions
        modulation = modulations(sessions.clock[name], times.timesteps, frames)
        return row_network(sessions.context[name], sessions.step[name], known, coarse, wiring, modulation)
