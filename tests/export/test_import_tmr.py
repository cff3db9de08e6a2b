"""TMR's checkpoint in ONNX, against torch's own transformer layers; files that do not fit are named."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

torch = pytest.importorskip("torch")
pytest.importorskip("onnx")

from safetensors.torch import save_file
from torch import nn

from kinegraph.errors import InvalidInputError
from kinegraph_benchmarks.common.tmr_evaluator import TmrEvaluator, nearness, score
from kinegraph_export import import_tmr as command
from kinegraph_export.import_tmr import import_tmr, read_encoders
from support.tmr import (
    WORDS,
    TorchDistilBert,
    distilbert_tensors,
    tmr_encoders,
    write_distilbert,
    write_split_tmr,
    write_tmr,
    write_tmr_stats,
)

pytestmark = [pytest.mark.slow, pytest.mark.timeout(1200)]
TOLERANCE = 1e-4
IDS = {word: number for number, word in enumerate(WORDS)}
SENTENCES = {
    "A person walks forward": ("a", "person", "walk", "##s", "forward"),
    "turn left": ("turn", "left"),
    "a person zigzags in a circle": ("a", "person", "[UNK]", "in", "a", "circle"),
}


@pytest.fixture(scope="module")
def encoders() -> dict[str, nn.Module]:
    return tmr_encoders()


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory, encoders: dict[str, nn.Module]) -> dict[str, Path]:
    top = tmp_path_factory.mktemp("tmr")
    return {
        "checkpoint": write_tmr(top / "checkpoints", encoders),
        "stats": write_tmr_stats(top / "stats"),
        "distilbert": write_distilbert(top / "distilbert"),
    }


@pytest.fixture(scope="module")
def evaluator(tmp_path_factory: pytest.TempPathFactory, files: dict[str, Path]) -> TmrEvaluator:
    out = tmp_path_factory.mktemp("imported") / "tmr"
    words = [word for name, path in files.items() for word in (f"--{name}", str(path))]
    assert command.main([*words, "--out", str(out)]) == 0
    return TmrEvaluator(out)


def unit(rows: torch.Tensor) -> np.ndarray:
    return nn.functional.normalize(rows, dim=-1).numpy()


@torch.no_grad()
def test_motions_are_embedded_as_torch_s_layers_do(
    evaluator: TmrEvaluator, encoders: dict[str, nn.Module], files: dict[str, Path]
) -> None:
    rng = np.random.Generator(np.random.PCG64(0))
    motions = [rng.normal(0.0, 0.2, (frames, 263)).astype(np.float32) for frames in (40, 7, 88)]
    mean, deviation = (torch.load(files["stats"] / f"{name}.pt") for name in ("mean", "std"))
    expected = [
        encoders["motion_encoder"](((torch.from_numpy(rows) - mean) / deviation)[None], [len(rows)]) for rows in motions
    ]
    embedded = evaluator.embed_motions(motions)
    np.testing.assert_allclose(embedded, unit(torch.cat(expected)), rtol=0, atol=TOLERANCE)
    # or every motion would be as near as any other
    assert np.abs(embedded[0] - embedded[1]).max() > 0.01


@torch.no_grad()
def test_sentences_are_embedded_as_torch_s_layers_do(evaluator: TmrEvaluator, encoders: dict[str, nn.Module]) -> None:
    words = TorchDistilBert(distilbert_tensors()).eval()
    expected = []
    for pieces in SENTENCES.values():
        states = words(torch.tensor([IDS[piece] for piece in ("[CLS]", *pieces, "[SEP]")]))
        expected.append(encoders["text_encoder"](states[None], [len(states)]))
    embedded = evaluator.embed_sentences(list(SENTENCES))
    np.testing.assert_allclose(embedded, unit(torch.cat(expected)), rtol=0, atol=TOLERANCE)
    np.testing.assert_allclose(np.linalg.norm(embedded, axis=1), 1.0, atol=1e-6)


@torch.no_grad()
def test_the_published_folder_and_other_wrappings_are_the_same_model(
    tmp_path: Path, files: dict[str, Path], encoders: dict[str, nn.Module]
) -> None:
    split = write_split_tmr(tmp_path / "tmr_humanml3d_guoh3dfeats", encoders)
    state = torch.load(files["checkpoint"])["state_dict"]
    tables = {"motion_encoder.sequence_pos_encoding.pe": torch.zeros(9, 1, 16)}
    torch.save({"state_dict": {f"module.{name}": v for name, v in {**state, **tables}.items()}}, tmp_path / "x.ckpt")
    expected = read_encoders(files["checkpoint"])
    assert expected.keys() == {name for name in state if not name.startswith("motion_decoder")}
    for checkpoint in (split, split / "last_weights", tmp_path / "x.ckpt"):
        tensors = read_encoders(checkpoint)
        assert tensors.keys() == expected.keys()
        assert all(torch.equal(tensors[name], value) for name, value in expected.items())


def test_scores_go_by_the_angle() -> None:
    told = np.eye(4, dtype=np.float32)[:3]
    assert nearness(told, told) == 1.0 and nearness(told, -told) == 0.0
    assert nearness(told, np.roll(told, 1, axis=0)) == 0.5
    near = told + 0.1 * np.roll(told, 1, axis=0)
    near /= np.linalg.norm(near, axis=1, keepdims=True)
    scores = score(told, near, told, [np.arange(3)])
    assert scores["tmr_r_precision_1"] == 1.0
    assert scores["tmr_m2t"] == pytest.approx(0.5 + 0.5 / np.sqrt(1.01), abs=1e-6)
    assert score(told, -near, near, [np.arange(3)])["tmr_m2m"] == pytest.approx(0.0, abs=1e-6)


def fails(tmp_path: Path, files: dict[str, Path], reason: str, **changes: Path) -> None:
    with pytest.raises(InvalidInputError, match=reason):
        import_tmr(**{**files, **changes}, out=tmp_path / "out")
    assert not (tmp_path / "out").exists()


def changed(tmp_path: Path, files: dict[str, Path], change: object) -> Path:
    """Write the checkpoint with its tensors changed."""
    state = torch.load(files["checkpoint"])["state_dict"]
    change(state)  # type: ignore[operator]
    torch.save({"state_dict": state}, tmp_path / "changed.ckpt")
    return tmp_path / "changed.ckpt"


def test_checkpoints_that_do_not_fit(tmp_path: Path, files: dict[str, Path]) -> None:
    (tmp_path / "page.ckpt").write_text("<html>")
    fails(tmp_path, files, "a web page", checkpoint=tmp_path / "page.ckpt")
    fails(tmp_path, files, r"motion_encoder\.pt is no file", checkpoint=tmp_path)
    torch.save({"state_dict": {"gat.W": torch.zeros(2, 2)}}, tmp_path / "other.ckpt")
    fails(tmp_path, files, r"no motion_encoder\.projection\.weight: it is no TMR", checkpoint=tmp_path / "other.ckpt")
    smpl = write_tmr(tmp_path / "smpl", tmr_encoders(205))
    fails(tmp_path, files, "205 features and not the 263 of HumanML3D", checkpoint=smpl)
    missing = changed(tmp_path, files, lambda state: state.pop("text_encoder.seqTransEncoder.layers.1.norm2.bias"))
    fails(tmp_path, files, r"lacks text_encoder\.seqTransEncoder\.layers\.1\.norm2\.bias", checkpoint=missing)
    unknown = changed(tmp_path, files, lambda state: state.update({"motion_encoder.extra": torch.zeros(1)}))
    fails(tmp_path, files, r"has unknown motion_encoder\.extra", checkpoint=unknown)
    half = changed(tmp_path, files, lambda state: state.update({k: v.half() for k, v in state.items()}))
    fails(tmp_path, files, "half precision", checkpoint=half)
    with pytest.raises(InvalidInputError, match="5 heads do not divide the width 16"):
        import_tmr(**files, out=tmp_path / "out", heads=5)


def test_statistics_and_words_that_do_not_fit(tmp_path: Path, files: dict[str, Path]) -> None:
    fails(tmp_path, files, r"mean\.pt cannot be read", stats=tmp_path)
    fails(tmp_path, files, "263 finite numbers", stats=write_tmr_stats(tmp_path / "kit", 251))
    flat = write_tmr_stats(tmp_path / "flat")
    torch.save(torch.zeros(263), flat / "std.pt")
    fails(tmp_path, files, "not positive", stats=flat)
    fails(tmp_path, files, "32 wide", distilbert=write_distilbert(tmp_path / "wide", 32))
    fails(tmp_path, files, "name that of distilbert-base-uncased", distilbert=tmp_path / "absent")
    bert = write_distilbert(tmp_path / "bert")
    save_file({"bert.pooler.weight": torch.zeros(2, 2)}, bert / "model.safetensors")
    fails(tmp_path, files, "is no DistilBERT", distilbert=bert)
    odd = write_distilbert(tmp_path / "odd")
    (odd / "config.json").write_text(json.dumps({"n_heads": 5}))
    fails(tmp_path, files, "5 heads do not divide", distilbert=odd)
    more = write_distilbert(tmp_path / "more")
    (more / "vocab.txt").write_text("\n".join((*WORDS, "jump")))
    fails(tmp_path, files, "of different models", distilbert=more)


def test_the_command_prints_one_line(
    tmp_path: Path, files: dict[str, Path], capsys: pytest.CaptureFixture[str]
) -> None:
    words = [word for name, path in files.items() for word in (f"--{name}", str(path))]
    assert command.main([*words, "--out", str(tmp_path / "tmr"), "--heads", "3"]) == 2
    assert "the released models have 4" in capsys.readouterr().err
    with pytest.raises(InvalidInputError, match=r"lacks motion\.onnx, text\.onnx, tokenizer\.json"):
        TmrEvaluator(tmp_path)
