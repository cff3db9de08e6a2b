"""GLB clips, ours and those of Mixamo characters, become the same joints as BVH files."""

from __future__ import annotations

import copy
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("pygltflib", reason="needs pygltflib, of the extra glb")

from kinegraph.clip import Clip
from kinegraph.errors import InvalidInputError, MissingExtraError
from kinegraph.motion.skeleton import canonicalise
from kinegraph_training.data.clips import read_split
from kinegraph_training.data.glb import read_recording
from kinegraph_training.data.understanding import Stated, Understood, understand
from kinegraph_training.prepare import main
from support.exporters import true_joints
from support.glb_files import container, mixamo_glb, mixamo_parts

TRUTH = canonicalise(true_joints(21))


def read(tmp_path: Path, data: bytes) -> Understood:
    path = tmp_path / "walk.glb"
    path.write_bytes(data)
    return understand(read_recording(path), Stated(), 20.0)


@pytest.mark.parametrize(
    ("options", "close"),
    [
        ({}, 0.004),
        ({"short": True}, 0.004),
        ({"interpolation": "STEP", "fps": 60.0, "frames": 61}, 1e-4),
        ({"interpolation": "CUBICSPLINE", "keys": 3}, 0.01),
        ({"keys": 30, "frames": 31}, 2.0),
    ],
)
def test_mixamo_characters(tmp_path: Path, options: dict[str, Any], close: float) -> None:
    found = read(tmp_path, mixamo_glb(**options))
    assert found.joints.shape == TRUTH.shape
    assert np.linalg.norm(found.joints - TRUTH, axis=-1).max() <= close
    assert (found.up, found.unit) == ("y", "metres")
    assert any("sparse" in warning for warning in found.warnings) == (options.get("keys") == 30)


@pytest.mark.parametrize(("names", "root"), [("smpl", False), ("mixamo", True)])
def test_our_own_clips(tmp_path: Path, names: str, root: bool) -> None:
    clip = Clip(joints=TRUTH, fps=20.0, seed=0, text="x", bundle="b")
    clip.save(tmp_path / "own.glb", names=names, root=root)
    found = read(tmp_path, (tmp_path / "own.glb").read_bytes())
    assert np.linalg.norm(found.joints - TRUTH, axis=-1).max() <= 2e-3
    assert found.fps == 20


def test_a_folder_may_hold_both_kinds(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "in").mkdir()
    (tmp_path / "in" / "a.glb").write_bytes(mixamo_glb())
    Clip(joints=TRUTH, fps=20.0, seed=0, text="x", bundle="b").save(tmp_path / "in" / "b.bvh")
    (tmp_path / "c.csv").write_text("a.glb,walks\nb.bvh,walks\n")
    paths = ["--bvh", str(tmp_path / "in"), "--captions", str(tmp_path / "c.csv"), "--out", str(tmp_path / "out")]
    assert main([*paths, "--val", "0", "--test", "0"]) == 0
    first, second = read_split(tmp_path / "out", "train")
    assert np.linalg.norm(first.joints - second.joints, axis=-1).max() <= 0.005


def _without_animation(document: dict[str, Any]) -> None:
    del document["animations"]


def _twice(document: dict[str, Any]) -> None:
    document["animations"] *= 2


def _external(document: dict[str, Any]) -> None:
    document["buffers"][0]["uri"] = "/etc/passwd"


def _circle(document: dict[str, Any]) -> None:
    document["nodes"][22]["children"] = [1]
    document["nodes"][0]["children"] = []


def _far(document: dict[str, Any]) -> None:
    document["accessors"][1]["count"] = 4_000_000


def _huge(document: dict[str, Any]) -> None:
    document["accessors"][0]["count"] = 10**15


def _no_samplers(document: dict[str, Any]) -> None:
    document["animations"][0]["samplers"] = []


def _strange_node(document: dict[str, Any]) -> None:
    document["animations"][0]["channels"][0]["target"]["node"] = 999


def _nothing_moves(document: dict[str, Any]) -> None:
    for channel in document["animations"][0]["channels"]:
        channel["target"]["path"] = "weights"


def _wrong_type(document: dict[str, Any]) -> None:
    document["accessors"][1]["type"] = "MAT4"


def _sparse(document: dict[str, Any]) -> None:
    document["accessors"][1]["sparse"] = {
        "count": 1,
        "indices": {"bufferView": 0, "componentType": 5123},
        "values": {"bufferView": 0},
    }


def _renamed(document: dict[str, Any]) -> None:
    document["nodes"][1]["name"] = "Lump"


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (_without_animation, "no animation"),
        (_twice, r"2 animations \(Walk, Walk\)"),
        (_external, "another file"),
        (_circle, "circle|two parents"),
        (_far, "cut short"),
        (_huge, "a track has 1,000,000,000,000 frames"),
        (_no_samplers, "no GLB file"),
        (_strange_node, "node 999"),
        (_nothing_moves, "moves no node"),
        (_wrong_type, "no GLB file"),
        (_sparse, "sparse"),
        (_renamed, "no joint found for pelvis"),
    ],
)
def test_other_documents_are_refused_with_the_reason(
    tmp_path: Path, change: Callable[[dict[str, Any]], None], message: str
) -> None:
    document, blob = mixamo_parts()
    document = copy.deepcopy(document)
    change(document)
    with pytest.raises(InvalidInputError, match=message):
        read(tmp_path, container(document, blob))


def test_broken_bytes_are_refused(tmp_path: Path) -> None:
    """Flips and cuts never end otherwise than in joints or in our error."""
    data = mixamo_glb(frames=17)
    rng = np.random.default_rng(1)
    outcomes = {"read": 0, "refused": 0}
    for number in range(60):
        broken = bytearray(data)
        for at in rng.integers(0, len(data) if number % 2 else 6000, size=3):
            broken[at] = rng.integers(0, 256)
        try:
            read(tmp_path, bytes(broken[: len(data) if number % 3 else int(rng.integers(0, len(data)))]))
            outcomes["read"] += 1
        except InvalidInputError:
            outcomes["refused"] += 1
    assert outcomes["refused"] > 20


def test_without_the_library_the_extra_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pygltflib", None)
    with pytest.raises(MissingExtraError, match=r'pip install "kinegraph\[glb\]"'):
        read(tmp_path, mixamo_glb())
