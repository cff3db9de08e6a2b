"""BONES-SEED in exactly its published folder: 77 joints at 120 a second, timelines, splits of the benchmark."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("tqdm")

from kinegraph.motion.skeleton import canonicalise
from kinegraph_training.data.bones_seed import find_recordings
from kinegraph_training.data.clips import StoredClips, is_sharded, read_split
from kinegraph_training.prepare import main
from support.exporters import true_joints
from support.published_sets import soma_bvh, soma_tree, write_bones_seed

FRAMES = {"220713/walk_001__A001": 600, "220713/jump_001__A002": 480, "220714/dance_001__A001": 1440,
          "220714/walk_002__A003": 240, "220714/walk_001__A001_M": 600}  # fmt: skip


@pytest.fixture(scope="module")
def seed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_bones_seed(tmp_path_factory.mktemp("set") / "bones-seed", FRAMES)


def run(*arguments: object) -> int:
    return main([str(argument) for argument in arguments])


def test_the_made_file_is_as_published() -> None:
    lines = soma_bvh(2).splitlines()
    names = [line.split()[1] for line in lines if line.split()[0] in ("ROOT", "JOINT")]
    assert names[:2] == ["Root", "Hips"] and len(names) == 78 == len(soma_tree()) + 1
    assert "End Site" not in lines
    assert len(lines[-1].split()) == 77 * 3 + 9


def test_motion_captions_timelines_and_splits(seed: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "out"
    assert run("--bones-seed", seed, "--out", out, "--processes", 1) == 0
    said = capsys.readouterr()
    assert "1 mirror images are left out" in said.err
    assert is_sharded(out) and not (tmp_path / "out.partial").exists()
    test = {clip.id: clip for clip in read_split(out, "test")}
    whole = test["220713/jump_001__A002"]
    np.testing.assert_allclose(whole.joints, canonicalise(true_joints(80)), atol=2e-4)
    assert whole.captions[0] == "content_natural_desc_1 of jump" and len(whole.captions) == 6
    assert "technical" not in " ".join(whole.captions)
    assert whole.partial_captions == ("A person starts to walk.", "A person walks on, then waves.")
    half = test["220713/jump_001__A002@2-4"]
    assert half.captions == ("A person walks on, then waves.",) and half.partial_captions == ()
    np.testing.assert_allclose(half.joints, canonicalise(true_joints(80)[40:]), atol=2e-4)
    training = [*read_split(out, "train"), *read_split(out, "val")]
    windows = [clip for clip in training if clip.id.startswith("220714/dance_001__A001@")]
    # 12 s are two windows, whose captions hold at any moment; each stretch of 6 s is a clip as well
    assert len(windows) == 4 and all(len(clip.joints) <= 196 for clip in windows)
    assert read_split(out, "val"), "training needs clips to select the model by"


def test_without_the_benchmark_the_content_divides(seed: Path, tmp_path: Path) -> None:
    hidden = seed / "splits"
    away = hidden.rename(tmp_path / "splits")
    try:
        recordings, remarks = find_recordings(seed, None)
        assert {each.split for each in recordings} >= {"train", "val"}
        assert any("hash of the content" in remark for remark in remarks)
        again, _ = find_recordings(seed, away)
        assert {each.name: each.split for each in again}["220713/jump_001__A002"] == "test"
    finally:
        away.rename(hidden)


def test_a_run_that_was_stopped_goes_on(
    seed: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    from kinegraph_training.data import shards

    monkeypatch.setattr(shards, "JOBS", 1)
    broken = seed / "soma_uniform/bvh/220714/walk_002__A003.bvh"
    text = broken.read_text()
    broken.write_text(text[:-4000])
    out = tmp_path / "out"
    try:
        assert run("--bones-seed", seed, "--out", out, "--processes", 1) == 2
    finally:
        broken.write_text(text)
    said = capsys.readouterr().err
    assert "1 of 4 clips cannot be used" in said and "walk_002__A003.bvh: it says 240 frames and holds" in said
    assert not out.exists()
    kept = {path: path.stat().st_mtime_ns for path in (tmp_path / "out.partial" / "shards").glob("*.joints.npy")}
    assert len(kept) == 4
    assert run("--bones-seed", seed, "--out", out, "--processes", 1) == 0
    after = {path.name: path.stat().st_mtime_ns for path in (out / "shards").glob("*.joints.npy")}
    same = [path.name for path, time in kept.items() if after[path.name] == time]
    assert len(same) == 3, "the shard of the file that was mended is written again, and no other"


def test_processes_write_what_one_writes(seed: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from kinegraph_training.data import shards

    monkeypatch.setattr(shards, "JOBS", 2)
    for count in (1, 2):
        assert run("--bones-seed", seed, "--out", tmp_path / str(count), "--processes", count) == 0
    files = sorted(path.relative_to(tmp_path / "1") for path in (tmp_path / "1").rglob("*") if path.is_file())
    assert len(files) == 6
    for file in files:
        assert (tmp_path / "1" / file).read_bytes() == (tmp_path / "2" / file).read_bytes()


def test_stored_clips_hold_no_motion_and_mirror_it(seed: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    assert run("--bones-seed", seed, "--out", out, "--processes", 1) == 0
    stored = StoredClips.of_split(out, "train").with_mirror_images()
    count = len(stored) // 2
    first, image = stored[0], stored[count]
    assert image.id == f"{first.id}~mirror" and [len(clip.joints) for clip in stored] == stored.frames.tolist()
    np.testing.assert_allclose(image.joints[..., 1].max(), first.joints[..., 1].max(), atol=1e-5)
    assert isinstance(stored[:2], StoredClips) and stored[:2][1].id == stored[1].id


@pytest.mark.parametrize(
    ("harm", "reason"),
    [
        (lambda folder: (folder / "metadata/seed_metadata_v004.csv").unlink(), "lacks metadata/seed_metadata_"),
        (lambda folder: (folder / "metadata/seed_metadata_v004.csv").write_text("a,b\n1,2\n"), "lacks the columns"),
        (lambda folder: (folder / "splits/test_content_split_paths.txt").unlink(), "take all three"),
        (
            lambda folder: (folder / "metadata/seed_metadata_v002_temporal_labels.jsonl").write_text("{}\n"),
            "no timeline",
        ),
        (
            lambda folder: (folder / "metadata/seed_metadata_v002_temporal_labels.jsonl").write_text(
                json.dumps({"filename": "a", "events": [{"start_time": 3, "end_time": 1, "description": "x"}]})
            ),
            "an event from 3 to 1 seconds",
        ),
        (lambda folder: (folder / "soma_uniform").rename(folder / "soma"), "holds no motion"),
    ],
)
def test_folders_of_something_else(tmp_path: Path, harm: object, reason: str) -> None:
    folder = write_bones_seed(tmp_path / "set", {"220713/walk_001__A001": 60, "220713/walk_002__A001": 60})
    harm(folder)  # type: ignore[operator]
    with pytest.raises(ValueError, match=reason):
        find_recordings(folder, None)


def test_metadata_in_parquet(tmp_path: Path, seed: Path) -> None:
    try:
        import pyarrow
        from pyarrow import csv, parquet
    except ImportError:
        (tmp_path / "metadata").mkdir()
        (tmp_path / "soma_uniform" / "bvh").mkdir(parents=True)
        (tmp_path / "metadata" / "seed_metadata_v004.parquet").write_bytes(b"PAR1")
        with pytest.raises(ImportError, match="pip install pyarrow"):
            find_recordings(tmp_path, None)
        return
    assert pyarrow
    table = seed / "metadata" / "seed_metadata_v004.csv"
    told, _ = find_recordings(seed, None)
    parquet.write_table(csv.read_csv(table), table.with_suffix(".parquet"))
    away = table.rename(tmp_path / "away.csv")
    try:
        assert find_recordings(seed, None)[0] == told
    finally:
        away.rename(table)
        table.with_suffix(".parquet").unlink()
