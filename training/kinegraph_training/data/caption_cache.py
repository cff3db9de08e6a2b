"""Captions encoded once and cached on disk, as neither the parser nor the text encoder is trained.

`CaptionGraphs` hold semantic graphs with node features, `CaptionStates` the hidden states of word pieces, for the
evaluator and for models without a graph. Both come from the files that a bundle will carry, the quantised text encoder
included, one caption at a time, so that a model is trained on what it will see at run time.
"""

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
from kinegraph.conditioning import MOTION, NO_EDGE, GraphArrays, encode_caption
from kinegraph.edits import masked
from kinegraph.errors import InvalidInputError
from kinegraph.graph import OTHERS, ROLE_INDEX, SemanticGraph
from kinegraph.text.parser import read_parser
from kinegraph.text.tokenizer import CaptionTokenizer

ASSETS = ("text_encoder.onnx", "tokenizer.json", "parser.bin")
OPTIONAL_ASSETS = ("arguments.npz",)
"""Weights of `train_parser`; without them the parser goes by rules."""

CHUNK = 1000
"""Captions that a process encodes before it reports; fewer are encoded in this process."""


def read_assets(folder: Path) -> dict[str, bytes]:
    """Read the text files of a folder; returns their contents by name.

    Raises:
        OSError: a file that is not optional is missing.
    """
    optional = [name for name in OPTIONAL_ASSETS if (folder / name).is_file()]
    return {name: (folder / name).read_bytes() for name in (*ASSETS, *optional)}


class CaptionEncoder:
    """Parser, tokenizer and text encoder of a folder of text files; a bundle's folder will do."""

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

    def encode(self, caption: str | SemanticGraph) -> GraphArrays:
        """Parse a caption, unless it is a graph already, and encode its graph."""
        graph = caption if isinstance(caption, SemanticGraph) else self.parser.parse(caption)
        return encode_caption(self.session, self.tokenizer, graph, words=True)

    def hidden_states(self, caption: str) -> NDArray[np.float32]:
        """Encode a caption to the hidden states (T, D) of its word pieces."""
        tokens = self.tokenizer.encode(caption)
        inputs = {"input_ids": np.array([tokens.ids]), "attention_mask": np.array([tokens.mask])}
        states: NDArray[np.float32] = self.session.run(["hidden"], inputs)[0][0]
        return states


@dataclass(frozen=True)
class CaptionGraphs:
    """Graphs of many captions, end to end: caption i owns rows offsets[i]:offsets[i + 1] of the node arrays."""

    captions: dict[str, int]
    """Index i of each caption."""
    offsets: NDArray[np.int64]
    """(captions + 1,)."""
    nodes: NDArray[np.float16]
    """(rows, D) features."""
    kind: NDArray[np.int64]
    """(rows,) see `GraphArrays`."""
    order: NDArray[np.int64]
    """(rows,) see `GraphArrays`."""
    owner: NDArray[np.int64]
    """(rows,) see `GraphArrays`."""
    relation: list[NDArray[np.int64]]
    """Per caption (N, N)."""

    def get(self, caption: str) -> GraphArrays:
        """Return the graph of one caption, with all weights 1."""
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
            owner=self.owner[rows],
        )


def mask_verbs(graph: SemanticGraph) -> SemanticGraph:
    """Mask the text of every action; nodes and edges stay (GraphMotion, Table 6)."""
    for number in range(1, len(graph.actions) + 1):
        graph = masked(graph, number)
    return graph


def encode_graphs(captions: Sequence[str], assets: Path, cache: Path, *, verbs_masked: bool = False) -> CaptionGraphs:
    """Encode the graphs of all distinct captions, and cache them.

    Args:
        captions: may repeat.
        assets: folder of the text files.
        cache: .npz file; captions that it holds from the same assets are read back. Written if any were missing.
        verbs_masked: encode each graph as `mask_verbs` leaves it; it is found under the caption as it was.
    """
    distinct = sorted(set(captions))
    origin = hashlib.sha256(b"".join(read_assets(assets).values()) + bytes([verbs_masked])).hexdigest()
    cached = _read_cache(cache, origin)
    if cached is not None and list(cached.captions) == distinct:
        return cached
    encoded = {caption: cached.get(caption) for caption in distinct if caption in cached.captions} if cached else {}
    missing = [caption for caption in distinct if caption not in encoded]
    chunks = [missing[start : start + CHUNK] for start in range(0, len(missing), CHUNK)]
    encode = partial(_encode_chunk, assets, verbs_masked)
    with _process_pool(len(chunks)) as pool, tqdm(desc="captions", unit="caption", total=len(missing)) as progress:
        for chunk, graphs in zip(chunks, pool.map(encode, chunks) if pool else map(encode, chunks), strict=True):
            encoded.update(zip(chunk, graphs, strict=True))
            progress.update(len(chunk))
    ordered = [encoded[caption] for caption in distinct]
    packed = {
        "origin": np.array(origin),
        "captions": np.array(distinct),
        "offsets": np.cumsum([0] + [len(graph.kind) for graph in ordered]),
        "nodes": np.concatenate([graph.nodes for graph in ordered]).astype(np.float16),
        "kind": np.concatenate([graph.kind for graph in ordered]),
        "order": np.concatenate([graph.order for graph in ordered]),
        "owner": np.concatenate([graph.owner for graph in ordered]),
        "relation": np.concatenate([graph.relation.ravel() for graph in ordered]).astype(np.int8),
    }
    cache.parent.mkdir(parents=True, exist_ok=True)
    with cache.open("wb") as file:
        np.savez(file, **packed)
    return _unpack(packed)


