"""Characters for tests: skinned humans in the rigs that people use, made joint by joint and written with `json`."""

from __future__ import annotations

import json
import struct
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

SIDES = ("left", "right")
MIDLINE = ("pelvis", "spine1", "spine2", "spine3", "neck", "head")
LIMBS = ("hip", "knee", "ankle", "foot", "collar", "shoulder", "elbow", "wrist")
CHAINS = {
    "pelvis": None, "spine1": "pelvis", "spine2": "spine1", "spine3": "spine2", "neck": "spine3", "head": "neck",
    "hip": "pelvis", "knee": "hip", "ankle": "knee", "foot": "ankle", "toe_end": "foot",
    "collar": "spine3", "shoulder": "collar", "elbow": "shoulder", "wrist": "elbow",
}  # fmt: skip


def sided(pattern: str, left: str, right: str, **parts: str) -> dict[str, str]:
    """Names of all limbs; `{s}` of the pattern is the side and `{n}` the part."""
    return {
        f"{side}_{joint}": pattern.format(s=mark, n=part)
        for side, mark in zip(SIDES, (left, right), strict=True)
        for joint, part in parts.items()
    }


def midline(*names: str) -> dict[str, str]:
    return dict(zip(MIDLINE, names, strict=True))


MIXAMO = midline(*(f"mixamorig:{name}" for name in ["Hips", "Spine", "Spine1", "Spine2", "Neck", "Head"])) | sided(
    "mixamorig:{s}{n}", "Left", "Right", hip="UpLeg", knee="Leg", ankle="Foot", foot="ToeBase", collar="Shoulder",
    shoulder="Arm", elbow="ForeArm", wrist="Hand",
)  # fmt: skip
UNREAL = midline("pelvis", "spine_01", "spine_02", "spine_03", "neck_01", "head") | sided(
    "{n}_{s}", "l", "r", hip="thigh", knee="calf", ankle="foot", foot="ball", collar="clavicle", shoulder="upperarm",
    elbow="lowerarm", wrist="hand",
)  # fmt: skip
UNITY = midline("Hips", "Spine", "Chest", "UpperChest", "Neck", "Head") | sided(
    "{s}{n}", "Left", "Right", hip="UpperLeg", knee="LowerLeg", ankle="Foot", foot="Toes", collar="Shoulder",
    shoulder="UpperArm", elbow="LowerArm", wrist="Hand",
)  # fmt: skip
VROID = midline(*(f"J_Bip_C_{name}" for name in ["Hips", "Spine", "Chest", "UpperChest", "Neck", "Head"])) | sided(
    "J_Bip_{s}_{n}", "L", "R", hip="UpperLeg", knee="LowerLeg", ankle="Foot", foot="ToeBase", collar="Shoulder",
    shoulder="UpperArm", elbow="LowerArm", wrist="Hand",
)  # fmt: skip
RIGIFY = midline(*(f"DEF-spine{name}" for name in ("", ".001", ".002", ".003", ".004", ".006"))) | sided(
    "DEF-{n}.{s}", "L", "R", hip="thigh", knee="shin", ankle="foot", foot="toe", collar="shoulder",
    shoulder="upper_arm", elbow="forearm", wrist="hand",
)  # fmt: skip
CREATOR = midline(
    *(f"CC_Base_{name}" for name in ("Hip", "Waist", "Spine01", "Spine02", "NeckTwist01", "Head"))
) | sided(
    "CC_Base_{s}_{n}", "L", "R", hip="Thigh", knee="Calf", ankle="Foot", foot="ToeBase", collar="Clavicle",
    shoulder="Upperarm", elbow="Forearm", wrist="Hand",
)  # fmt: skip
SOMA = midline("Hips", "Spine1", "Spine2", "Chest", "Neck1", "Head") | sided(
    "{s}{n}", "Left", "Right", hip="Leg", knee="Shin", ankle="Foot", foot="ToeBase", collar="Shoulder",
    shoulder="Arm", elbow="ForeArm", wrist="Hand",
)  # fmt: skip
MAKEHUMAN = midline("root", "spine05", "spine03", "spine01", "neck01", "head") | sided(
    "{n}.{s}", "L", "R", hip="upperleg01", knee="lowerleg01", ankle="foot", foot="toe1-1", collar="clavicle",
    shoulder="upperarm01", elbow="lowerarm01", wrist="wrist",
)  # fmt: skip
BIPED = midline("Bip01 Pelvis", "Bip01 Spine", "Bip01 Spine1", "Bip01 Spine2", "Bip01 Neck", "Bip01 Head") | sided(
    "Bip01 {s} {n}", "L", "R", hip="Thigh", knee="Calf", ankle="Foot", foot="Toe0", collar="Clavicle",
    shoulder="UpperArm", elbow="Forearm", wrist="Hand",
)  # fmt: skip
NAMELESS = {
    joint: f"bone_{number}" for number, joint in enumerate([*MIDLINE, *(f"{s}_{j}" for s in SIDES for j in LIMBS)])
}


