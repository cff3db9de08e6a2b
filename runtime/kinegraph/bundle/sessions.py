"""onnxruntime sessions of a bundle: opened once, checked against the contract, shared by all threads."""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Mapping, MutableMapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from types import MappingProxyType
from typing import Any, Final, Generic, TypeVar

import onnxruntime
from numpy.typing import NDArray
from onnxruntime.capi import onnxruntime_pybind11_state as _state

from kinegraph.arrays import FloatArray
from kinegraph.bundle.contract import (
    AGD_CONTEXTS,
    AGD_DENOISERS,
    COARSE_DECODERS,
    DECODER_GRADIENTS,
    ENCODER,
    FRAME_GRAPHS,
    LEVELS,
    WEIGHT_SOURCES,
    GraphContract,
    check_signature,
    levels_of,
)
from kinegraph.bundle.onnx_inspect import with_initializers
from kinegraph.bundle.onnx_split import split_gradient
from kinegraph.bundle.reader import Bundle
from kinegraph.errors import BundleError, InvalidInputError, KinegraphError, ModelError
from kinegraph.validation import require_finite, short_repr

MAX_THREADS: Final = 256

ORT_ERRORS: Final[tuple[type[Exception], ...]] = (
    *(kind for kind in vars(_state).values() if isinstance(kind, type) and issubclass(kind, Exception)),
    RuntimeError,
    ValueError,
)
"""Exceptions that onnxruntime raises; its own classes share no base but `Exception`."""

# onnxruntime's SkipLayerNormalization is slower than Add + LayerNormalization at these sizes. The gap grows after
# quantising, because without it the matrix product before it can absorb the bias.
DISABLED_OPTIMIZERS: Final = ["SkipLayerNormFusion"]

_ERRORS_ONLY: Final = 3


Opened = TypeVar("Opened")


class Lazy(Generic[Opened]):
    """What is opened once, at its first use, by whichever thread asks first."""

    def __init__(self, open_now: Callable[[], Opened]) -> None:
        self._open_now = open_now
        self._lock = threading.Lock()
        self._opened: Opened | None = None

    def __call__(self) -> Opened:
        with self._lock:
            if self._opened is None:
                self._opened = self._open_now()
            return self._opened


LazySession = Lazy[onnxruntime.InferenceSession]


@dataclass(frozen=True)
class DifferentiableDecoder:
    """A decoder that keeps what its gradient needs, so that it runs once for both (`onnx_split`)."""

    forward: onnxruntime.InferenceSession
    backward: onnxruntime.InferenceSession
    kept: tuple[str, ...]
    """Outputs of the first that the second reads."""

    def decode(self, inputs: Mapping[str, FloatArray]) -> tuple[FloatArray, Callable[[FloatArray], FloatArray]]:
        """Decode latents.

        Args:
            inputs: of the decoder (`contract.decoder`).

        Returns:
            Normalised features (B, L, F), and the function that carries a cotangent of them back to the latents.

        Raises:
            ModelError, NonFiniteError: see `run_model`; so does the function.
        """
        values: dict[str, FloatArray] = dict(inputs)
        names = ["features", *self.kept]
        results = _run_typed(self.forward, names, values, "the decoder")
        values.update(zip(names, results, strict=True))
        features = require_finite(results[0], "the decoder")

        def back(cotangent: FloatArray) -> FloatArray:
            values["cotangent"] = cotangent
            read = {tensor.name: values[tensor.name] for tensor in self.backward.get_inputs()}
            return run_model(self.backward, ["gradient"], read, "the gradient of the decoder")[0]

        return features, back


@dataclass(frozen=True)
class Sessions:
    """One session per graph; any number of threads may call `run` on them.

    The names are those of the graphs in `kinegraph.bundle.contract`.
    """

    text_encoder: onnxruntime.InferenceSession
    graph_encoder: onnxruntime.InferenceSession | None
    """None for networks of the family "mld"."""
    context: Mapping[str, onnxruntime.InferenceSession]
    """Level -> context encoder."""
    modulation: Mapping[str, onnxruntime.InferenceSession]
    """Level -> AdaLN modulation."""
    denoiser: Mapping[str, onnxruntime.InferenceSession]
    """Level -> denoiser."""
    decoder: onnxruntime.InferenceSession
    """Decoder of the finest level."""
    coarse_decoders: Mapping[str, LazySession]
    """Level -> decoder; only levels for which the bundle has one."""
    context_agd: Mapping[str, LazySession]
    """Level -> context encoder for adaptive gradient descent; empty if the bundle has none."""
    denoiser_agd: Mapping[str, LazySession]
    """Level -> denoiser with adaptive gradient descent; empty if the bundle has none."""
    decoder_gradients: Mapping[str, Lazy[DifferentiableDecoder]]
    """Level -> decoder with its vector-Jacobian product; empty if the bundle has none."""
    encoder: LazySession | None
    """Encoder of the finest level; None if the bundle has none."""
    frames: Mapping[str, LazySession] = field(default_factory=dict)
    """Name of a graph -> session of skeleton space (`frames_part`); empty if the bundle has none."""

    @property
    def lazy(self) -> tuple[LazySession | Lazy[DifferentiableDecoder], ...]:
        """All sessions that are opened at their first use."""
        by_level = (self.coarse_decoders, self.context_agd, self.denoiser_agd, self.decoder_gradients)
        of_levels = [session for sessions in by_level for session in sessions.values()]
        return (*of_levels, *([] if self.encoder is None else [self.encoder]), *self.frames.values())

    def decoder_of(self, level: str) -> onnxruntime.InferenceSession:
        """Return the decoder of a level; the bundle must have one."""
        coarse = self.coarse_decoders.get(level)
        return self.decoder if coarse is None else coarse()


