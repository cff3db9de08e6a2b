"""Sessions: thread counts, no spinning between runs, the caller's own options, wrapped onnxruntime errors."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import onnxruntime
import pytest

from kinegraph.bundle.contract import LEVELS, contracts
from kinegraph.bundle.reader import Bundle, read_bundle
from kinegraph.bundle.sessions import Sessions, available_cpus, open_session, open_sessions, session_options
from kinegraph.errors import BundleError, InvalidInputError
from support.synthetic_bundle import LEVEL_SPECS, bundle_files, filler_model, write_bundle


@pytest.fixture(scope="module")
def bundle(tmp_path_factory: pytest.TempPathFactory) -> Bundle:
    return read_bundle(write_bundle(tmp_path_factory.mktemp("sessions") / "bundle"))


def by_graph(sessions: Sessions) -> dict[str, onnxruntime.InferenceSession]:
    return {
        "text_encoder": sessions.text_encoder,
        "graph_encoder": sessions.graph_encoder,
        **{f"context_{level}": sessions.context[level] for level in LEVELS},
        **{f"denoiser_{level}": sessions.denoiser[level] for level in LEVELS},
        "decoder": sessions.decoder,
    }


def test_each_session_is_the_graph_of_its_name(bundle: Bundle) -> None:
    graphs = bundle.manifest.contracts
    for name, session in by_graph(open_sessions(bundle)).items():
        assert [tensor.name for tensor in session.get_inputs()] == [spec.name for spec in graphs[name].inputs]
        assert session.get_providers() == ["CPUExecutionProvider"]


def test_by_default_steps_take_one_thread_and_the_rest_at_most_two(bundle: Bundle) -> None:
    for name, session in by_graph(open_sessions(bundle)).items():
        threads = session.get_session_options().intra_op_num_threads
        assert threads == (1 if name.startswith("denoiser_") else min(2, available_cpus())), name


@pytest.mark.parametrize("threads", [1, 2, 3])
def test_the_callers_thread_count_holds_for_all(bundle: Bundle, threads: int) -> None:
    for session in by_graph(open_sessions(bundle, threads=threads)).values():
        assert session.get_session_options().intra_op_num_threads == threads


def test_by_default_no_pool_spins(bundle: Bundle) -> None:
    for session in by_graph(open_sessions(bundle)).values():
        assert session.get_session_options().get_session_config_entry("session.intra_op.allow_spinning") == "0"


@pytest.mark.parametrize("threads", [1, 2])
def test_pools_spin_while_they_run_only(bundle: Bundle, threads: int) -> None:
    for session in by_graph(open_sessions(bundle, threads=threads)).values():
        options = session.get_session_options()
        assert options.get_session_config_entry("session.intra_op.allow_spinning") == str(threads - 1)
        assert options.get_session_config_entry("session.force_spinning_stop") == "1"
        assert options.inter_op_num_threads == 1


def test_the_host_may_bring_its_own_options(bundle: Bundle) -> None:
    custom = onnxruntime.SessionOptions()
    custom.intra_op_num_threads = 1
    custom.add_session_config_entry("session.intra_op.allow_spinning", "1")
    for session in by_graph(open_sessions(bundle, options=custom)).values():
        options = session.get_session_options()
        assert options.get_session_config_entry("session.intra_op.allow_spinning") == "1"
        assert options.intra_op_num_threads == 1


@pytest.mark.parametrize("threads", [0, -1, 257, True, 1.5, "2", 10**30])
def test_a_wrong_thread_count_is_refused(bundle: Bundle, threads: object) -> None:
    with pytest.raises(InvalidInputError, match="threads must be"):
        open_sessions(bundle, threads=threads)  # type: ignore[arg-type]


def test_threads_and_options_exclude_each_other(bundle: Bundle) -> None:
    with pytest.raises(InvalidInputError, match="either threads or session_options"):
        open_sessions(bundle, threads=2, options=onnxruntime.SessionOptions())


@pytest.mark.parametrize("cut", [0, 1, 40, 100])
def test_what_onnxruntime_refuses_is_a_bundle_error_naming_the_graph(cut: int) -> None:
    contract = contracts(LEVEL_SPECS, 12, 137)["denoiser_motion"]
    with pytest.raises(BundleError, match=r"denoiser_motion\.onnx"):
        open_session(filler_model(contract)[:cut], contract, session_options(1))


def test_coarse_decoders_are_opened_at_their_first_use_and_kept(
    bundle: Bundle, monkeypatch: pytest.MonkeyPatch
) -> None:
    opened: list[int] = []
    original = onnxruntime.InferenceSession
    monkeypatch.setattr(onnxruntime, "InferenceSession", lambda *a, **k: opened.append(len(a[0])) or original(*a, **k))
    sessions = open_sessions(bundle)
    before = len(opened)
    first = sessions.coarse_decoders["motion"]()
    assert sessions.coarse_decoders["motion"]() is first and len(opened) == before + 1
    contract = bundle.manifest.contracts["decoder_motion"]
    assert [tensor.name for tensor in first.get_inputs()] == [spec.name for spec in contract.inputs]
    assert first.get_inputs()[0].shape[1] == LEVEL_SPECS["motion"].tokens


def test_a_bundle_need_not_have_coarse_decoders(tmp_path: Path) -> None:
    files = {name: data for name, data in bundle_files().items() if not name.startswith("decoder_")}
    sessions = open_sessions(read_bundle(write_bundle(tmp_path / "bundle", files)))
    assert sessions.coarse_decoders == {}


def test_the_graphs_of_adaptive_gradient_descent_are_opened_once_whoever_asks(
    bundle: Bundle, monkeypatch: pytest.MonkeyPatch
) -> None:
    opened: list[int] = []
    original = onnxruntime.InferenceSession
    monkeypatch.setattr(onnxruntime, "InferenceSession", lambda *a, **k: opened.append(len(a[0])) or original(*a, **k))
    sessions = open_sessions(bundle)
    before = len(opened)
    assert set(sessions.denoiser_agd) == set(sessions.context_agd) == set(LEVELS)
    with ThreadPoolExecutor(8) as pool:
        used = list(pool.map(lambda _: sessions.denoiser_agd["action"](), range(16)))
    assert len(opened) == before + 1 and all(session is used[0] for session in used)
    assert "gamma" in [tensor.name for tensor in used[0].get_inputs()]
