"""From a sentence to a clip; the stages in order, as in GraphMotion's figure 2.

text -> graph -> node features -> graph attention -> motion -> action -> specific latent -> features -> joints
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import onnxruntime
from numpy.typing import NDArray

from kinegraph.bundle import read_bundle
from kinegraph.concepts import Concept, checked_concepts, checked_lambdas, joint_caption
from kinegraph.conditions import Conditions, GraphArrays, conditions, graph_arrays, padded, repeated
from kinegraph.decoding import decode, finite
from kinegraph.denoisers import Denoisers
from kinegraph.diffusion.sampler import OnStep, part_of
from kinegraph.duration import with_own_length
from kinegraph.edits import edge_terms
from kinegraph.errors import InvalidInputError
from kinegraph.graph import SemanticGraph
from kinegraph.manifest import Manifest
from kinegraph.motion.clip import Clip
from kinegraph.motion.feet import planted_feet
from kinegraph.motion.joining import joined
from kinegraph.options import GenerateOptions, Guidance, Steps, generate_options, part_lengths, with_seeds
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
        return cls(bundle.manifest, sessions, tokenizer, bundle.tables, LazyParser.of(bundle.files))

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
        denoisers = Denoisers(self._sessions, self.manifest)
        if weights == [1.0]:
            latent = denoisers.guided(encoded, [options], on_step)
        else:
            latent = denoisers.composed(encoded, weights, [], (1.0, 0.0, 0.0), options, on_step)
        return self._clips(latent, [options], [graph.caption])[0]

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
        """Several clips for one sentence, which share the runs of the models.

        Take k is what `generate` makes of seed + k, to 0.1 mm: sums of a larger run are rounded in another order.

        Args:
            text: a sentence, or its graph; as it was parsed, without weights on its edges.
            count: 1 to `limits.MAX_TAKES`.
            seconds, seed, steps, guidance, foot_fix, on_step: as in `generate`.

        Raises:
            InvalidInputError: as in `generate`, a wrong count, or a graph with weights.
            Cancelled, NonFiniteError: as in `generate`.
        """
        options = generate_options(
            self.manifest, seconds=seconds, seed=seed, steps=steps, guidance=guidance, foot_fix=foot_fix
        )
        wishes = with_seeds(options, count)
        graph = text if isinstance(text, SemanticGraph) else self.parse(text)
        if any(node.weight != 1 for node in graph.nodes):
            raise InvalidInputError("takes share one run, which cannot weigh edges; make weighted clips one by one")
        arrays = [self._arrays(graph)]
        if seconds is None:
            length = with_own_length(options, self._tables.get(DURATION), self.manifest, arrays)
            wishes = [replace(each, frames=length.frames, seconds=length.seconds) for each in wishes]
        encoded = repeated(self._encode(arrays), count)
        latent = Denoisers(self._sessions, self.manifest).guided(encoded, wishes, on_step)
        return self._clips(latent, wishes, [graph.caption] * count)

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
        lengths = part_lengths(texts, seconds)
        wishes: dict[str, Any] = {"steps": steps, "guidance": guidance, "foot_fix": foot_fix}
        options = [generate_options(self.manifest, seconds=length, seed=seed, **wishes) for length in lengths]
        graphs = [text if isinstance(text, SemanticGraph) else self.parse(text) for text in texts]
        first = options[0].seed
        clips = [
            self.generate(
                graph, seconds=length, seed=first + place, on_step=part_of(on_step, place, len(texts)), **wishes
            )
            for place, (graph, length) in enumerate(zip(graphs, lengths, strict=True))
        ]
        joints = joined([clip.joints for clip in clips], self.manifest.fps)
        return replace(clips[0], joints=joints, text=", then ".join(clip.text for clip in clips))

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
            lambdas: of "fused": shares of latent, semantic and joint text; default (0.1, 0.3, 0.6).
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
        denoisers = Denoisers(self._sessions, self.manifest)
        latent = denoisers.composed(encoded, weights, joint_weights, shares, options, on_step)
        caption = joint.caption if isinstance(joint, SemanticGraph) else joint
        return self._clips(latent, [options], [caption])[0]

    def _clips(self, latent: FloatArray, wishes: Sequence[GenerateOptions], captions: Sequence[str]) -> list[Clip]:
        """Latents (B, C, z) of the finest level as B clips."""
        frames, fps = [each.frames for each in wishes], self.manifest.fps
        motions = decode(self._sessions.decoder, self.manifest, bones_of(self._tables), latent, frames)
        bundle = f"{self.manifest.name} {self.manifest.version}"
        return [
            Clip(planted_feet(joints, fps) if each.foot_fix else joints, fps, each.seed, caption, bundle)
            for joints, each, caption in zip(motions, wishes, captions, strict=True)
        ]

    def _arrays(self, graph: SemanticGraph) -> GraphArrays:
        tokens = self._tokenizer.encode(graph.caption)
        feeds = {"input_ids": tokens.ids[None], "attention_mask": tokens.mask[None]}
        hidden, pooled = self._sessions.text_encoder.run(["hidden", "pooled"], feeds)
        return graph_arrays(graph, tokens, hidden[0], pooled[0])

    def _encode(self, arrays: Sequence[GraphArrays]) -> Conditions:
        """Graph attention over a batch of graphs."""
        (nodes,) = self._sessions.graph_encoder.run(["nodes_out"], padded(arrays))
        return conditions(arrays, finite(nodes, "the graph encoder"))