def available_cpus() -> int:
    """Count the CPUs that this process may run on."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def session_options(threads: int, *, spinning: bool = True) -> onnxruntime.SessionOptions:
    """Set the options of one session: its thread pool spins while a run lasts and sleeps between runs.

    By default onnxruntime's idle pools spin between runs too. With one session per graph they take the cores from the
    busy one (measured: three times slower on two cores, and half a core used between requests). Pools that never spin
    are woken for every operator: one sample at the published size takes 38 ms instead of 28 ms. However,
    non-spinning pools degrade least under load.

    Args:
        threads: size of the pool.
        spinning: False makes the pool sleep between operators too.
    """
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = threads
    options.inter_op_num_threads = 1
    options.execution_mode = onnxruntime.ExecutionMode.ORT_SEQUENTIAL
    options.log_severity_level = _ERRORS_ONLY
    options.add_session_config_entry("session.intra_op.allow_spinning", "1" if spinning and threads > 1 else "0")
    options.add_session_config_entry("session.inter_op.allow_spinning", "0")
    options.add_session_config_entry("session.force_spinning_stop", "1")
    return options


def open_sessions(
    bundle: Bundle,
    *,
    threads: int | None = None,
    options: onnxruntime.SessionOptions | None = None,
    files: MutableMapping[str, bytes] | None = None,
) -> Sessions:
    """Open the sessions of a bundle.

    Args:
        bundle: read and checked by `read_bundle`.
        threads: threads of every session. None takes at most two that never spin, and one for the denoisers: these are
            too small to gain much from a second thread, and with one they degrade less on a busy machine.
        options: the caller's own options, used unchanged for every session; excludes `threads`.
        files: content to use instead of `bundle.files`; each graph is removed once its session is open, to save memory.

    Raises:
        InvalidInputError: `threads` is not 1 to 256, or used together with `options`.
        BundleError: onnxruntime refuses a graph.
        BundleFormatError: a graph's inputs or outputs differ from the contract.
    """
    if threads is not None and options is not None:
        raise InvalidInputError("give either threads or session_options: the options hold a thread count already")
    if not isinstance(options, onnxruntime.SessionOptions | None):
        raise InvalidInputError(f"session_options must be onnxruntime.SessionOptions, not {short_repr(options)}")
    wide = options or session_options(_thread_count(threads, min(2, available_cpus())), spinning=threads is not None)
    narrow = options or session_options(_thread_count(threads, 1))
    contracts, family = bundle.manifest.contracts, bundle.manifest.family
    levels = levels_of(family)
    # Released denoisers are a hundred times ours, so that a second thread pays.
    steps = narrow if family == "kinegraph" else wide

    def open_graph(graph: str, settings: onnxruntime.SessionOptions) -> onnxruntime.InferenceSession:
        contract = contracts[graph]
        data = bundle.files.get(contract.file) if files is None else files.pop(contract.file, None)
        return open_session(data or bundle.read_later(contract.file), contract, settings)

    def lazy(graphs: Mapping[str, str], settings: onnxruntime.SessionOptions) -> Mapping[str, LazySession]:
        def at_first_use(contract: GraphContract) -> LazySession:
            return LazySession(lambda: open_session(_read_graph(bundle, contract), contract, settings))

        present = {level: contracts[graph] for level, graph in graphs.items() if graph in contracts}
        return MappingProxyType({level: at_first_use(contract) for level, contract in present.items()})

    def open_gradient(contract: GraphContract) -> DifferentiableDecoder:
        return open_differentiable(_read_graph(bundle, contract), contract, wide)

    gradients = {
        level: Lazy(partial(open_gradient, contracts[graph]))
        for level, graph in DECODER_GRADIENTS.items()
        if graph in contracts
    }
    # Opening a session takes its file twice more, so the largest go first.
    denoisers = {level: open_graph(f"denoiser_{level}", steps) for level in levels}
    return Sessions(
        text_encoder=open_graph("text_encoder", wide),
        graph_encoder=open_graph("graph_encoder", wide) if "graph_encoder" in contracts else None,
        context=MappingProxyType({level: open_graph(f"context_{level}", wide) for level in levels}),
        modulation=MappingProxyType({level: open_graph(f"modulation_{level}", narrow) for level in levels}),
        denoiser=MappingProxyType(denoisers),
        decoder=open_graph("decoder", wide),
        coarse_decoders=lazy(COARSE_DECODERS, wide),
        context_agd=lazy(AGD_CONTEXTS, wide),
        denoiser_agd=lazy(AGD_DENOISERS, narrow),
        decoder_gradients=MappingProxyType(gradients),
        encoder=lazy({LEVELS[-1]: ENCODER}, wide).get(LEVELS[-1]),
        frames=lazy({graph: graph for graph in FRAME_GRAPHS}, narrow),
    )


def _read_graph(bundle: Bundle, contract: GraphContract) -> bytes:
    """Read the file of an optional graph, with the weights that it shares with another."""
    data = bundle.read_later(contract.file)
    if contract.name not in WEIGHT_SOURCES:
        return data
    source = bundle.manifest.contracts[WEIGHT_SOURCES[contract.name]].file
    return with_initializers(data, bundle.read_later(source), source)


def open_session(
    data: bytes, contract: GraphContract, options: onnxruntime.SessionOptions
) -> onnxruntime.InferenceSession:
    """Open one session from the bytes of a graph and check it against its contract.

    Raises:
        BundleError: onnxruntime refuses the graph; the message names its file.
        BundleFormatError: inputs or outputs differ from the contract.
    """
    session = _open(data, contract.file, options)
    check_signature(session.get_inputs(), session.get_outputs(), contract)
    return session


def open_differentiable(
    data: bytes, contract: GraphContract, options: onnxruntime.SessionOptions
) -> DifferentiableDecoder:
    """Open the graph of a decoder's gradient in its two parts; see `open_session`."""
    parts = split_gradient(data, contract.file)
    forward, backward = (_open(part, contract.file, options) for part in (parts.forward, parts.backward))
    inputs = {tensor.name: tensor for session in (forward, backward) for tensor in session.get_inputs()}
    own = [tensor for name, tensor in inputs.items() if name not in parts.kept]
    check_signature(own, backward.get_outputs(), contract)
    return DifferentiableDecoder(forward, backward, parts.kept)


