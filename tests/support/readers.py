"""Programs that are not ours, reading files that are: pygltflib, pybvh and Blender. Tests are skipped without them."""

from __future__ import annotations

import importlib.util
import json
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from kinegraph.motion.skeleton import JOINT_NAMES

DTYPES = {5126: np.float32, 5121: np.uint8, 5123: np.uint16}
WIDTHS = {"SCALAR": 1, "VEC3": 3, "VEC4": 4, "MAT4": 16}
IN_BLENDER = Path(__file__).resolve().parents[1] / "oracle" / "blender_joints.py"


def matrix(translation: np.ndarray, rotation: np.ndarray) -> np.ndarray:
    """Of a node, from its x, y, z, w quaternion, by the textbook formula."""
    x, y, z, w = (float(value) for value in rotation)
    found = np.eye(4)
    found[:3, :3] = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    found[:3, 3] = translation
    return found


class GlbReader:
    """A GLB as pygltflib sees it, played by the rules of the glTF specification."""

    def __init__(self, data: bytes, folder: Path) -> None:
        pygltflib = pytest.importorskip("pygltflib")
        (folder / "clip.glb").write_bytes(data)
        self.file = pygltflib.GLTF2().load(str(folder / "clip.glb"))
        self._blob = self.file.binary_blob()

    def array(self, number: int) -> np.ndarray:
        accessor = self.file.accessors[number]
        view = self.file.bufferViews[accessor.bufferView]
        width = WIDTHS[accessor.type]
        dtype = DTYPES[accessor.componentType]
        return np.frombuffer(self._blob, dtype, accessor.count * width, view.byteOffset).reshape(accessor.count, width)

    def places(self, frame: int | None) -> dict[int, np.ndarray]:
        """World matrix of every node at a key, or at rest."""
        tracks: dict[tuple[int, str], np.ndarray] = {}
        for channel in self.file.animations[0].channels:
            sampler = self.file.animations[0].samplers[channel.sampler]
            tracks[channel.target.node, channel.target.path] = self.array(sampler.output)
        found: dict[int, np.ndarray] = {}

        def visit(number: int, above: np.ndarray) -> None:
            node = self.file.nodes[number]
            own = {"translation": node.translation or [0, 0, 0], "rotation": node.rotation or [0, 0, 0, 1]}
            for path in own:
                if frame is not None and (number, path) in tracks:
                    own[path] = tracks[number, path][frame]
            found[number] = above @ matrix(own["translation"], own["rotation"])
            for child in node.children or []:
                visit(child, found[number])

        for root in self.file.scenes[0].nodes:
            visit(root, np.eye(4))
        return found

    def joints(self, frame: int) -> np.ndarray:
        """(22, 3) metres: where the joints of the skin are at a key."""
        world = self.places(frame)
        return np.stack([world[node][:3, 3] for node in self.file.skins[0].joints])


def bvh_joints(path: Path) -> tuple[np.ndarray, float]:
    """(frames, 22, 3) metres and the frame rate, as pybvh reads them."""
    found = pytest.importorskip("pybvh").read_bvh_file(str(path))
    order = [list(found.joint_names).index(name) for name in JOINT_NAMES]
    return np.asarray(found.joint_positions())[:, order] / 100.0, float(found.fps)


def blender(*files: Path) -> dict[str, Any]:
    """What `blender_joints.py` finds of these files, the .npz first."""
    if shutil.which("blender"):
        command = ["blender", "-b", "--python-exit-code", "1", "--python", str(IN_BLENDER), "--"]
    elif importlib.util.find_spec("bpy"):
        command = [sys.executable, str(IN_BLENDER)]
    else:
        pytest.skip("needs Blender: apt-get install blender python3-numpy, or pip install bpy")
    done = subprocess.run([*command, *map(str, files)], capture_output=True, text=True, timeout=200, check=False)
    assert done.returncode == 0, done.stdout[-2000:] + done.stderr[-2000:]
    (line,) = (line for line in done.stdout.splitlines() if line.startswith("{"))
    found: dict[str, Any] = json.loads(line)
    return found
