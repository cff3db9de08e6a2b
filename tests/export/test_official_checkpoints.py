"""Files that people bring instead of the published checkpoint: each is refused with its reason and a remedy."""

from __future__ import annotations

import json
import pickle
from pathlib import Path
from typing import Any

import numpy as np
import pytest

torch = pytest.importorskip("torch")
pytest.importorskip("onnx")

from safetensors.torch import save_file

from kinegraph.errors import InvalidInputError, OutputError
from kinegraph_export import import_graphmotion as command
from kinegraph_export.import_graphmotion import import_graphmotion
from kinegraph_export.import_mld import import_mld
from kinegraph_export.official.checkpoint import graphmotion_models, mld_models
from kinegraph_export.tensor_files import IGNORED_PARTS, read_tensors
from support.official import graphmotion_tensors, mld_tensors, write_clip, write_lightning, write_statistics
from support.shared import shared_path

HEADS = {"vae_heads": 4, "denoiser_heads": 4}


@pytest.fixture(scope="module")
def tensors() -> dict[str, torch.Tensor]:
    return graphmotion_tensors()


@pytest.fixture(scope="module")
def folders(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    folder = tmp_path_factory.mktemp("official")
    return {"clip": write_clip(folder / "clip"), "stats": write_statistics(folder / "stats")}


class Settings(dict[str, int]):
    """Settings as a trainer pickles them beside the weights: a dictionary of a class of its own."""

    def __setitem__(self, key: str, value: int) -> None:
        raise AssertionError("code of the checkpoint was run")


class Callback:
    """An object with a state, likewise."""

    def __setstate__(self, state: Any) -> None:
        raise AssertionError("code of the checkpoint was run")

    def __getstate__(self) -> dict[str, int]:
        return {"best": 1}


class Boom:
    """A file that runs code when it is read."""

    def __reduce__(self) -> tuple[Any, ...]:
        return (Path.touch, (Path("kinegraph_was_here"),))


def test_settings_beside_the_weights_are_left_alone(
    tmp_path: Path, tensors: dict[str, torch.Tensor], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    settings = Settings(lr=1)
    path = write_lightning(tmp_path / "a.ckpt", tensors, hyper_parameters=settings, callbacks={"x": Callback()})
    read = read_tensors(path)
    assert read.keys() == tensors.keys()
    assert all(torch.equal(read[name], value) for name, value in tensors.items())


def test_code_in_a_checkpoint_is_not_run(
    tmp_path: Path, tensors: dict[str, torch.Tensor], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    path = write_lightning(tmp_path / "a.ckpt", tensors, callbacks={"x": Boom()})
    with pytest.raises(InvalidInputError, match="code in a checkpoint is never run"):
        read_tensors(path)
    assert not Path("kinegraph_was_here").exists()


@pytest.mark.parametrize("prefix", ["module.", "model.", "module._orig_mod.", "model.module."])
def test_prefixes_of_all_names_are_removed(tmp_path: Path, tensors: dict[str, torch.Tensor], prefix: str) -> None:
    save_file({f"{prefix}{name}": value for name, value in tensors.items()}, tmp_path / "a.safetensors")
    assert read_tensors(tmp_path / "a.safetensors").keys() == tensors.keys()


def test_prefixes_inside_names_are_removed(tmp_path: Path, tensors: dict[str, torch.Tensor]) -> None:
    # one network of several was wrapped, as trainers of several stages do
    def wrapped(name: str) -> str:
        part, _, rest = name.partition(".")
        return f"model.{part}.module.{rest}" if part == "denoiser_stage2" else f"model.{name}"

    save_file({wrapped(name): value for name, value in tensors.items()}, tmp_path / "a.safetensors")
    read = read_tensors(tmp_path / "a.safetensors")
    assert read.keys() == tensors.keys()
    assert all(torch.equal(read[name], value) for name, value in tensors.items())


def test_a_network_beside_its_wrapped_copy_is_told(tmp_path: Path, tensors: dict[str, torch.Tensor]) -> None:
    both = {**tensors, "gat.module.W": tensors["gat.W"] + 1}
    with pytest.raises(InvalidInputError, match=r"holds gat.W twice, once as gat.module.W"):
        read_tensors(write_lightning(tmp_path / "a.ckpt", both))


def test_half_precision(tmp_path: Path, tensors: dict[str, torch.Tensor]) -> None:
    path = write_lightning(tmp_path / "a.ckpt", {name: value.half() for name, value in tensors.items()})
    with pytest.raises(InvalidInputError, match=r"half precision .*denoiser_stage1.* bring the float32 checkpoint"):
        read_tensors(path)


def test_not_a_number(tmp_path: Path, tensors: dict[str, torch.Tensor]) -> None:
    broken = {name: value.clone() for name, value in tensors.items()}
    broken["gat.W"][0, 0] = float("nan")
    with pytest.raises(InvalidInputError, match=r"gat\.W holds NaN or infinity"):
        read_tensors(write_lightning(tmp_path / "a.ckpt", broken))


def test_files_that_are_no_checkpoint(tmp_path: Path) -> None:
    with pytest.raises(InvalidInputError, match="is no file"):
        read_tensors(tmp_path / "absent.ckpt")
    page = tmp_path / "page.ckpt"
    page.write_text("<html>Google Drive: quota exceeded</html>")
    with pytest.raises(InvalidInputError, match="a web page"):
        read_tensors(page)
    old = tmp_path / "old.ckpt"
    old.write_bytes(pickle.dumps({"state_dict": {}}))
    with pytest.raises(InvalidInputError, match="download it again"):
        read_tensors(old)
    torch.save([1, 2], tmp_path / "list.ckpt")
    with pytest.raises(InvalidInputError, match="instead of named tensors"):
        read_tensors(tmp_path / "list.ckpt")
    torch.save({"epoch": 3}, tmp_path / "empty.ckpt")
    with pytest.raises(InvalidInputError, match="no named tensors; keys are epoch"):
        read_tensors(tmp_path / "empty.ckpt")
    cut = tmp_path / "cut.safetensors"
    cut.write_bytes(b"\x10\x00\x00\x00\x00\x00\x00\x00{")
    with pytest.raises(InvalidInputError, match="not a safetensors file"):
        read_tensors(cut)


def test_missing_and_unknown_names_are_listed(tensors: dict[str, torch.Tensor]) -> None:
    missing = {name: value for name, value in tensors.items() if name != "gat.ARGM_TMP"}
    with pytest.raises(InvalidInputError, match=r"lacks gat\.ARGM_TMP: it is another version"):
        graphmotion_models(missing, **HEADS)
    with pytest.raises(InvalidInputError, match=r"has unknown gat\.extra"):
        graphmotion_models({**tensors, "gat.extra": torch.zeros(1)}, **HEADS)
    wrong = {**tensors, "gat.ARG0": torch.zeros(3, 1)}
    with pytest.raises(InvalidInputError, match=r"other shapes: gat\.ARG0 \(3, 1\) instead of \(80, 1\)"):
        graphmotion_models(wrong, **HEADS)
    with pytest.raises(InvalidInputError, match=r"5 heads do not divide"):
        graphmotion_models(tensors, vae_heads=5, denoiser_heads=4)


def test_other_models_are_recognised(tensors: dict[str, torch.Tensor]) -> None:
    mld = mld_tensors()
    with pytest.raises(InvalidInputError, match="import_mld"):
        graphmotion_models(mld, **HEADS)
    with pytest.raises(InvalidInputError, match="import_graphmotion"):
        mld_models(tensors)
    with pytest.raises(InvalidInputError, match="no checkpoint of the released GraphMotion: it has encoder"):
        graphmotion_models({"encoder.weight": torch.zeros(2, 2)}, **HEADS)
    with pytest.raises(InvalidInputError, match="no checkpoint of MLD"):
        mld_models({"vae.x": torch.zeros(2, 2)})


def test_the_published_layouts_are_those_of_our_modules() -> None:
    """Every published name and shape, at the published size, without its 3 GB."""

    def expected(name: str) -> dict[str, torch.Tensor]:
        layout = json.loads(shared_path("fixtures", "official", name).read_text())["parameters"]
        return {
            key: torch.empty(shape, device="meta")
            for key, shape in layout.items()
            if key.split(".")[0] not in IGNORED_PARTS
        }

    with torch.device("meta"):
        models = graphmotion_models(expected("graphmotion_state_dict_layout.json"))
        specific = models.denoisers["specific"].config
        assert (specific.width, specific.layers, specific.heads, specific.feed_forward) == (1024, 17, 16, 4096)
        assert models.vaes["action"].config.tokens == 4
        published = mld_models(expected("mld_state_dict_layout.json"))
        assert (published.denoiser.config.width, published.denoiser.config.layers) == (256, 9)


def import_with(folders: dict[str, Path], checkpoint: Path, out: Path, **changes: Path) -> None:
    import_graphmotion(checkpoint, out=out, heads=(4, 4), **{**folders, **changes})


def test_statistics_of_other_data(tmp_path: Path, tensors: dict[str, torch.Tensor], folders: dict[str, Path]) -> None:
    checkpoint = write_lightning(tmp_path / "a.ckpt", tensors)
    kit = write_statistics(tmp_path / "kit", 251)
    with pytest.raises(InvalidInputError, match=r"\(251,\), of KIT-ML .* 263 features, of HumanML3D"):
        import_with(folders, checkpoint, tmp_path / "out", stats=kit)
    with pytest.raises(InvalidInputError, match=r"Mean\.npy cannot be read"):
        import_with(folders, checkpoint, tmp_path / "out", stats=tmp_path / "absent")
    flat = write_statistics(tmp_path / "flat")
    np.save(flat / "Std.npy", np.zeros(263, dtype=np.float32))
    with pytest.raises(InvalidInputError, match="deviations positive"):
        import_with(folders, checkpoint, tmp_path / "out", stats=flat)
    assert not (tmp_path / "out").exists()


def test_a_checkpoint_of_kit_with_other_statistics(tmp_path: Path, folders: dict[str, Path]) -> None:
    checkpoint = write_lightning(tmp_path / "kit.ckpt", graphmotion_tensors(251))
    with pytest.raises(InvalidInputError, match=r"\(263,\), of HumanML3D .* 251 features, of KIT-ML"):
        import_with(folders, checkpoint, tmp_path / "out")


def test_another_text_encoder(tmp_path: Path, tensors: dict[str, torch.Tensor], folders: dict[str, Path]) -> None:
    checkpoint = write_lightning(tmp_path / "a.ckpt", tensors)
    small = write_clip(tmp_path / "small", width=32)
    with pytest.raises(InvalidInputError, match=r"text encoder 40 wide, and --clip is 32 wide"):
        import_with(folders, checkpoint, tmp_path / "out", clip=small)


def test_a_folder_of_something_else_is_kept(
    tmp_path: Path, tensors: dict[str, torch.Tensor], folders: dict[str, Path]
) -> None:
    checkpoint = write_lightning(tmp_path / "a.ckpt", tensors)
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "thesis.txt").write_text("done")
    with pytest.raises(OutputError, match="is not a bundle"):
        import_with(folders, checkpoint, tmp_path / "out")
    with pytest.raises(InvalidInputError, match=r"has no parser\.bin"):
        import_mld(checkpoint, out=tmp_path / "new", parser=tmp_path, **folders)
    assert (tmp_path / "out" / "thesis.txt").read_text() == "done"


def test_the_command_prints_one_line(
    tmp_path: Path, folders: dict[str, Path], capsys: pytest.CaptureFixture[str]
) -> None:
    arguments = ["--checkpoint", str(tmp_path / "x.ckpt"), "--out", str(tmp_path / "out")]
    arguments += ["--clip", str(folders["clip"]), "--stats", str(folders["stats"])]
    assert command.main(arguments) == 2
    assert "x.ckpt is no file; name the checkpoint" in capsys.readouterr().err
