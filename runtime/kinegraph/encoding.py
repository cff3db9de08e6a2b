"""The text encoder and graph attention (GraphMotion, section 3.1): from graphs to what the denoisers attend to, and to
how long a clip of them should be."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from kinegraph.concepts import Composing
from kinegraph.conditions import Conditions, GraphArrays, conditions, padded
from kinegraph.decoding import finite
from kinegraph.diffusion.composition import Mixture
from kinegraph.duration import with_own_length
from kinegraph.edits import edge_terms
from kinegraph.errors import InvalidInputError
from kinegraph.graph import SemanticGraph
from kinegraph.manifest import Manifest
from kinegraph.options import GenerateOptions
from kinegraph.sessions import Sessions
from kinegraph.tables import DURATION
from kinegraph.text.states import caption_arrays
from kinegraph.text.tokens import CaptionTokenizer

FloatArray = NDArray[np.float32]


@dataclass(frozen=True)
class Encoders:
    """From graphs to conditions. Where the caller gave no length (`own_length`), options come back with the sentences'
    own, as far as the bundle can tell."""

    sessions: Sessions
    tokenizer: CaptionTokenizer
    manifest: Manifest
    tables: Mapping[str, FloatArray]

    def arrays(self, graph: SemanticGraph) -> GraphArrays:
        """A graph with the features of its caption."""
        return caption_arrays(self.sessions.text_encoder, self.tokenizer, graph)

    def conditions(self, arrays: Sequence[GraphArrays]) -> Conditions:
        """Graph attention over a batch of graphs."""
        (nodes,) = self.sessions.graph_encoder.run(["nodes_out"], padded(arrays))
        return conditions(arrays, finite(nodes, "the graph encoder"))

    def weighted(
        self, graph: SemanticGraph, options: GenerateOptions, own_length: bool
    ) -> tuple[Conditions, Mixture, GenerateOptions]:
        """One graph: a row and a weight for each of the graphs that its weights stand for (`edits.edge_terms`)."""
        terms = edge_terms(graph)
        arrays = [self.arrays(term) for term, _ in terms]
        options = self._own_length(options, arrays[:1]) if own_length else options
        return self.conditions(arrays), Mixture(tuple(weight for _, weight in terms)), options

    def side_by_side(
        self, graphs: Sequence[SemanticGraph], options: Sequence[GenerateOptions], own_length: Sequence[bool]
    ) -> tuple[Conditions, list[GenerateOptions]]:
        """A row for each graph.

        Raises:
            InvalidInputError: a graph weighs its edges, for which it would need several rows.
        """
        if any(node.weight != 1 for graph in graphs for node in graph.nodes):
            raise InvalidInputError("clips that share one run cannot weigh edges; make weighted clips one by one")
        arrays = [self.arrays(graph) for graph in graphs]
        own = [
            self._own_length(each, [known]) if unsaid else each
            for each, known, unsaid in zip(options, arrays, own_length, strict=True)
        ]
        return self.conditions(arrays), own

    def mixed(
        self, what: Composing, graphs: Sequence[SemanticGraph], options: GenerateOptions, own_length: bool
    ) -> tuple[Conditions, Mixture, GenerateOptions]:
        """What is composed: rows in the order of the mixture, for the `graphs` of its parts. The concepts that should
        happen tell the length."""
        terms = [edge_terms(graph) for graph in graphs]
        arrays = [[self.arrays(term) for term, _ in own] for own in terms]
        if own_length:
            wanted = [own[0] for own, concept in zip(arrays, what.concepts, strict=False) if concept.weight > 0]
            options = self._own_length(options, wanted)
        encoded = self.conditions([each for own in arrays for each in own])
        return encoded, what.mixture([[part for _, part in own] for own in terms]), options

    def _own_length(self, options: GenerateOptions, arrays: Sequence[GraphArrays]) -> GenerateOptions:
        return with_own_length(options, self.tables.get(DURATION), self.manifest, arrays)