@dataclass(frozen=True)
class Build:
    """How a character is made; the defaults have our proportions."""

    names: dict[str, str]
    arms_down: float = 0.0
    """Degrees below the horizontal: 0 is a T-pose, 45 an A-pose."""
    unit: float = 1.0
    """Units of the joints per metre."""
    node_scale: float = 1.0
    """Scale of the node above the skeleton."""
    roll: int | None = None
    """Seed of random joint orientations; None leaves all axes parallel to the world's."""
    facing: float = 0.0
    """Degrees about +Y."""
    z_up_node: bool = False
    """Whether the node above turns Z up to Y up, as exporters of Blender and 3ds Max write."""
    legs: float = 1.0
    thigh_share: float = 0.488
    torso: float = 1.0
    arms: float = 1.0
    shoulders: float = 1.0
    hips: float = 1.0
    ankle_height: float = 0.076
    foot_length: float = 0.09
    girth: float = 1.0
    """Factor on the thickness of trunk and thighs: 1 is a box of 20 cm about the spine."""
    spine_joints: int = 3
    twist: bool = False
    """Whether each upper limb has a twist joint, and the thigh one between itself and the shin."""
    fingers: bool = False
    collars: bool = True
    toes: bool = True
    drop: tuple[str, ...] = ()
    """Joints left out, with all below."""
    above: str | None = "Armature"
    """Name of the node above the skeleton; None has the pelvis at the top."""
    extra: dict[str, Any] = field(default_factory=dict)
    """Merged into the document."""


def rest_points(build: Build) -> dict[str, np.ndarray]:
    """Joints at rest in metres: standing on y = 0 and facing +Z."""
    leg = 0.801 * build.legs
    hip_y = build.ankle_height + leg
    points = {"pelvis": np.array([0.0, hip_y + 0.03, 0.0])}
    spine = [f"spine{index + 1}" for index in range(build.spine_joints)]
    height = 0.41 * build.torso
    for index, name in enumerate(spine):
        points[name] = points["pelvis"] + (0.0, (0.08 + 0.24 * index / max(1, len(spine) - 1)) * build.torso, 0.0)
    chest = points[spine[-1]] if spine else points["pelvis"]
    points["neck"] = points["pelvis"] + (0.0, height + 0.1, -0.01)
    points["head"] = points["neck"] + (0.0, 0.09, 0.012)
    down = np.radians(build.arms_down)
    for side, sign in zip(SIDES, (1.0, -1.0), strict=True):
        out = np.array([sign * np.cos(down), -np.sin(down), 0.0])
        hip = np.array([sign * 0.085 * build.hips, hip_y, 0.0])
        points[f"{side}_hip"] = hip
        points[f"{side}_knee"] = hip - (0.0, leg * build.thigh_share, -0.005)
        points[f"{side}_ankle"] = np.array([hip[0], build.ankle_height, -0.02])
        points[f"{side}_foot"] = points[f"{side}_ankle"] + (0.0, 0.012 - build.ankle_height, build.foot_length)
        points[f"{side}_toe_end"] = points[f"{side}_foot"] + (0.0, 0.0, 0.06)
        points[f"{side}_collar"] = chest + np.array([sign * 0.05, 0.12, 0.0])
        points[f"{side}_shoulder"] = points[f"{side}_collar"] + np.array([sign * 0.13 * build.shoulders, 0.0, -0.02])
        points[f"{side}_elbow"] = points[f"{side}_shoulder"] + out * 0.26 * build.arms
        points[f"{side}_wrist"] = points[f"{side}_elbow"] + out * 0.25 * build.arms
    return points


