"""Files of kinegraph as other programs read them: pygltflib, pybvh and Blender. Tests are skipped without them."""

from __future__ import annotations

import importlib.util
import json
import shutil
import subprocess
import sys
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from kinegraph.motion.skeleton import JOINT_NAMES

DTYPES = {5126: np.float32, 5121: np.uint8, 5123: np.uint16}
WIDTHS = {"SCALAR": 1, "VEC3": 3, "VEC4": 4, "MAT4": 16}
IN_BLENDER = Path(__file__).resolve().parents[1] / "oracle" / "blender_joints.py"


def matrix(translation: np.ndarray, rotation: np.ndarray, scale: np.ndarray | float = 1.0) -> np.ndarray:
    """Build the (4, 4) transform of a node from its x, y, z, w quaternion by the textbook formula."""
    x, y, z, w = (float(value) for value in rotation)
    transform = np.eye(4)
    transform[:3, :3] = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    transform[:3, :3] *= scale
    transform[:3, 3] = translation
    return transform


class GlbReader:
    """A GLB as pygltflib sees it, played by the rules of the glTF specification."""

    def __init__(self, data: bytes, folder: Path) -> None:
        pygltflib = pytest.importorskip("pygltflib", reason="needs the extra oracle")
        (folder / "clip.glb").write_bytes(data)
        self.file = pygltflib.GLTF2().load(str(folder / "clip.glb"))
        self._blob = self.file.binary_blob()

    def array(self, number: int) -> np.ndarray:
        accessor = self.file.accessors[number]
        view = self.file.bufferViews[accessor.bufferView]
        width = WIDTHS[accessor.type]
        dtype = DTYPES[accessor.componentType]
        return np.frombuffer(self._blob, dtype, accessor.count * width, view.byteOffset).reshape(accessor.count, width)

    def world_transforms(self, frame: int | None, animation: int = 0) -> dict[int, np.ndarray]:
        """Compute the world matrix of every node at a key of an animation, or at rest."""
        tracks: dict[tuple[int, str], np.ndarray] = {}
        for channel in self.file.animations[animation].channels:
            sampler = self.file.animations[animation].samplers[channel.sampler]
            tracks[channel.target.node, channel.target.path] = self.array(sampler.output)
        world: dict[int, np.ndarray] = {}

        def visit(number: int, parent: np.ndarray) -> None:
            node = self.file.nodes[number]
            local = {"translation": node.translation or [0, 0, 0], "rotation": node.rotation or [0, 0, 0, 1]}
            for path in local:
                if frame is not None and (number, path) in tracks:
                    local[path] = tracks[number, path][frame]
            own = matrix(local["translation"], local["rotation"], node.scale or 1.0)
            if node.matrix and (number, "rotation") not in tracks:
                own = np.array(node.matrix).reshape(4, 4).T
            world[number] = parent @ own
            for child in node.children or []:
                visit(child, world[number])

        for root in self.file.scenes[0].nodes:
            visit(root, np.eye(4))
        return world

    def points(self, animation: int) -> np.ndarray:
        """Locate the joints of the skin at every key of an animation: (keys, joints, 3)."""
        world = self.nodes(animation)
        return np.stack([world[node] for node in self.file.skins[0].joints], axis=1)

    def nodes(self, animation: int) -> dict[int, np.ndarray]:
        """Locate every node at every key of an animation: node -> (keys, 3); all keys at once."""
        tracks, count = {}, 1
        for channel in self.file.animations[animation].channels:
            sampler = self.file.animations[animation].samplers[channel.sampler]
            tracks[channel.target.node, channel.target.path] = self.array(sampler.output).astype(np.float64)
            count = self.file.accessors[sampler.input].count
        world: dict[int, np.ndarray] = {}

        def visit(number: int, parent: np.ndarray) -> None:
            node = self.file.nodes[number]
            own = np.tile(np.eye(4), (count, 1, 1))
            if node.matrix and (number, "rotation") not in tracks:
                own[:] = np.array(node.matrix).reshape(4, 4).T
            else:
                x, y, z, w = np.moveaxis(
                    tracks.get((number, "rotation"), np.array([node.rotation or [0, 0, 0, 1]])), -1, 0
                )
                rows = [
                    [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
                    [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
                    [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
                ]
                own[:, :3, :3] = np.moveaxis(np.array(rows), -1, 0) * (node.scale or [1, 1, 1])
                own[:, :3, 3] = tracks.get((number, "translation"), node.translation or [0, 0, 0])
            world[number] = parent @ own
            for child in node.children or []:
                visit(child, world[number])

        for root in self.file.scenes[0].nodes:
            visit(root, np.eye(4))
        return {number: transforms[:, :3, 3] for number, transforms in world.items()}

    def joints(self, frame: int) -> np.ndarray:
        """Locate the joints of the skin at a key: (22, 3) metres."""
        world = self.world_transforms(frame)
        return np.stack([world[node][:3, 3] for node in self.file.skins[0].joints])


def bvh_joints(path: Path) -> tuple[np.ndarray, float]:
    """Read joints (frames, 22, 3) in metres and the frame rate with pybvh."""
    motion = pytest.importorskip("pybvh", reason="needs the extra oracle").read_bvh_file(str(path))
    order = [list(motion.joint_names).index(name) for name in JOINT_NAMES]
    return np.asarray(motion.joint_positions())[:, order] / 100.0, float(motion.fps)


@cache
def blender_problem() -> str:
    """Say why the program blender cannot be used here; "" where it can."""
    if shutil.which("blender") is None:
        return "needs the program blender: apt-get install blender python3-numpy"
    command = ["blender", "-b", "--python-exit-code", "1", "--python-expr", "import numpy"]
    if subprocess.run(command, capture_output=True, timeout=200, check=False).returncode:
        return "Blender's Python cannot import numpy: apt-get install python3-numpy"
    return ""


def blender(*files: Path) -> dict[str, Any]:
    """Run `blender_joints.py` in Blender on these files, the .npz first, and return its report."""
    problem = blender_problem()
    if not problem:
        command = ["blender", "-b", "--python-exit-code", "1", "--python", str(IN_BLENDER), "--"]
    elif importlib.util.find_spec("bpy"):
        command = [sys.executable, str(IN_BLENDER)]
    else:
        pytest.skip(f"{problem}; or pip install bpy")
    process = subprocess.run([*command, *map(str, files)], capture_output=True, text=True, timeout=200, check=False)
    assert process.returncode == 0, process.stdout[-2000:] + process.stderr[-2000:]
    (line,) = (line for line in process.stdout.splitlines() if line.startswith("{"))
    report: dict[str, Any] = json.loads(line)
    return report
