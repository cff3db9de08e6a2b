"""Captions -> node features: tokens, text encoder, means over character spans (GraphMotion, section 3.1)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import onnxruntime

from kinegraph.conditions import GraphArrays, graph_arrays
from kinegraph.graph import SemanticGraph
from kinegraph.text.tokens import CaptionTokenizer


def caption_arrays(
    encoder: onnxruntime.InferenceSession, tokenizer: CaptionTokenizer, graphs: Sequence[SemanticGraph]
) -> list[GraphArrays]:
    """Each graph with the features of its own caption, all captions in one run.

    Args:
        encoder: session of the text encoder.
        tokenizer: of the same bundle.
        graphs: shorter captions are padded, which their own pieces do not see.
    """
    tokens = [tokenizer.encode(graph.caption) for graph in graphs]
    longest = max(len(each.ids) for each in tokens)
    ids = np.zeros((len(tokens), longest), dtype=np.int64)
    mask = np.zeros_like(ids)
    for row, each in enumerate(tokens):
        ids[row, : len(each.ids)] = each.ids
        mask[row, : len(each.ids)] = each.mask
    hidden, pooled = encoder.run(["hidden", "pooled"], {"input_ids": ids, "attention_mask": mask})
    return [
        graph_arrays(graph, each, states[: len(each.ids)], mean)
        for graph, each, states, mean in zip(graphs, tokens, hidden, pooled, strict=True)
    ]