def hierarchy(build: Build) -> list[tuple[str, str | None]]:
    """Joint and parent, parents first."""
    spine = [f"spine{index + 1}" for index in range(build.spine_joints)]
    chest = spine[-1] if spine else "pelvis"
    rows: list[tuple[str, str | None]] = [("pelvis", None)]
    rows += [(name, parent) for name, parent in zip(spine, ["pelvis", *spine], strict=False)]
    rows += [("neck", chest), ("head", "neck")]
    for side in SIDES:
        for joint in ("hip", "knee", "ankle", "foot", "toe_end", "collar", "shoulder", "elbow", "wrist"):
            parent = CHAINS[joint]
            name = f"{side}_{parent}" if parent not in ("pelvis", "spine3") else parent
            if (joint == "collar" and not build.collars) or (joint in ("foot", "toe_end") and not build.toes):
                continue
            if joint == "shoulder" and not build.collars:
                name = chest
            rows.append((f"{side}_{joint}", chest if name == "spine3" else name))
            if build.twist and joint in ("hip", "shoulder"):
                rows.append((f"{side}_{joint}_twist", f"{side}_{joint}"))
            if build.twist and joint == "hip":
                rows.append((f"{side}_thigh2", f"{side}_hip"))
            if build.fingers and joint == "wrist":
                for finger in range(4):
                    rows += [
                        (f"{side}_finger{finger}", f"{side}_wrist"),
                        (f"{side}_finger{finger}b", f"{side}_finger{finger}"),
                    ]
    if build.twist:
        rows = [(name, f"{name.split('_')[0]}_thigh2" if name.endswith("_knee") else parent) for name, parent in rows]
    gone = set(build.drop)
    for name, parent in rows:
        if parent in gone:
            gone.add(name)
    return [(name, parent) for name, parent in rows if name not in gone]


def all_points(build: Build) -> dict[str, np.ndarray]:
    """Joints at rest, twist joints and fingers too."""
    points = rest_points(build)
    for side in SIDES:
        for joint, child in (("hip", "knee"), ("shoulder", "elbow")):
            middle = (points[f"{side}_{joint}"] + points[f"{side}_{child}"]) / 2
            points[f"{side}_{joint}_twist"] = middle
        points[f"{side}_thigh2"] = points[f"{side}_hip_twist"]
        along = points[f"{side}_wrist"] - points[f"{side}_elbow"]
        along = along / np.linalg.norm(along)
        for finger in range(4):
            base = points[f"{side}_wrist"] + 0.08 * along + np.array([0.0, 0.0, 0.03 * (finger - 1.5)])
            points[f"{side}_finger{finger}"] = base
            points[f"{side}_finger{finger}b"] = base + 0.04 * along
    return points


def random_rotation(rng: np.random.Generator) -> np.ndarray:
    """A rotation matrix (3, 3), from a random quaternion by the textbook formula."""
    w, x, y, z = (value := rng.normal(size=4)) / np.linalg.norm(value)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def quaternion(matrix: np.ndarray) -> list[float]:
    """x, y, z, w of a rotation matrix, by its eigenvector of eigenvalue 1 (independent of the runtime's way)."""
    m = matrix
    k = np.array(
        [
            [m[0, 0] - m[1, 1] - m[2, 2], m[1, 0] + m[0, 1], m[2, 0] + m[0, 2], m[2, 1] - m[1, 2]],
            [m[1, 0] + m[0, 1], m[1, 1] - m[0, 0] - m[2, 2], m[2, 1] + m[1, 2], m[0, 2] - m[2, 0]],
            [m[2, 0] + m[0, 2], m[2, 1] + m[1, 2], m[2, 2] - m[0, 0] - m[1, 1], m[1, 0] - m[0, 1]],
            [m[2, 1] - m[1, 2], m[0, 2] - m[2, 0], m[1, 0] - m[0, 1], m[0, 0] + m[1, 1] + m[2, 2]],
        ]
    )
    values, vectors = np.linalg.eigh(k / 3)
    return [float(value) for value in vectors[:, np.argmax(values)]]


def turn_y(degrees: float) -> np.ndarray:
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    return np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])


