"""Checkpoints are data: reading one runs no code that somebody put into it."""

from __future__ import annotations

import ast
import pickle
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

torch = pytest.importorskip("torch")
pytest.importorskip("onnxscript")
L = pytest.importorskip("lightning")

from kinegraph.errors import InvalidInputError
from kinegraph_export.checkpoints import read_run
from kinegraph_export.export_evaluator import read_evaluator
from kinegraph_export.recover import recover_autoencoder, store_encoder
from kinegraph_training.checkpoints import fit, read_checkpoint
from kinegraph_training.latents import read_vae
from kinegraph_training.trainer import load_start_weights

ROOT = Path(__file__).resolve().parents[2]


class Payload:
    """Makes a file when it is unpickled."""

    def __init__(self, target: Path) -> None:
        self.target = target

    def __reduce__(self) -> tuple[Callable[..., Any], tuple[Any, ...]]:
        return Path.touch, (self.target,)


def trap(path: Path, trace: Path) -> None:
    path.parent.mkdir(exist_ok=True)
    torch.save({"state_dict": {}, "hyper_parameters": Payload(trace)}, path)


def read_start_weights(run: Path) -> None:
    load_start_weights(torch.nn.Linear(1, 1), run / "last.ckpt", "")


class Module(L.LightningModule):
    """The least that Lightning trains."""

    def __init__(self) -> None:
        super().__init__()
        self.weight = torch.nn.Parameter(torch.ones(1))

    def training_step(self, batch: torch.Tensor) -> torch.Tensor:
        return self.weight.sum()

    def configure_optimizers(self) -> torch.optim.Optimizer:
        return torch.optim.SGD(self.parameters(), 0.1)


def resume(run: Path) -> None:
    off = dict.fromkeys(("logger", "enable_checkpointing", "enable_progress_bar", "enable_model_summary"), False)
    fit(L.Trainer(accelerator="cpu", max_steps=1, **off), Module(), [torch.zeros(1)], None, run)  # type: ignore[arg-type]


READS: list[tuple[Callable[[Path], Any], list[str]]] = [
    (read_run, ["denoisers/last.ckpt", "vae_specific/last.ckpt"]),
    (read_evaluator, ["last.ckpt"]),
    (lambda run: read_vae(run / "last.ckpt"), ["last.ckpt"]),
    (read_start_weights, ["last.ckpt"]),
    (lambda run: store_encoder(run / "last.ckpt", run / "out.ckpt"), ["last.ckpt"]),
    (lambda run: recover_autoencoder(None, "specific", run / "last.ckpt", None), ["last.ckpt"]),  # type: ignore[arg-type]
    (resume, ["last.ckpt"]),
]


@pytest.mark.parametrize(("read", "names"), READS)
def test_code_in_a_checkpoint_is_not_run(read: Callable[[Path], Any], names: list[str], tmp_path: Path) -> None:
    trace = tmp_path / "trace"
    for name in names:
        trap(tmp_path / name, trace)
    with pytest.raises(InvalidInputError, match=r"last\.ckpt .*may hold code"):
        read(tmp_path)
    assert not trace.exists()
    # the trap works: without the guard it springs
    torch.load(tmp_path / names[0], weights_only=False)
    assert trace.exists()


@pytest.mark.parametrize("read", [read_run, read_evaluator])
def test_a_stage_that_was_not_trained_is_named(read: Callable[[Path], Any], tmp_path: Path) -> None:
    with pytest.raises(InvalidInputError, match="is missing"):
        read(tmp_path)


@pytest.mark.parametrize("data", [b"", b"PK", b"junk" * 100, pickle.dumps([1, 2]), b"\x80\x02."])
def test_other_files_are_refused(data: bytes, tmp_path: Path) -> None:
    (tmp_path / "last.ckpt").write_bytes(data)
    with pytest.raises(InvalidInputError, match=r"last\.ckpt"):
        read_checkpoint(tmp_path / "last.ckpt")
    torch.save([1], tmp_path / "list.ckpt")
    with pytest.raises(InvalidInputError, match="no dictionary"):
        read_checkpoint(tmp_path / "list.ckpt")
    torch.save({"a": torch.ones(3), "b": 1}, tmp_path / "whole.ckpt")
    whole = (tmp_path / "whole.ckpt").read_bytes()
    assert read_checkpoint(tmp_path / "whole.ckpt")["b"] == 1
    for length in range(0, len(whole), 97):
        (tmp_path / "cut.ckpt").write_bytes(whole[:length])
        with pytest.raises(InvalidInputError, match=r"cut\.ckpt"):
            read_checkpoint(tmp_path / "cut.ckpt")


def test_every_file_of_torch_is_read_as_weights_only() -> None:
    loads = {
        f"{path.name}:{node.lineno}": {keyword.arg: ast.unparse(keyword.value) for keyword in node.keywords}
        for part in ("runtime", "training", "export", "benchmarks")
        for path in (ROOT / part).rglob("*.py")
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.Call) and ast.unparse(node.func) == "torch.load"
    }
    assert loads
    assert {place for place, keywords in loads.items() if keywords.get("weights_only") != "True"} == set()
