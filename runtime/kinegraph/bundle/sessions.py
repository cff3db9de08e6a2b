"""The onnxruntime sessions of a bundle: made once, shared by all threads, checked against the contract."""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Mapping, MutableMapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Final

import onnxruntime
from onnxruntime.capi import onnxruntime_pybind11_state as _state

from kinegraph.bundle.contract import AGD_CONTEXTS, AGD_STEPS, COARSE_DECODERS, LEVELS, GraphContract, check
from kinegraph.bundle.reader import Bundle
from kinegraph.errors import BundleError, InvalidInputError

MAX_THREADS: Final = 256

ORT_ERRORS: Final[tuple[type[Exception], ...]] = (
    *(kind for kind in vars(_state).values() if isinstance(kind, type) and issubclass(kind, Exception)),
    RuntimeError,
    ValueError,
)
"""What onnxruntime raises; its own classes share no base but `Exception`."""

# onnxruntime's SkipLayerNormalization is slower than Add + LayerNormalization at these sizes, the more so
# after quantising, because the matrix product before it can then take its bias in.
DISABLED_OPTIMIZERS: Final = ["SkipLayerNormFusion"]

_ERRORS_ONLY: Final = 3


class Deferred:
    """A session that is made at its first use, once, whichever thread asks first."""

    def __init__(self, make: Callable[[], onnxruntime.InferenceSession]) -> None:
        self._make = make
        self._lock = threading.Lock()
        self._session: onnxruntime.InferenceSession | None = None

    def __call__(self) -> onnxruntime.InferenceSession:
        with self._lock:
            if self._session is None:
                self._session = self._make()
            return self._session


@dataclass(frozen=True)
class Sessions:
    """One session per graph; `run` on each of them may be called from any number of threads."""

    text_encoder: onnxruntime.InferenceSession
    graph_encoder: onnxruntime.InferenceSession
    context: Mapping[str, onnxruntime.InferenceSession]
    """By level."""
    clock: Mapping[str, onnxruntime.InferenceSession]
    """By level."""
    step: Mapping[str, onnxruntime.InferenceSession]
    """By level."""
    decoder: onnxruntime.InferenceSession
    coarse_decoders: Mapping[str, Deferred]
    """By level, as far as the bundle has them; so are the next two."""
    context_agd: Mapping[str, Deferred]
    step_agd: Mapping[str, Deferred]

    @property
    def deferred(self) -> tuple[Deferred, ...]:
        """All that are made at their first use."""
        return (*self.coarse_decoders.values(), *self.context_agd.values(), *self.step_agd.values())

    def decoder_of(self, level: str) -> onnxruntime.InferenceSession:
        """The decoder of a level that has one."""
        coarse = self.coarse_decoders.get(level)
        return self.decoder if coarse is None else coarse()


def available_cpus() -> int:
    """CPUs this process may run on."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def session_options(threads: int, *, spinning: bool = True) -> onnxruntime.SessionOptions:
    """Options of one session with a pool of `threads` that waits for work while it runs and sleeps between runs; one
    that is not `spinning` sleeps between operators too.

    By default onnxruntime's idle pools spin between runs too; with a session per graph they take the cores from the
    busy one (measured: three times slower on two cores, and half a core burnt between requests). Pools that never
    spin are woken for every operator: a sample at the published size takes 38 ms in place of 28. Beside busy
    neighbours it is they who lose least.
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
    """Make the sessions of a bundle.

    Args:
        bundle: read and checked by `read_bundle`.
        threads: threads of every session. None: two at most that never spin, and one for the step sessions, which are
            too small to gain much from a second one and hold up better on a busy machine.
        options: the host's own options, used as they are for every session; not together with `threads`.
        files: content in place of `bundle.files`; each graph is taken out when its session is made, because both at
            once are twice the memory.

    Raises:
        InvalidInputError: `threads` is not 1 to 256, or given together with `options`.
        BundleError: onnxruntime refuses a graph.
        BundleFormatError: a graph's inputs or outputs differ from the contract.
    """
    if threads is not None and options is not None:
        raise InvalidInputError("give either threads or session_options: the options hold a thread count already")
    wide = options or session_options(_thread_count(threads, min(2, available_cpus())), spinning=threads is not None)
    narrow = options or session_options(_thread_count(threads, 1))
    contracts = bundle.manifest.contracts

    def make(graph: str, settings: onnxruntime.SessionOptions) -> onnxruntime.InferenceSession:
        contract = contracts[graph]
        data = bundle.files[contract.file] if files is None else files.pop(contract.file)
        return open_session(data, contract, settings)

    def deferred(graphs: Mapping[str, str], settings: onnxruntime.SessionOptions) -> Mapping[str, Deferred]:
        def at_first_use(contract: GraphContract) -> Deferred:
            return Deferred(lambda: open_session(bundle.optional(contract.file), contract, settings))

        present = {level: contracts[graph] for level, graph in graphs.items() if graph in contracts}
        return MappingProxyType({level: at_first_use(contract) for level, contract in present.items()})

    return Sessions(
        text_encoder=make("text_encoder", wide),
        graph_encoder=make("graph_encoder", wide),
        context=MappingProxyType({level: make(f"context_{level}", wide) for level in LEVELS}),
        clock=MappingProxyType({level: make(f"clock_{level}", narrow) for level in LEVELS}),
        step=MappingProxyType({level: make(f"step_{level}", narrow) for level in LEVELS}),
        decoder=make("decoder", wide),
        coarse_decoders=deferred(COARSE_DECODERS, wide),
        context_agd=deferred(AGD_CONTEXTS, wide),
        step_agd=deferred(AGD_STEPS, narrow),
    )


def open_session(
    data: bytes, contract: GraphContract, options: onnxruntime.SessionOptions
) -> onnxruntime.InferenceSession:
    """Make one session from the bytes of a graph and check it against its contract.

    Raises:
        BundleError: onnxruntime refuses the graph; the message names it.
        BundleFormatError: inputs or outputs differ from the contract.
    """
    try:
        session = onnxruntime.InferenceSession(
            data,
            sess_options=options,
            providers=["CPUExecutionProvider"],
            disabled_optimizers=DISABLED_OPTIMIZERS,
        )
    except ORT_ERRORS as error:
        raise BundleError(f"onnxruntime {onnxruntime.__version__} cannot load {contract.file}: {error}") from error
    # onnxruntime keeps the file for switching providers, which nobody does here; without it 40 MB go.
    session._model_bytes = None
    check(session.get_inputs(), session.get_outputs(), contract)
    return session


def _thread_count(threads: int | None, default: int) -> int:
    if threads is None:
        return default
    if isinstance(threads, bool) or not isinstance(threads, int) or not 1 <= threads <= MAX_THREADS:
        raise InvalidInputError(f"threads must be a whole number from 1 to {MAX_THREADS}, not {threads!r}")
    return threads
