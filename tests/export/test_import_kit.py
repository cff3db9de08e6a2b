"""Checkpoints of KIT-ML as bundles: 251 features of 21 joints, 12.5 frames per second, clips of our 22 joints."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

torch = pytest.importorskip("torch")
pytest.importorskip("onnxscript")

from kinegraph import MotionPipeline
from kinegraph.bench import GRAPH
from kinegraph.bundle.manifest import Manifest
from kinegraph.errors import InvalidInputError
from kinegraph_export import import_mld as command
from kinegraph_export.import_graphmotion import import_graphmotion
from kinegraph_export.import_mld import import_mld
from support.official import graphmotion_tensors, mld_tensors, write_clip, write_lightning, write_statistics

pytestmark = [pytest.mark.slow, pytest.mark.timeout(900), pytest.mark.usefixtures("traces")]

LEG = 0.821


@pytest.fixture(scope="module")
def folders(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    folder = tmp_path_factory.mktemp("kit")
    return {"clip": write_clip(folder / "clip"), "stats": write_statistics(folder / "stats", 251)}


def import_kit(model: str, folders: dict[str, Path], folder: Path) -> Manifest:
    made: dict[str, tuple[Callable[[int], dict[str, torch.Tensor]], Callable[..., Manifest], object]] = {
        "graphmotion": (graphmotion_tensors, import_graphmotion, (4, 4)),
        "mld": (mld_tensors, import_mld, 4),
    }
    tensors, importer, heads = made[model]
    checkpoint = write_lightning(folder / "kit.ckpt", tensors(251))
    return importer(checkpoint, out=folder / "bundle", precision="fp32", heads=heads, **folders)


@pytest.mark.parametrize("model", ["graphmotion", "mld"])
def test_a_checkpoint_of_kit_becomes_a_bundle(model: str, folders: dict[str, Path], tmp_path: Path) -> None:
    manifest = import_kit(model, folders, tmp_path)
    assert (manifest.features.layout, manifest.fps, len(manifest.features.mean)) == ("kit-251", 12.5, 251)
    assert manifest.provenance["training_data"] == "KIT-ML" and "KIT-ML" in manifest.licence.data
    assert manifest.scope["length"].startswith("1.9 to 15.7 seconds")
    clip = MotionPipeline.load(tmp_path / "bundle").generate(GRAPH, seconds=4, seed=1, steps=2, foot_fix=False)
    assert clip.fps == 12.5 and clip.joints.shape == (50, 22, 3) and np.isfinite(clip.joints).all()
    knee, ankle, hip = (clip.joints[:, joint] for joint in (5, 8, 2))
    leg = np.linalg.norm(knee - hip, axis=-1) + np.linalg.norm(ankle - knee, axis=-1)
    # the leg is scaled to metres by its mean; then every bone gets its median length
    assert leg.mean() == pytest.approx(LEG, rel=0.2) and leg.std() < 1e-4


def test_statistics_and_checkpoints_of_different_data(
    folders: dict[str, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    human = write_statistics(tmp_path / "human")
    kit = write_lightning(tmp_path / "kit.ckpt", mld_tensors(251))
    with pytest.raises(InvalidInputError, match=r"\(263,\), of HumanML3D .* 251 features, of KIT-ML"):
        import_mld(kit, out=tmp_path / "out", **{**folders, "stats": human})
    other = write_lightning(tmp_path / "human.ckpt", mld_tensors())
    words = ["--checkpoint", other, "--clip", folders["clip"], "--stats", folders["stats"], "--out", tmp_path / "out"]
    assert command.main([str(word) for word in words]) == 2
    assert "(251,), of KIT-ML (21 joints); the checkpoint has 263 features, of HumanML3D" in capsys.readouterr().err
    with pytest.raises(InvalidInputError, match=r"has 100 features; published ones have 263 \(HumanML3D\) or 251"):
        odd = write_lightning(tmp_path / "odd.ckpt", mld_tensors(100))
        import_mld(odd, out=tmp_path / "out", **{**folders, "stats": write_statistics(tmp_path / "odd", 100)})
    assert not (tmp_path / "out").exists()
