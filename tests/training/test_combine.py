"""Several data folders as one: one body, one name for each action, and where every clip came from."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from support.motions import walk

pytest.importorskip("torch")

from kinegraph.motion.skeleton import bone_lengths
from kinegraph_training.combine import main
from kinegraph_training.data.clips import read_split
from kinegraph_training.data.common_skeleton import BONE_LENGTHS
from kinegraph_training.data.folder import pack_clips, to_json_lines


def write_folder(folder: Path, scale: float, rows: list[dict[str, object]]) -> Path:
    folder.mkdir()
    joints = (walk(40) * scale).astype(np.float32)
    for split in ("train", "dev_test"):
        names = [str(row["id"]) for row in rows if row["split"] == split]
        (folder / f"{split}.npz").write_bytes(pack_clips([(name, joints) for name in names], 20))
    captions = [{"id": row["id"], "captions": [f"a person moves as {row['id']}"]} for row in rows]
    (folder / "captions.jsonl").write_bytes(to_json_lines(captions))
    (folder / "index.jsonl").write_bytes(to_json_lines(rows))
    return folder


@pytest.fixture
def folders(tmp_path: Path) -> list[str]:
    first = write_folder(
        tmp_path / "one",
        1.2,
        [
            {"id": "a", "split": "train", "label": "Run/Jog", "source": "shed", "licence": "MIT", "group": "g1"},
            {"id": "b", "split": "train", "label": "first this, then that", "source": "attic"},
        ],
    )
    second = write_folder(
        tmp_path / "two",
        0.8,
        [
            {"id": "c", "split": "dev_test", "content": "walk-backward", "style_canon": "sad"},
            {"id": "d", "split": "train", "content": "walk+wave-left-hand"},
        ],
    )
    return ["--data", str(first), "--data", str(second)]


def test_bodies_labels_splits_and_origins(folders: list[str], tmp_path: Path) -> None:
    out = tmp_path / "out"
    assert main([*folders, "--out", str(out)]) == 0
    clips = {clip.id: clip for split in ("train", "dev_test") for clip in read_split(out, split)}
    assert {name: clip.actions for name, clip in clips.items()} == {
        "a": ("jog",),
        "b": (),  # it lists several, and is in no table
        "c": ("walk-back",),
        "d": ("walk", "wave-left-hand"),
    }
    for clip in clips.values():
        np.testing.assert_allclose(bone_lengths(clip.joints), np.tile(BONE_LENGTHS, (40, 1)), atol=3e-4)
    rows = {row["id"]: row for row in map(json.loads, (out / "index.jsonl").read_text().splitlines())}
    assert (rows["a"]["data"], rows["a"]["source"], rows["a"]["licence"], rows["a"]["group"]) == (
        "one",
        "shed",
        "MIT",
        "g1",
    )
    assert rows["c"]["split"] == "dev_test" and rows["c"]["style_canon"] == "sad"


def test_sources_can_be_left_out(folders: list[str], tmp_path: Path) -> None:
    assert main([*folders, "--out", str(tmp_path / "out"), "--without-source", "attic"]) == 0
    assert {clip.id for clip in read_split(tmp_path / "out", "train")} == {"a", "d"}


def test_two_clips_of_one_name_are_refused(folders: list[str], tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    assert main([*folders, "--data", folders[1], "--out", str(tmp_path / "out")]) == 2
    assert "2 ids occur in two folders" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
