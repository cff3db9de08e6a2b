"""Draw characters.png: three characters of the tests do one clip, and the body of `.glb` beside them."""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from mpl_toolkits.mplot3d.art3d import Poly3DCollection

from kinegraph import Clip, MotionPipeline
from kinegraph.formats import encode
from kinegraph.formats.gltf import read_array, split_container

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "tests"))
from support.characters import BUILDS, make_character
from support.readers import GlbReader

SHOWN = ("Mixamo, T-pose, centimetres", "Unity, wide and short", "VRM 1, long legs")
KEYS = (0.0, 0.25, 0.5, 0.75, 1.0)


def meshes(data: bytes, folder: Path, share: float) -> tuple[np.ndarray, np.ndarray]:
    """Skin the body at a share of its last animation: vertices (n, 3) and triangles (m, 3)."""
    reader = GlbReader(data, folder)
    document, binary = split_container(data)
    last = len(document["animations"]) - 1
    keys = document["accessors"][document["animations"][last]["samplers"][0]["input"]]["count"]
    world = reader.world_transforms(round(share * (keys - 1)), last)
    skin, part = document["skins"][0], document["meshes"][0]["primitives"][0]
    bind = read_array(document, binary, skin["inverseBindMatrices"]).reshape(-1, 4, 4).transpose(0, 2, 1)
    moved = np.stack([world[node] for node in skin["joints"]]) @ bind
    positions, joints, weights = (
        read_array(document, binary, part["attributes"][name]) for name in ("POSITION", "JOINTS_0", "WEIGHTS_0")
    )
    points = np.column_stack([positions, np.ones(len(positions))])
    vertices = np.einsum("nk,nkij,nj->ni", weights, moved[joints.astype(int)], points)[:, :3]
    return vertices, read_array(document, binary, part["indices"])[:, 0].reshape(-1, 3).astype(int)


def draw(axes: plt.Axes, vertices: np.ndarray, triangles: np.ndarray, height: float) -> None:
    points = vertices[:, [0, 2, 1]] * (1, -1, 1) / height
    normals = np.cross(
        points[triangles[:, 1]] - points[triangles[:, 0]], points[triangles[:, 2]] - points[triangles[:, 0]]
    )
    normals /= np.linalg.norm(normals, axis=1, keepdims=True) + 1e-12
    shade = 0.55 + 0.4 * np.abs(normals @ (0.4, 0.5, 0.7))
    axes.add_collection3d(Poly3DCollection(points[triangles], facecolors=np.array([0.45, 0.6, 0.85]) * shade[:, None]))
    middle = (points.min(0) + points.max(0)) / 2
    axes.set_xlim(middle[0] - 0.45, middle[0] + 0.45)
    axes.set_ylim(middle[1] - 0.45, middle[1] + 0.45)
    axes.set_zlim(0, 0.95)
    axes.set_box_aspect((1, 1, 1.05), zoom=1.3)
    axes.view_init(10, -60)
    axes.axis("off")


def main() -> None:
    clip: Clip = MotionPipeline.load().generate("a person walks forward and waves the right hand", seconds=4, seed=7)
    rows = 1 + len(SHOWN)
    figure = plt.figure(figsize=(1.9 * len(KEYS), 2.1 * rows))
    with tempfile.TemporaryDirectory() as name:
        files = [encode(clip, ".glb")]
        for build in SHOWN:
            hero = Path(name, "hero.glb")
            hero.write_bytes(make_character(BUILDS[build]))
            files.append(clip.onto(hero).encode())
        for row, data in enumerate(files):
            height = 0.0
            for column, share in enumerate(KEYS):
                vertices, triangles = meshes(data, Path(name), share)
                height = height or float(np.ptp(vertices[:, 1])) * 1.35
                axes = figure.add_subplot(rows, len(KEYS), row * len(KEYS) + column + 1, projection="3d")
                draw(axes, vertices, triangles, height)
    figure.subplots_adjust(0, 0, 1, 1, 0, 0)
    figure.savefig(Path(__file__).with_name("characters.png"), dpi=65)


main()
