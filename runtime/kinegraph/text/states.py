"""Captions -> node features: tokens, text encoder, means over character spans (GraphMotion, section 3.1)."""

from __future__ import annotations

import numpy as np
import onnxruntime

from kinegraph.conditions import GraphArrays, graph_arrays
from kinegraph.graph import SemanticGraph
from kinegraph.text.tokens import CaptionTokenizer


def caption_arrays(
    encoder: onnxruntime.InferenceSession, tokenizer: CaptionTokenizer, graph: SemanticGraph
) -> GraphArrays:
    """A graph with the features of its caption.

    One caption a run: among others its sums are rounded in another order, and what the encoder then rounds to int8 can
    be a whole step off (measured: .03 of a state, 5 mm in a clip). A shared run would save a sixth of the encoder.

    Args:
        encoder: session of the text encoder.
        tokenizer: of the same bundle.
    """
    tokens = tokenizer.encode(graph.caption)
    feeds = {"input_ids": np.array([tokens.ids]), "attention_mask": np.array([tokens.mask])}
    hidden, pooled = encoder.run(["hidden", "pooled"], feeds)
    return graph_arrays(graph, tokens, hidden[0], pooled[0])