def _open(data: bytes, file: str, options: onnxruntime.SessionOptions) -> onnxruntime.InferenceSession:
    try:
        session = onnxruntime.InferenceSession(
            data,
            sess_options=options,
            providers=["CPUExecutionProvider"],
            disabled_optimizers=DISABLED_OPTIMIZERS,
        )
    except ORT_ERRORS as error:
        raise BundleError(f"onnxruntime {onnxruntime.__version__} cannot load {file}: {error}") from error
    # onnxruntime keeps the file for switching providers, which nobody does here; without it 40 MB go.
    session._model_bytes = None
    return session


def run_model(
    session: onnxruntime.InferenceSession, outputs: Sequence[str], inputs: Mapping[str, NDArray[Any]], model: str
) -> list[FloatArray]:
    """Run a session; its errors are typed and its outputs finite.

    NaN must not go on: an int8 graph turns NaN in its inputs into ordinary numbers.

    Args:
        session: of one graph.
        outputs: names of the outputs wanted.
        inputs: arrays by name.
        model: what the graph is, for messages.

    Raises:
        ModelError: onnxruntime refuses the inputs, fails, or runs out of memory.
        NonFiniteError: an output holds NaN or infinity.
    """
    results = _run_typed(session, outputs, inputs, model)
    for values in results:
        require_finite(values, model)
    return results


def _run_typed(
    session: onnxruntime.InferenceSession, outputs: Sequence[str], inputs: Mapping[str, NDArray[Any]], model: str
) -> list[FloatArray]:
    """Run a session, with typed errors; what it gives is not checked."""
    try:
        results: list[FloatArray] = session.run(list(outputs), dict(inputs))
        return results
    except KinegraphError:
        raise
    except MemoryError as error:
        raise ModelError(f"{model} ran out of memory; ask for fewer or shorter clips at once") from error
    except ORT_ERRORS as error:
        raise ModelError(f"{model} failed in onnxruntime {onnxruntime.__version__}: {error}") from error


def _thread_count(threads: int | None, default: int) -> int:
    if threads is None:
        return default
    if isinstance(threads, bool) or not isinstance(threads, int) or not 1 <= threads <= MAX_THREADS:
        raise InvalidInputError(f"threads must be a whole number from 1 to {MAX_THREADS}, not {short_repr(threads)}")
    return threads
