"""The evaluator: its loss against loops, padding without influence, and what was saved is what was trained."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

torch = pytest.importorskip("torch")
pytest.importorskip("lightning")
pytest.importorskip("onnxscript")

from kinegraph.bundle.reader import text_files_folder
from kinegraph.errors import BundleIntegrityError, InvalidInputError
from kinegraph.motion.features import features_from_joints
from kinegraph_benchmarks.common.evaluator import Evaluator
from kinegraph_export.export_evaluator import export_evaluator, read_evaluator
from kinegraph_training import train_evaluator
from kinegraph_training.config import OptimiserConfig
from kinegraph_training.data.folder import PreparedClip, write_data
from kinegraph_training.models.evaluator import EvaluatorConfig, MotionEncoder, contrastive_loss
from support.motions import walk


def test_the_loss_is_two_cross_entropies_without_false_negatives() -> None:
    generator = torch.Generator().manual_seed(0)
    motion, text = torch.nn.functional.normalize(torch.randn(2, 4, 3, generator=generator), dim=-1)
    same = torch.zeros(4, 4, dtype=torch.bool)
    same[0, 2] = same[2, 0] = True
    same.fill_diagonal_(True)
    total = 0.0
    for i in range(4):
        # Clips 0 and 2 share a label: neither is a wrong answer for the other.
        others = [j for j in range(4) if j == i or not same[i, j]]
        for a, b in ((motion, text), (text, motion)):
            scores = {j: float(a[i] @ b[j]) / 0.1 for j in others}
            total -= scores[i] - np.log(sum(np.exp(value) for value in scores.values()))
    assert float(contrastive_loss(motion, text, same, 0.1)) == pytest.approx(total / 8, rel=1e-5)


@torch.no_grad()
def test_padding_has_no_influence_and_vectors_have_unit_length() -> None:
    torch.manual_seed(0)
    encoder = MotionEncoder(EvaluatorConfig()).eval()
    features, mask = torch.randn(1, 24, 137), torch.ones(1, 24)
    wide = torch.cat([features, torch.full((1, 8, 137), 9.0)], dim=1)
    wide_mask = torch.cat([mask, torch.zeros(1, 8)], dim=1)
    embedding = encoder(wide, wide_mask)
    torch.testing.assert_close(embedding, encoder(features, mask), atol=1e-5, rtol=0)
    assert float(embedding.norm()) == pytest.approx(1.0, abs=1e-5)


def data(folder: Path) -> None:
    clips = []
    for number in range(24):
        side = "left" if number % 2 else "right"
        joints = walk(40 + number, turning=0.02 if number % 2 else -0.02)
        split = "val" if number >= 18 else "train"
        clips.append(PreparedClip(f"walk{number}", joints, (f"a person turns to the {side}",), "made", split))
    write_data(folder, clips, 20)


def test_trained_saved_and_used_without_torch(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    data(tmp_path / "data")
    quick = OptimiserConfig(steps=4, learning_rate=1e-3, warmup=1, batch=8, ema=0.9)
    monkeypatch.setattr(train_evaluator, "TRAINING", quick)
    words = ["--data", str(tmp_path / "data"), "--run", str(tmp_path / "run"), "--assets", str(text_files_folder())]
    train_evaluator.main([*words, "--threads", "1", "--enable_progress_bar", "0", "--accelerator", "cpu"])
    assert (tmp_path / "run" / "curves" / "curves.png").is_file()
    export_evaluator(tmp_path / "run", "7", "CC0", tmp_path / "out")
    evaluator = Evaluator(tmp_path / "out")
    assert evaluator.version == "7"
    clips = [walk(40), walk(61), walk(196)]
    embeddings = evaluator.embed_motions(clips)
    assert embeddings.shape == (3, 64)
    # A batch of clips of other lengths changes nothing.
    np.testing.assert_allclose(embeddings[1], evaluator.embed_motions([clips[1]])[0], atol=1e-5)
    motion, _, mean, std = read_evaluator(tmp_path / "run")
    rows = torch.from_numpy((features_from_joints(clips[0]) - mean) / std)[None]
    with torch.no_grad():
        np.testing.assert_allclose(embeddings[0], motion(rows, torch.ones(1, 40))[0].numpy(), atol=1e-4)
    captions = evaluator.embed_captions(["a person walks", "a person runs", "a person walks"])
    np.testing.assert_allclose(captions[0], captions[2], atol=1e-6)
    (tmp_path / "out" / "motion.onnx").write_bytes(b"another")
    with pytest.raises(BundleIntegrityError, match=r"motion\.onnx"):
        Evaluator(tmp_path / "out")


def test_an_evaluator_that_was_not_trained_is_named(tmp_path: Path) -> None:
    with pytest.raises(InvalidInputError, match="train the evaluator first"):
        read_evaluator(tmp_path)