def _read_cache(cache: Path, origin: str) -> CaptionGraphs | None:
    """Read a cache of graphs; None without one of these assets."""
    if not cache.is_file():
        return None
    with np.load(cache, allow_pickle=False) as stored:
        known = {"origin", "owner"} <= set(stored) and str(stored["origin"]) == origin
        return _unpack(dict(stored)) if known else None


def _encode_chunk(assets: Path, verbs_masked: bool, captions: Sequence[str]) -> list[GraphArrays]:
    """Encode captions one by one, each independent of the others."""
    encoder = CaptionEncoder(assets)
    graphs = (encoder.parser.parse(caption) for caption in captions)
    return [encoder.encode(mask_verbs(graph) if verbs_masked else graph) for graph in graphs]


@contextmanager
def _process_pool(chunks: int) -> Iterator[ProcessPoolExecutor | None]:
    """Start a process per core if there are several chunks; threads would wait for one another in the parser."""
    count = min(chunks, available_cpus())
    if count < 2:
        yield None
        return
    with ProcessPoolExecutor(count, mp_context=get_context("spawn")) as pool:
        yield pool


def _unpack(packed: dict[str, np.ndarray]) -> CaptionGraphs:
    """Make graphs of the arrays of a cache."""
    offsets = packed["offsets"].astype(np.int64)
    sizes = np.diff(offsets)
    relations = np.split(packed["relation"].astype(np.int64), np.cumsum(sizes**2)[:-1])
    return CaptionGraphs(
        captions={str(caption): index for index, caption in enumerate(packed["captions"])},
        offsets=offsets,
        nodes=packed["nodes"],
        kind=packed["kind"].astype(np.int64),
        order=packed["order"].astype(np.int64),
        owner=packed["owner"].astype(np.int64),
        relation=[flat.reshape(size, size) for flat, size in zip(relations, sizes, strict=True)],
    )


class CaptionStates:
    """Hidden states of many captions, end to end: caption i owns rows offsets[i]:offsets[i + 1] of (rows, D)."""

    def __init__(self, captions: Sequence[str], offsets: NDArray[np.int64], states: NDArray[np.float16]) -> None:
        self.captions = {str(caption): index for index, caption in enumerate(captions)}
        self.offsets, self.states = offsets, states

    def hidden_states(self, caption: str) -> NDArray[np.float32]:
        """Return the hidden states (T, D) of one caption."""
        index = self.captions[caption]
        return self.states[self.offsets[index] : self.offsets[index + 1]].astype(np.float32)

    def get(self, caption: str) -> GraphArrays:
        """Return a caption as nodes without edges: the sentence and every word piece."""
        return tokens_as_graph(self.hidden_states(caption))


def tokens_as_graph(hidden: NDArray[np.float32]) -> GraphArrays:
    """Make 1 + T nodes of the motion kind, without edges, from hidden states (T, D): their mean, then each of them."""
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
        owner=np.arange(count),
    )


def encode_states(captions: Sequence[str], assets: Path, cache: Path) -> CaptionStates:
    """Encode the hidden states of all distinct captions, and cache them.

    Args:
        captions: may repeat.
        assets: folder of the text files.
        cache: .npz file; read back if it holds exactly these captions, else written.
    """
    distinct = sorted(set(captions))
    if cache.is_file():
        with np.load(cache, allow_pickle=False) as stored:
            if stored["captions"].tolist() == distinct:
                return CaptionStates(distinct, stored["offsets"], stored["states"])
    encoder = CaptionEncoder(assets)
    rows = [encoder.hidden_states(caption) for caption in tqdm(distinct, desc="captions", unit="caption")]
    offsets = np.cumsum([0] + [len(row) for row in rows])
    states = np.concatenate(rows).astype(np.float16)
    cache.parent.mkdir(parents=True, exist_ok=True)
    with cache.open("wb") as file:
        np.savez(file, captions=np.array(distinct), offsets=offsets, states=states)
    return CaptionStates(distinct, offsets, states)
