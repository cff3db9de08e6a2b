"""Captions encoded once and cached on disk, as neither the parser nor the text encoder is trained.

`CaptionGraphs` hold semantic graphs with node features, `CaptionStates` the hidden states of word pieces, for the
evaluator and for models without a graph. Both come from the files that a bundle will carry, the quantised text encoder
included, one caption at a time, so that a model is trained on what it will see at run time.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property, partial
from multiprocessing import get_context
from pathlib import Path
from typing import BinaryIO

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

_SMALL = {"kind": np.int16, "order": np.int16, "owner": np.int16, "relation": np.int8}
"""Arrays of a graph beside its features, and how they are stored."""

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
    """Graphs of many captions, end to end: caption i owns rows offsets[i]:offsets[i + 1] of the node arrays.

    Features are memory-mapped, 15 kB a caption; all else is small.
    """

    captions: dict[str, int]
    """Index i of each caption."""
    offsets: NDArray[np.int64]
    """(captions + 1,)."""
    nodes: NDArray[np.float16]
    """(rows, D) features."""
    kind: NDArray[np.int16]
    """(rows,) see `GraphArrays`."""
    order: NDArray[np.int16]
    """(rows,) see `GraphArrays`."""
    owner: NDArray[np.int16]
    """(rows,) see `GraphArrays`."""
    relation: NDArray[np.int8]
    """The (N, N) of each caption, flat and end to end."""

    @cached_property
    def relation_ends(self) -> NDArray[np.int64]:
        """Where the relations of each caption end, (captions,)."""
        return np.cumsum(np.diff(self.offsets) ** 2)

    def get(self, caption: str) -> GraphArrays:
        """Return the graph of one caption, with all weights 1."""
        index = self.captions[caption]
        rows = slice(self.offsets[index], self.offsets[index + 1])
        count = self.offsets[index + 1] - self.offsets[index]
        end = self.relation_ends[index]
        return GraphArrays(
            nodes=self.nodes[rows].astype(np.float32),
            relation=self.relation[end - count**2 : end].astype(np.int64).reshape(count, count),
            edge_weight=np.ones((count, count), dtype=np.float32),
            kind=self.kind[rows].astype(np.int64),
            order=self.order[rows].astype(np.int64),
            path_weight=np.ones(count, dtype=np.float32),
            owner=self.owner[rows].astype(np.int64),
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
        cache: .npz file; captions that it holds from the same assets are read back. Written if any were missing, and
            a file beside it (`.nodes`) with the features, which are never all in memory.
        verbs_masked: encode each graph as `mask_verbs` leaves it; it is found under the caption as it was.
    """
    distinct = sorted(set(captions))
    origin = hashlib.sha256(b"".join(read_assets(assets).values()) + bytes([verbs_masked])).hexdigest()
    cached = _read_cache(cache, origin)
    if cached is not None and list(cached.captions) == distinct:
        return cached
    known = cached.captions if cached is not None else {}
    fresh = _encode_missing([caption for caption in distinct if caption not in known], assets, verbs_masked)
    cache.parent.mkdir(parents=True, exist_ok=True)
    with nodes_file(cache).with_suffix(".part").open("wb") as nodes:
        graphs = (cached.get(text) if cached is not None and text in known else next(fresh) for text in distinct)
        packed = _pack(graphs, nodes)
    nodes_file(cache).with_suffix(".part").replace(nodes_file(cache))
    with cache.open("wb") as file:
        np.savez(file, origin=np.array(origin), captions=np.array(distinct), **packed)
    return _read_cache(cache, origin) or cached_graphs({"captions": np.array(distinct), **packed}, np.zeros((0, 0)))


def nodes_file(cache: Path) -> Path:
    """Name the file of the features that belong to a cache."""
    return cache.with_suffix(".nodes")


def _encode_missing(missing: Sequence[str], assets: Path, verbs_masked: bool) -> Iterator[GraphArrays]:
    """Encode captions in their order, by a process for each core if there are many."""
    chunks = [missing[start : start + CHUNK] for start in range(0, len(missing), CHUNK)]
    encode = partial(_encode_chunk, assets, verbs_masked)
    with _process_pool(len(chunks)) as pool, tqdm(desc="captions", unit="caption", total=len(missing)) as progress:
        for graphs in pool.map(encode, chunks) if pool else map(encode, chunks):
            yield from graphs
            progress.update(len(graphs))


def _pack(graphs: Iterable[GraphArrays], nodes: BinaryIO) -> dict[str, np.ndarray]:
    """Write the features of graphs to a file, one after another; returns the small arrays of all of them."""
    sizes, width = [0], 0
    flat = {name: bytearray() for name in _SMALL}
    for graph in graphs:
        nodes.write(graph.nodes.astype(np.float16).tobytes())
        sizes.append(len(graph.kind))
        width = graph.nodes.shape[1]
        for name, kind in _SMALL.items():
            flat[name] += getattr(graph, name).astype(kind).tobytes()
    arrays = {name: np.frombuffer(bytes(flat[name]), dtype=kind) for name, kind in _SMALL.items()}
    return {"offsets": np.cumsum(sizes), "width": np.array(width), **arrays}


def _read_cache(cache: Path, origin: str) -> CaptionGraphs | None:
    """Read a cache of graphs; None without one of these assets."""
    if not cache.is_file():
        return None
    with np.load(cache, allow_pickle=False) as stored:
        if not {"origin", "owner"} <= set(stored) or str(stored["origin"]) != origin:
            return None
        arrays = dict(stored)
    if "nodes" in arrays:  # of 0.7.0 and before
        return cached_graphs(arrays, arrays["nodes"])
    shape = (int(arrays["offsets"][-1]), int(arrays["width"]))
    path = nodes_file(cache)
    if not shape[0] or not path.is_file() or path.stat().st_size != 2 * shape[0] * shape[1]:
        return None
    return cached_graphs(arrays, np.memmap(path, dtype=np.float16, mode="r", shape=shape))


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


def cached_graphs(arrays: Mapping[str, np.ndarray], nodes: NDArray[np.float16]) -> CaptionGraphs:
    """Make graphs of the small arrays of a cache, and of the features (rows, D)."""
    small = {name: arrays[name].astype(kind, copy=False) for name, kind in _SMALL.items()}
    captions = {str(caption): index for index, caption in enumerate(arrays["captions"])}
    return CaptionGraphs(captions, arrays["offsets"].astype(np.int64), nodes, **small)


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
