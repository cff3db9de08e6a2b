"""Hidden states of captions, computed once: the text encoder is frozen."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

from kinegraph.conditions import MOTION, NO_EDGE, GraphArrays
from kinegraph.text.roles import OTHERS, ROLE_INDEX
from kinegraph_training.caption_graphs import CaptionEncoder


class CaptionStates:
    """Word pieces of many captions, end to end."""

    def __init__(self, captions: Sequence[str], offsets: NDArray[np.int64], states: NDArray[np.float16]) -> None:
        self.numbers = {str(caption): number for number, caption in enumerate(captions)}
        self.offsets, self.states = offsets, states

    def hidden(self, caption: str) -> NDArray[np.float32]:
        """(t, D) of one caption."""
        number = self.numbers[caption]
        return self.states[self.offsets[number] : self.offsets[number + 1]].astype(np.float32)

    def get(self, caption: str) -> GraphArrays:
        """The caption without its graph: the sentence and every word piece as nodes that have no edges."""
        return plain_tokens(self.hidden(caption))


def plain_tokens(hidden: NDArray[np.float32]) -> GraphArrays:
    """(t, D) hidden states -> their mean and themselves, 1 + t nodes of the motion kind."""
    nodes = np.concatenate([hidden.mean(axis=0, keepdims=True), hidden])
    count = len(nodes)
    relation = np.full((count, count), NO_EDGE, dtype=np.int64)
    np.fill_diagonal(relation, ROLE_INDEX[OTHERS])
    return GraphArrays(
        nodes=nodes,
        relation=relation,
        edge_weight=np.ones((count, count), dtype=np.float32),
        kind=np.full(count, MOTION, dtype=np.int64),
        order=np.zeros(count, dtype=np.int64),
        path_weight=np.ones(count, dtype=np.float32),
    )


def caption_states(captions: Sequence[str], assets: Path, cache: Path) -> CaptionStates:
    """Encode distinct captions with the assets' text encoder, or read them back if `cache` holds exactly these."""
    distinct = sorted(set(captions))
    if cache.is_file():
        with np.load(cache, allow_pickle=False) as stored:
            if stored["captions"].tolist() == distinct:
                return CaptionStates(distinct, stored["offsets"], stored["states"])
    encoder = CaptionEncoder(assets)
    rows = [encoder.hidden(caption) for caption in tqdm(distinct, desc="captions", unit="caption")]
    offsets = np.cumsum([0] + [len(row) for row in rows])
    states = np.concatenate(rows).astype(np.float16)
    cache.parent.mkdir(parents=True, exist_ok=True)
    with cache.open("wb") as file:
        np.savez(file, captions=np.array(distinct), offsets=offsets, states=states)
    return CaptionStates(distinct, offsets, states)