def make_character(build: Build, edit: Callable[[dict[str, Any]], None] | None = None) -> bytes:
    """Write a character as GLB.

    Args:
        build: how it is made.
        edit: changes the document before it is written.
    """
    rows, points = hierarchy(build), all_points(build)
    facing = turn_y(build.facing)
    world = {name: facing @ points[name] * build.unit * build.node_scale for name, _ in rows}
    rng = np.random.default_rng(build.roll)
    axes = {name: np.eye(3) if build.roll is None else random_rotation(rng) for name, _ in rows}
    up = np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]]) if build.z_up_node else np.eye(3)
    index = {name: number for number, (name, _) in enumerate(rows)}
    nodes: list[dict[str, Any]] = []
    for name, parent in rows:
        above = axes[parent] if parent else (up if build.above else np.eye(3))
        offset = above.T @ (world[name] - (world[parent] if parent else 0.0))
        if build.above:
            offset = offset / build.node_scale
        node = {
            "name": build.names.get(name, name),
            "translation": [float(value) for value in offset],
            "rotation": quaternion(above.T @ axes[name]),
        }
        if below := [index[child] for child, p in rows if p == name]:
            node["children"] = below
        nodes.append(node)
    roots = [0]
    if build.above:
        scale = [build.node_scale] * 3
        nodes.append({"name": build.above, "children": [0], "rotation": quaternion(up), "scale": scale})
        roots = [len(nodes) - 1]
    nodes.append({"name": "body", "mesh": 0, "skin": 0})
    data, views, accessors = bytearray(), [], []

    def add(array: np.ndarray, kind: str, component: int, **more: Any) -> int:
        nonlocal data
        views.append({"buffer": 0, "byteOffset": len(data), "byteLength": array.nbytes})
        data += array.tobytes() + b"\0" * (-array.nbytes % 4)
        accessors.append(
            {"bufferView": len(views) - 1, "componentType": component, "count": len(array), "type": kind, **more}
        )
        return len(accessors) - 1

    inverse = np.zeros((len(rows), 4, 4), dtype=np.float32)
    for name, number in index.items():
        matrix = np.eye(4)
        matrix[:3, :3] = axes[name] * (build.node_scale if build.above else 1.0)
        matrix[:3, 3] = world[name]
        inverse[number] = np.linalg.inv(matrix).T
    vertices, joints, triangles = boxes(rows, world, build.girth, build.unit * build.node_scale)
    weights = np.tile(np.array([1, 0, 0, 0], dtype=np.float32), (len(vertices), 1))
    bounds = {"min": vertices.min(0).tolist(), "max": vertices.max(0).tolist()}
    attributes = {
        "POSITION": add(vertices, "VEC3", 5126, **bounds),
        "JOINTS_0": add(joints, "VEC4", 5121),
        "WEIGHTS_0": add(weights, "VEC4", 5126),
    }
    indices = add(triangles, "SCALAR", 5123)
    bind = add(inverse, "MAT4", 5126)
    times = add(np.array([[0.0], [1.0]], dtype=np.float32), "SCALAR", 5126, min=[0.0], max=[1.0])
    nod = add(np.array([[0, 0, 0, 1], [0, 0.1, 0, 0.995]], dtype=np.float32), "VEC4", 5126)
    document = {
        "asset": {"version": "2.0", "generator": "tests"},
        "scene": 0,
        "scenes": [{"nodes": [*roots, len(nodes) - 1]}],
        "nodes": nodes,
        "meshes": [{"primitives": [{"attributes": attributes, "indices": indices, "material": 0}]}],
        "materials": [
            {"name": "skin", "pbrMetallicRoughness": {"baseColorFactor": [0.8, 0.5, 0.4, 1.0]}, "extras": {"kept": 7}}
        ],
        "skins": [{"joints": list(range(len(rows))), "inverseBindMatrices": bind}],
        "animations": [
            {
                "name": "nod",
                "samplers": [{"input": times, "output": nod}],
                "channels": [
                    {"sampler": 0, "target": {"node": min(index.get("head", 0), len(rows) - 1), "path": "rotation"}}
                ],
            }
        ],
        "accessors": accessors,
        "bufferViews": views,
        "buffers": [{"byteLength": len(data)}],
        **build.extra,
    }
    if edit:
        edit(document)
    return glb(document, bytes(data))


def glb(document: dict[str, Any], binary: bytes) -> bytes:
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    chunks = struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(binary), b"BIN\0") + binary
    return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks


