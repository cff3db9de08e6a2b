"""The papers' protocol on a made HumanML3D: words, crops, groups, columns; wrong files are told."""

from __future__ import annotations

import json
import pickle
from pathlib import Path

import numpy as np
import pytest

torch = pytest.importorskip("torch")
pytest.importorskip("onnx")

from kinegraph.errors import InvalidInputError
from kinegraph.motion.humanml3d import humanml3d_from_joints
from kinegraph_benchmarks.common.guo_evaluators import TAGS, GuoEvaluators, WordVectors
from kinegraph_benchmarks.common.published_test import Caption, PublishedClip, draw_items
from kinegraph_benchmarks.common.tmr_evaluator import COLUMNS as TMR_COLUMNS
from kinegraph_benchmarks.quality import evaluate_published as command
from kinegraph_export.import_evaluators import import_evaluators
from kinegraph_training.data.humanml3d_reader import SETS
from support.guo_evaluators import WORDS, evaluator_tensors, write_evaluator_stats, write_glove
from support.motions import walk
from support.published_sets import write_guo_set
from support.tmr import write_tmr_graphs
from support.toy import with_parser


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    top = tmp_path_factory.mktemp("published")
    state = {name: torch.from_numpy(value) for name, value in evaluator_tensors().items()}
    torch.save({"state_dict": state}, top / "evaluators.ckpt")
    import_evaluators(top / "evaluators.ckpt", top / "evaluators")
    vectors = {f"{n:06d}": humanml3d_from_joints(walk(100 + n, turning=0.01 * n)) for n in range(4)}
    folder = write_guo_set(top / "HumanML3D", {}, vectors)
    (folder / "test.txt").write_text("000001\n000003\n")
    (folder / "train.txt").write_text("000000\n")
    return {
        "humanml3d": folder,
        "evaluators": top / "evaluators",
        "evaluator-stats": write_evaluator_stats(top / "meta"),
        "glove": write_glove(top / "glove"),
        "bundle": with_parser(top / "bundle"),
    }


def run(files: dict[str, Path], *more: object) -> int:
    words = [str(word) for name, path in files.items() for word in (f"--{name}", path)]
    return command.main([*words, *map(str, more)])


