"""Captions as graphs with node features, computed once: neither the parser nor the text encoder is trained.

The features come from exactly the files a bundle will carry (the quantised encoder included), one caption at a time,
so that what is trained on is what will be seen.

Hidden states of captions, computed once: the text encoder is frozen."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from multiprocessing import get_context
from pathlib import Path

import numpy as np
import onnxruntime
from numpy.typing import NDArray
from tqdm import tqdm

from kinegraph.bundle.sessions import available_cpus
from kinegraph.conditioning import MOTION, NO_EDGE, GraphArrays, node_features
from kinegraph.edits import masked
from kinegraph.errors import InvalidInputError
from kinegraph.graph import OTHERS, ROLE_INDEX, SemanticGraph
from kinegraph.text.parser import read_parser
from kinegraph.text.tokenizer import CaptionTokenizer, TokenIds

ASSETS = ("text_encoder.onnx", "tokenizer.json", "parser.bin")
OPTIONAL_ASSETS = ("arguments.npz",)
"""Weights of `train_parser`; the parser goes by rules without them."""

PART = 1000
"""Captions that a process encodes before it reports; with fewer there is one process."""


def read_assets(folder: Path) -> dict[str, bytes]:
    """Content of the text files by name.

    Raises:
        OSError: one that is not optional is missing.
    """
    optional = [name for name in OPTIONAL_ASSETS if (folder / name).is_file()]
    return {name: (folder / name).read_bytes() for name in (*ASSETS, *optional)}


class CaptionEncoder:
    """Parser, tokenizer and text encoder of a folder of assets (a bundle's folder will do)."""

    def __init__(self, folder: Path, threads: int = 1) -> None:
        missing = [name for name in ASSETS if not (folder / name).is_file()]
        if missing:
            raise InvalidInputError(
                f"{folder} lacks {', '.join(missing)}; write them with `python -m kinegraph_export.text_assets`"
            )
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = threads
        self.session = onnxruntime.InferenceSession(
            (folder / "text_encoder.onnx").read_bytes(), options, providers=["CPUExecutionProvider"]
        )
        self.tokenizer = CaptionTokenizer((folder / "tokenizer.json").read_bytes())
        self.parser = read_parser(folder)

    def __call__(self, caption: str | SemanticGraph) -> GraphArrays:
        """Parse and encode one caption; a graph is encoded as it is."""
        graph = caption if isinstance(caption, SemanticGraph) else self.parser.parse(caption)
        tokens = self.tokenizer.encode(graph.caption)
        hidden, pooled = self.session.run(["hidden", "pooled"], _feeds(tokens))
        return node_features(graph, tokens, hidden[0], pooled[0])

    def hidden(self, caption: str) -> NDArray[np.float32]:
        """(T, D) hidden states of one caption."""
        states: NDArray[np.float32] = self.session.run(["hidden"], _feeds(self.tokenizer.encode(caption)))[0][0]
        return states


def _feeds(tokens: TokenIds) -> dict[str, NDArray[np.int64]]:
    return {"input_ids": tokens.ids[None], "attention_mask": tokens.mask[None]}


@dataclass(frozen=True)
class CaptionGraphs:
    """Graphs of many captions, end to end: caption i owns rows offsets[i]:offsets[i + 1] of the node arrays."""

    captions: dict[str, int]
    offsets: NDArray[np.int64]
    nodes: NDArray[np.float16]
    """(rows, D)."""
    kind: NDArray[np.int64]
    order: NDArray[np.int64]
    relation: list[NDArray[np.int64]]
    """Per caption (N, N)."""

    def get(self, caption: str) -> GraphArrays:
        """One caption's graph, all weights 1."""
        index = self.captions[caption]
        rows = slice(self.offsets[index], self.offsets[index + 1])
        count = self.offsets[index + 1] - self.offsets[index]
        return GraphArrays(
            nodes=self.nodes[rows].astype(np.float32),
            relation=self.relation[index],
            edge_weight=np.ones((count, count), dtype=np.float32),
            kind=self.kind[rows],
            order=self.order[rows],
            path_weight=np.ones(count, dtype=np.float32),
        )


def without_verbs(graph: SemanticGraph) -> SemanticGraph:
    """The graph of the same caption with every action's text masked; nodes and edges stay (GraphMotion, Table 6)."""
    for number in range(1, len(graph.actions) + 1):
        graph = masked(graph, number)
    return graph


def encode_captions(captions: Sequence[str], assets: Path, cache: Path, *, verbs_masked: bool = False) -> CaptionGraphs:
    """Encode distinct captions, but for those that `cache` holds of the same assets; `verbs_masked`: see
    `without_verbs`, each under the caption as it is."""
    distinct = sorted(set(captions))
    origin = hashlib.sha256(b"".join(read_assets(assets).values()) + bytes([verbs_masked])).hexdigest()
    known = _read(cache, origin)
    if known is not None and list(known.captions) == distinct:
        return known
    found = {caption: known.get(caption) for caption in distinct if caption in known.captions} if known else {}
    missing = [caption for caption in distinct if caption not in found]
    parts = [missing[place : place + PART] for place in range(0, len(missing), PART)]
    encode = partial(_encoded, assets, verbs_masked)
    with _processes(len(parts)) as pool, tqdm(desc="captions", unit="caption", total=len(missing)) as progress:
        for part, encoded in zip(parts, pool.map(encode, parts) if pool else map(encode, parts), strict=True):
            found.update(zip(part, encoded, strict=True))
            progress.update(len(part))
    graphs = [found[caption] for caption in distinct]
    packed = {
        "origin": np.array(origin),
        "captions": np.array(distinct),
        "offsets": np.cumsum([0] + [len(graph.kind) for graph in graphs]),
        "nodes": np.concatenate([graph.nodes for graph in graphs]).astype(np.float16),
        "kind": np.concatenate([graph.kind for graph in graphs]),
        "order": np.concatenate([graph.order for graph in graphs]),
        "relation": np.concatenate([graph.relation.ravel() for graph in graphs]).astype(np.int8),
    }
    cache.parent.mkdir(parents=True, exist_ok=True)
    with cache.open("wb") as file:
        np.savez(file, **packed)
    return _unpacked(packed)


def _read(cache: Path, origin: str) -> CaptionGraphs | None:
    """What was kept, if it is of these assets."""
    if not cache.is_file():
        return None
    with np.load(cache, allow_pickle=False) as stored:
        return _unpacked(dict(stored)) if "origin" in stored and str(stored["origin"]) == origin else None


def _encoded(assets: Path, verbs_masked: bool, captions: Sequence[str]) -> list[GraphArrays]:
    """Each caption on its own, whatever others there are."""
    encoder = CaptionEncoder(assets)
    parsed = (encoder.parser.parse(caption) for caption in captions)
    return [encoder(without_verbs(graph) if verbs_masked else graph) for graph in parsed]


@contextmanager
def _processes(parts: int) -> Iterator[ProcessPoolExecutor | None]:
    """One for each core, if there is work for them: a parser in Python keeps threads waiting for one another."""
    count = min(parts, available_cpus())
    if count < 2:
        yield None
        return
    with ProcessPoolExecutor(count, mp_context=get_context("spawn")) as pool:
        yield pool


def _unpacked(packed: dict[str, np.ndarray]) -> CaptionGraphs:
    offsets = packed["offsets"].astype(np.int64)
    sizes = np.diff(offsets)
    flat = np.split(packed["relation"].astype(np.int64), np.cumsum(sizes**2)[:-1])
    return CaptionGraphs(
        captions={str(caption): index for index, caption in enumerate(packed["captions"])},
        offsets=offsets,
        nodes=packed["nodes"],
        kind=packed["kind"].astype(np.int64),
        order=packed["order"].astype(np.int64),
        relation=[part.reshape(size, size) for part, size in zip(flat, sizes, strict=True)],
    )


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
