"""Captions encoded once and cached on disk, as neither the parser nor the text encoder is trained.

`CaptionGraphs` hold semantic graphs with node features, `CaptionStates` the hidden states of word pieces, for the
evaluator and for models without a graph. Both come from the files that a bundle will carry, the quantised text encoder
included, one caption at a time, so that a model is trained on what it will see at run time.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from functools import cached_property, partial
from itertools import pairwise
from multiprocessing import get_context
from pathlib import Path

import numpy as np
import onnxruntime
from numpy.typing import NDArray
from tqdm import tqdm

from kinegraph.bundle.sessions import available_cpus
from kinegraph.conditioning import MOTION, NO_EDGE, GraphArrays, encode_caption
from kinegraph.edits import masked
from kinegraph.errors import InvalidInputError, OutputError
from kinegraph.graph import OTHERS, ROLE_INDEX, SemanticGraph
from kinegraph.text.parser import read_parser
from kinegraph.text.tokenizer import CaptionTokenizer

ASSETS = ("text_encoder.onnx", "tokenizer.json", "parser.bin")
OPTIONAL_ASSETS = ("arguments.npz",)
"""Weights of `train_parser`; without them the parser goes by rules."""

_STORED = {"nodes": np.float16, "kind": np.int16, "order": np.int16, "owner": np.int16, "relation": np.int8}
"""Arrays of a graph, and how they are stored: each in a file of its own, all captions end to end."""

CHUNK = 1000
"""Captions that a process encodes before it reports; fewer are encoded in this process."""


def _check_assets(folder: Path) -> None:
    if missing := [name for name in ASSETS if not (folder / name).is_file()]:
        raise InvalidInputError(
            f"{folder} lacks {', '.join(missing)}; write them with `python -m kinegraph_export.text_assets`"
        )


def read_assets(folder: Path) -> dict[str, bytes]:
    """Read the text files of a folder; returns their contents by name.

    Raises:
        InvalidInputError: a file that is not optional is missing.
    """
    _check_assets(folder)
    optional = [name for name in OPTIONAL_ASSETS if (folder / name).is_file()]
    return {name: (folder / name).read_bytes() for name in (*ASSETS, *optional)}


class CaptionEncoder:
    """Parser, tokenizer and text encoder of a folder of text files; a bundle's folder will do."""

    def __init__(self, folder: Path, threads: int = 1) -> None:
        _check_assets(folder)
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

    The arrays are mapped into memory: features of 15 kB a caption, and half a kilobyte of the rest.
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


def encode_graphs(captions: Iterable[str], assets: Path, cache: Path, *, verbs_masked: bool = False) -> CaptionGraphs:
    """Encode the graphs of all distinct captions, and cache them.

    Args:
        captions: may repeat.
        assets: folder of the text files.
        cache: .npz file; captions that it holds from the same assets are read back. Written if any were missing, with
            a file beside it for every array (`array_file`), as these are never all in memory.
        verbs_masked: encode each graph as `mask_verbs` leaves it; it is found under the caption as it was.
    """
    distinct = sorted(set(captions))
    origin = hashlib.sha256(b"".join(read_assets(assets).values()) + bytes([verbs_masked])).hexdigest()
    # the caller's strings, of which there may be a million, in place of those that are read
    own = {caption: index for index, caption in enumerate(distinct)}
    cached = _read_cache(cache, origin)
    if cached is not None and list(cached.captions) == distinct:
        return replace(cached, captions=own)
    known = cached.captions if cached is not None else {}
    fresh = _encode_missing([caption for caption in distinct if caption not in known], assets, verbs_masked)
    cache.parent.mkdir(parents=True, exist_ok=True)
    graphs = (cached.get(text) if cached is not None and text in known else next(fresh) for text in distinct)
    sizes, width = _write_arrays(cache, graphs)
    cache.unlink(missing_ok=True)  # else, stopped here, it would stand beside arrays of other captions
    for name in _STORED:
        _unfinished(cache, name).replace(array_file(cache, name))
    text = np.frombuffer("".join(distinct).encode(), dtype=np.uint8)
    ends = np.cumsum([len(caption.encode()) for caption in distinct], dtype=np.int64)
    with cache.open("wb") as file:
        packed = {"text": text, "text_ends": ends, "offsets": np.cumsum([0, *sizes])}
        np.savez(file, origin=np.array(origin), width=np.array(width), **packed)
    written = _read_cache(cache, origin)
    if written is None:
        raise OutputError(f"{cache} was written, and now is another file: two runs write it at once")
    return replace(written, captions=own)