def test_the_papers_columns_are_printed(
    files: dict[str, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(files, "--out", tmp_path / "out.json", "--repeats", 2, "--many", 2) == 0
    table = capsys.readouterr().out
    assert "| | R@1 | R@2 | R@3 | FID | MM-Dist | Diversity | Multimodality |" in table
    result = json.loads((tmp_path / "out.json").read_text())
    # two clips, each whole and from 2 to 5 s
    assert (result["data"], result["clips"], result["repeats"]) == ("HumanML3D", 4, 2)
    assert set(result["generated"]) == set(command.COLUMNS)
    assert result["captured"]["fid"]["mean"] < 1e-4 < result["generated"]["fid"]["mean"]
    assert result["captured"]["r_precision_3"]["mean"] >= result["captured"]["r_precision_1"]["mean"]


def test_words_and_tags_as_the_text_encoder_was_trained(files: dict[str, Path]) -> None:
    words = WordVectors.read(files["glove"])
    tokens = ("a/DET", "person/NOUN", "walk/VERB", "left/ADV", "quixotic/ADJ", "turn/XX")
    vectors, tags, length = words.encode(tokens)
    assert vectors.shape == (22, 300) and length == 8
    kinds = [TAGS[row] for row in tags.argmax(axis=1)]
    # key words have a kind of their own; words without a vector are unknown, whatever their part of speech
    assert kinds[:8] == ["OTHER", "DET", "NOUN", "Act_VIP", "Loc_VIP", "OTHER", "Act_VIP", "OTHER"]
    np.testing.assert_array_equal(vectors[5], words.vectors[WORDS.index("unk")])
    np.testing.assert_array_equal(vectors[8:], np.tile(words.vectors[WORDS.index("unk")], (14, 1)))
    assert words.encode(("walk/VERB",) * 40)[2] == 22


def test_crops_are_multiples_of_four_frames() -> None:
    rows = np.arange(103.0)[:, None]
    clip = PublishedClip("x", rows, (Caption("a", ("a/DET",)), Caption("b", ("b/DET",))))
    rng = np.random.Generator(np.random.PCG64(0))
    crops, captions = draw_items([clip] * 300, rng)
    lengths = [len(crop) for crop in crops]
    assert set(lengths) == {96, 100}
    assert 0.25 < np.mean(np.array(lengths) == 96) < 0.42
    assert all((np.diff(crop[:, 0]) == 1).all() for crop in crops) and len({crop[0, 0] for crop in crops}) > 4
    assert {caption.text for caption in captions} == {"a", "b"}


def test_embeddings_do_not_depend_on_the_batch(files: dict[str, Path]) -> None:
    evaluators = GuoEvaluators(files["evaluators"], files["evaluator-stats"], WordVectors.read(files["glove"]))
    rng = np.random.Generator(np.random.PCG64(1))
    motions = [rng.standard_normal((4 * frames, 263)).astype(np.float32) for frames in (10, 25, 17)]
    together = evaluators.embed_motions(motions)
    longer = evaluators.embed_motions([np.concatenate([motions[0], np.zeros((8, 263), dtype=np.float32)])])
    assert np.abs(longer - together[0]).max() > 1e-4, "a longer motion is another one, even if it adds zeros"
    for row, motion in enumerate(motions):
        np.testing.assert_allclose(evaluators.embed_motions([motion])[0], together[row], atol=1e-5)


def test_wrong_files_are_told(files: dict[str, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run({**files, "evaluators": tmp_path}) == 2
    assert "python -m kinegraph_export.import_evaluators" in capsys.readouterr().err
    assert run({**files, "evaluator-stats": write_evaluator_stats(tmp_path / "kit", 251)}) == 2
    assert "these evaluators have 263 features" in capsys.readouterr().err
    assert run({**files, "humanml3d": tmp_path}) == 2
    assert "the published folder has train.txt" in capsys.readouterr().err
    broken = write_glove(tmp_path / "glove")
    (broken / "our_vab_words.pkl").write_bytes(pickle.dumps([Path("x")]))
    with pytest.raises(InvalidInputError, match="it holds pathlib"):
        WordVectors.read(broken)
    kit = write_guo_set(tmp_path / "KIT-ML", {}, {f"{n:05d}": np.zeros((60, 251)) for n in range(3)})
    assert run({"kit": kit, **{name: path for name, path in files.items() if name != "humanml3d"}}) == 2
    assert "the evaluators have 263 features, KIT-ML has 251" in capsys.readouterr().err


def test_tmr_adds_its_columns_and_changes_no_other(
    files: dict[str, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write_tmr_graphs(tmp_path / "tmr")
    arguments = ("--repeats", 1, "--many", 0, "--clips", 2)
    for name, more in (("plain", ()), ("tmr", ("--tmr", tmp_path / "tmr"))):
        assert run(files, "--out", tmp_path / f"{name}.json", *arguments, *more) == 0
    assert "| Multimodality | TMR R@1 | TMR R@2 | TMR R@3 | TMR M2T | TMR M2M |" in capsys.readouterr().out
    plain, with_tmr = (json.loads((tmp_path / f"{name}.json").read_text()) for name in ("plain", "tmr"))
    for shown in ("captured", "generated"):
        assert {name: with_tmr[shown][name] for name in plain[shown]} == plain[shown]
        assert set(with_tmr[shown]) == set(plain[shown]) | set(TMR_COLUMNS)
    assert with_tmr["captured"]["tmr_m2m"]["mean"] == pytest.approx(1.0, abs=1e-6)
    assert 0.0 <= with_tmr["generated"]["tmr_m2m"]["mean"] < 0.9999
    with pytest.raises(InvalidInputError, match="TMR reads the 263 features of HumanML3D, KIT-ML has 251"):
        command.load_tmr(tmp_path / "tmr", SETS["--kit"])