def unpacked(data: bytes) -> tuple[dict[str, Any], bytes]:
    size = struct.unpack_from("<I", data, 12)[0]
    return json.loads(data[20 : 20 + size]), data[28 + size :]


def boxes(
    rows: list[tuple[str, str | None]], world: dict[str, np.ndarray], girth: float, unit: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A box for every bone, bound to its upper joint; the foot's reaches down to the floor."""
    corners = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], dtype=float)
    faces = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    vertices, joints, triangles = [], [], []
    names = [name for name, _ in rows]
    for name, parent in rows:
        if parent is None:
            continue
        start, end = world[parent], world[name]
        radius = (0.1 * girth if parent.startswith(("pelvis", "spine")) and "_" not in name else 0.04) * unit
        radius *= girth if parent.endswith("_hip") else 1.0
        low, high = np.minimum(start, end) - radius, np.maximum(start, end) + radius
        if parent.endswith(("_ankle", "_foot")):
            low[1], high[1] = 0.0, max(start[1], end[1]) + 0.01 * unit
        box = (low + high) / 2 + corners * (high - low) / 2
        first = sum(map(len, vertices))
        vertices.append(box)
        joints += [[names.index(parent), 0, 0, 0]] * 8
        for a, b, c, d in faces:
            triangles += [first + a, first + b, first + c, first + a, first + c, first + d]
    return (
        np.concatenate(vertices).astype(np.float32),
        np.array(joints, dtype=np.uint8),
        np.array(triangles, dtype=np.uint16)[:, None],
    )


def vrm(build: Build, version: int) -> dict[str, Any]:
    """The humanoid extension of VRM 0 or 1 for `Build.extra`; unnamed joints show that names are not read."""
    bones = {
        "pelvis": "hips", "spine1": "spine", "spine2": "chest", "spine3": "upperChest", "neck": "neck", "head": "head",
    } | {
        f"{side}_{joint}": side + bone
        for side in SIDES
        for joint, bone in zip(
            LIMBS, ("UpperLeg", "LowerLeg", "Foot", "Toes", "Shoulder", "UpperArm", "LowerArm", "Hand"), strict=True
        )
    }  # fmt: skip
    index = {bones[name]: number for number, (name, _) in enumerate(hierarchy(build)) if name in bones}
    if version == 0:
        humanoid = {"humanBones": [{"bone": bone, "node": node} for bone, node in index.items()]}
        return {"extensionsUsed": ["VRM"], "extensions": {"VRM": {"humanoid": humanoid, "exporterVersion": "kept"}}}
    humanoid = {"humanBones": {bone: {"node": node} for bone, node in index.items()}}
    return {"extensionsUsed": ["VRMC_vrm"], "extensions": {"VRMC_vrm": {"specVersion": "1.0", "humanoid": humanoid}}}


BUILDS: dict[str, Build] = {
    "Mixamo, T-pose, centimetres": Build(MIXAMO, unit=100.0, node_scale=0.01, fingers=True, roll=1),
    "Unreal, A-pose, Z up, twist": Build(UNREAL, arms_down=50.0, roll=2, twist=True, z_up_node=True, above="root"),
    "Unity, wide and short": Build(UNITY, roll=3, legs=0.7, torso=1.2, hips=1.6, shoulders=1.4, arms=0.9),
    "VRoid by its VRM 0, facing back": Build(
        NAMELESS, facing=180.0, fingers=True, extra=vrm(Build(NAMELESS, fingers=True), 0)
    ),
    "VRM 1, long legs": Build(VROID, legs=1.3, extra=vrm(Build(VROID), 1), above=None),
    "Rigify, A-pose": Build(RIGIFY, arms_down=35.0, roll=6, foot_length=0.12),
    "Character Creator, 100 times": Build(CREATOR, unit=100.0, roll=7, twist=True, fingers=True, arms_down=40.0),
    "SOMA, a hundredth": Build(SOMA, unit=0.01, roll=8, thigh_share=0.54),
    "MakeHuman, five vertebrae": Build(MAKEHUMAN, spine_joints=5, roll=9, ankle_height=0.11, arms_down=45.0),
    "Biped, no toes, no collars": Build(BIPED, roll=10, toes=False, collars=False, facing=90.0),
    "nameless, by its shape": Build(NAMELESS, roll=11, arms_down=45.0, fingers=True, twist=True),
}
"""Ten rigs that people use, and one that nobody knows."""