def array_file(cache: Path, name: str) -> Path:
    """Name the file of an array that belongs to a cache."""
    return cache.with_suffix(f".{name}")


def cache_files(cache: Path) -> list[Path]:
    """List a cache and the files of its arrays."""
    return [cache, *(array_file(cache, name) for name in _STORED)]


def _unfinished(cache: Path, name: str) -> Path:
    return cache.with_suffix(f".{name}.part")


def _encode_missing(missing: Sequence[str], assets: Path, verbs_masked: bool) -> Iterator[GraphArrays]:
    """Encode captions in their order, by a process for each core if there are many."""
    chunks = [missing[start : start + CHUNK] for start in range(0, len(missing), CHUNK)]
    encode = partial(_encode_chunk, assets, verbs_masked)
    with _process_pool(len(chunks)) as pool, tqdm(desc="captions", unit="caption", total=len(missing)) as progress:
        for graphs in pool.map(encode, chunks) if pool else map(encode, chunks):
            yield from graphs
            progress.update(len(graphs))


def _write_arrays(cache: Path, graphs: Iterable[GraphArrays]) -> tuple[list[int], int]:
    """Write the arrays of graphs to files, one graph after another; returns nodes by graph, and the features' width."""
    sizes: list[int] = []
    width = 0
    with ExitStack() as stack:
        files = {name: stack.enter_context(_unfinished(cache, name).open("wb")) for name in _STORED}
        for graph in graphs:
            sizes.append(len(graph.kind))
            width = graph.nodes.shape[1]
            for name, kind in _STORED.items():
                files[name].write(getattr(graph, name).astype(kind).tobytes())
    return sizes, width


def _read_cache(cache: Path, origin: str) -> CaptionGraphs | None:
    """Read a cache of graphs; None without one of these assets."""
    if not cache.is_file():
        return None
    with np.load(cache, allow_pickle=False) as stored:
        if "origin" not in stored or str(stored["origin"]) != origin:
            return None
        small = dict(stored)
    offsets = small["offsets"].astype(np.int64)
    rows, pairs = int(offsets[-1]), int((np.diff(offsets) ** 2).sum())
    shapes = {"nodes": (rows, int(small.get("width", 0))), "relation": (pairs,)}
    arrays = {}
    for name, kind in _STORED.items():
        # version 0.7.0 kept all arrays in the .npz
        array = small[name] if name in small else _map_array(array_file(cache, name), kind, shapes.get(name, (rows,)))
        if array is None:
            return None
        arrays[name] = array
    texts = small["captions"].tolist() if "captions" in small else _split_text(small["text"], small["text_ends"])
    return CaptionGraphs({caption: index for index, caption in enumerate(texts)}, offsets, **arrays)


def _map_array(path: Path, kind: type[np.generic], shape: tuple[int, ...]) -> np.ndarray | None:
    """Map an array into memory; None if the file is missing or holds another number of values."""
    size = int(np.prod(shape))
    if not path.is_file() or path.stat().st_size != size * np.dtype(kind).itemsize:
        return None
    return np.memmap(path, dtype=kind, mode="r", shape=shape) if size else np.zeros(shape, dtype=kind)


def _split_text(text: NDArray[np.uint8], ends: NDArray[np.int64]) -> list[str]:
    """Split the UTF-8 of captions end to end; in an array of strings each would have the size of the longest."""
    data = text.tobytes()
    return [data[start:end].decode() for start, end in pairwise([0, *ends.tolist()])]


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


def encode_states(captions: Iterable[str], assets: Path, cache: Path) -> CaptionStates:
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
