"""The evaluators of Guo et al. in ONNX, against torch's own layers on packed sequences."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

torch = pytest.importorskip("torch")
pytest.importorskip("onnx")

import onnxruntime
from torch import nn

from kinegraph.errors import InvalidInputError
from kinegraph_export.import_evaluators import import_evaluators
from support.official import randomise

TOLERANCE = 1e-5
LENGTHS = [7, 4, 4, 1]
"""Longest first, as packed sequences want them."""


class Recurrent(nn.Module):
    """An embedding, a bidirectional GRU over a packed sequence, and a perceptron over both last states."""

    def __init__(self, width: int, hidden: int, out: int, tags: int = 0) -> None:
        super().__init__()
        if tags:
            self.pos_emb = nn.Linear(tags, width)
        self.input_emb = nn.Linear(width, hidden)
        self.gru = nn.GRU(hidden, hidden, batch_first=True, bidirectional=True)
        self.output_net = nn.Sequential(
            nn.Linear(2 * hidden, hidden), nn.LayerNorm(hidden), nn.LeakyReLU(0.2), nn.Linear(hidden, out)
        )
        self.hidden = nn.Parameter(torch.zeros(2, 1, hidden))

    def forward(self, tokens: torch.Tensor, lengths: list[int], tags: torch.Tensor | None = None) -> torch.Tensor:
        tokens = tokens if tags is None else tokens + self.pos_emb(tags)
        packed = nn.utils.rnn.pack_padded_sequence(self.input_emb(tokens), lengths, batch_first=True)
        _, last = self.gru(packed, self.hidden.repeat(1, len(lengths), 1))
        return self.output_net(torch.cat([last[0], last[1]], dim=-1))


class Movement(nn.Module):
    """Two strided convolutions and a linear layer."""

    def __init__(self) -> None:
        super().__init__()
        self.main = nn.Sequential(
            nn.Conv1d(259, 12, 4, 2, 1), nn.Dropout(0.2), nn.LeakyReLU(0.2),
            nn.Conv1d(12, 10, 4, 2, 1), nn.Dropout(0.2), nn.LeakyReLU(0.2),
        )  # fmt: skip
        self.out_net = nn.Linear(10, 10)

    def forward(self, features: torch.Tensor) -> torch.Tensor:
        return self.out_net(self.main(features.permute(0, 2, 1)).permute(0, 2, 1))


@pytest.fixture(scope="module")
def models() -> dict[str, nn.Module]:
    parts = {"movement": Movement(), "motion": Recurrent(10, 16, 8), "text": Recurrent(30, 14, 8, tags=15)}
    return {name: randomise(module, seed).eval() for seed, (name, module) in enumerate(parts.items())}


def sessions(checkpoint: Path, out: Path) -> dict[str, onnxruntime.InferenceSession]:
    import_evaluators(checkpoint, out)
    return {path.stem: onnxruntime.InferenceSession(str(path)) for path in out.glob("*.onnx")}


@pytest.fixture(scope="module", params=["of their own", "of GraphMotion"])
def exported(
    models: dict[str, nn.Module], tmp_path_factory: pytest.TempPathFactory, request: pytest.FixtureRequest
) -> dict[str, onnxruntime.InferenceSession]:
    folder = tmp_path_factory.mktemp("evaluators")
    own = request.param == "of their own"
    names = {part: f"{part}_encoder" if own else f"t2m_{part.replace('movement', 'move')}encoder" for part in models}
    states = {names[part]: module.state_dict() for part, module in models.items()}
    flat = {f"{part}.{name}": value for part, state in states.items() for name, value in state.items()}
    content = {"epoch": 1, "opt_text_encoder": {"lr": 1e-3}, **states} if own else {"state_dict": flat}
    torch.save(content, folder / "x.tar")
    return sessions(folder / "x.tar", folder / "out")


def draw(*shape: int) -> np.ndarray:
    return np.random.Generator(np.random.PCG64(sum(shape))).standard_normal(shape).astype(np.float32)


def test_movements(exported: dict[str, onnxruntime.InferenceSession], models: dict[str, nn.Module]) -> None:
    features = draw(3, 42, 259)
    (embedding,) = exported["movement"].run(None, {"features": features})
    with torch.no_grad():
        expected = models["movement"](torch.from_numpy(features)).numpy()
    assert embedding.shape == (3, 10, 10)
    np.testing.assert_allclose(embedding, expected, rtol=0, atol=TOLERANCE)


@pytest.mark.parametrize("part", ["motion", "text"])
def test_sequences_of_several_lengths(
    exported: dict[str, onnxruntime.InferenceSession], models: dict[str, nn.Module], part: str
) -> None:
    width = {"motion": 10, "text": 30}[part]
    inputs = {"tokens": draw(4, 7, width), "lengths": np.array(LENGTHS, dtype=np.int32)}
    arguments = [torch.from_numpy(inputs["tokens"]), LENGTHS]
    if part == "text":
        inputs["tags"] = draw(4, 7, 15)
        arguments.append(torch.from_numpy(inputs["tags"]))
    (embedding,) = exported[part].run(None, inputs)
    with torch.no_grad():
        expected = models[part](*arguments).numpy()
    np.testing.assert_allclose(embedding, expected, rtol=0, atol=TOLERANCE)


def test_a_checkpoint_without_evaluators(tmp_path: Path) -> None:
    torch.save({"state_dict": {"gat.W": torch.zeros(2, 2)}}, tmp_path / "x.ckpt")
    with pytest.raises(InvalidInputError, match=r"no t2m_moveencoder or movement_encoder: bring .*finest\.tar"):
        import_evaluators(tmp_path / "x.ckpt", tmp_path / "out")
    assert not (tmp_path / "out").exists()
