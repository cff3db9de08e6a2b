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

from kinegraph.errors import InvalidInputError
from kinegraph_export.checkpoints import read_run
from kinegraph_export.export_evaluator import read_evaluator

ROOT = Path(__file__).resolve().parents[2]


class Payload:
    """Makes a file when it is unpickled."""

    def __init__(self, target: Path) -> None:
        self.target = target

    def __reduce__(self) -> tuple[Callable[..., Any], tuple[Any, ...]]:
        return Path.touch, (self.target,)


@pytest.mark.parametrize(
    ("read", "names"),
    [(read_run, ["denoisers/last.ckpt", "vae_specific/last.ckpt"]), (read_evaluator, ["last.ckpt"])],
)
def test_code_in_a_checkpoint_is_not_run(read: Callable[[Path], Any], names: list[str], tmp_path: Path) -> None:
    with pytest.raises(InvalidInputError, match="is missing"):
        read(tmp_path)
    trace = tmp_path / "trace"
    for name in names:
        (tmp_path / name).parent.mkdir(exist_ok=True)
        torch.save({"state_dict": {}, "hyper_parameters": Payload(trace)}, tmp_path / name)
    with pytest.raises(pickle.UnpicklingError, match="weights_only"):
        read(tmp_path)
    assert not trace.exists()


def test_every_checkpoint_is_read_as_weights_only() -> None:
    loads = {
        f"{path.name}:{node.lineno}": {keyword.arg: ast.unparse(keyword.value) for keyword in node.keywords}
        for part in ("runtime", "training", "export", "benchmarks")
        for path in (ROOT / part).rglob("*.py")
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.Call) and ast.unparse(node.func) == "torch.load"
    }
    assert len(loads) >= 4
    assert {place for place, keywords in loads.items() if keywords.get("weights_only") != "True"} == set()
