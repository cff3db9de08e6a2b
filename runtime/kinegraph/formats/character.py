"""A user's character: a `.glb` or `.vrm` file with a skinned human, and a clip added to it as an animation.

The file keeps all that it has. Its JSON is not interpreted beyond nodes, skins and the vertices of the feet, which tell
where the floor is; chunks, key order and unknown extensions stay. (pygltflib, tried first, rewrites buffers, drops keys
it does not know, and takes 0.6 s for 400 nodes and 800 accessors; it reads our files in the tests.)
"""

from __future__ import annotations

import base64
import binascii
import json
import os
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final
from urllib.parse import unquote

import numpy as np
from numpy.typing import NDArray

from kinegraph.arrays import Floats
from kinegraph.errors import InvalidInputError
from kinegraph.files import check_target, write_atomically
from kinegraph.formats.bvh_skeleton import BvhSkeleton, read_skeleton
from kinegraph.formats.bvh_skeleton import encode as encode_bvh
from kinegraph.formats.glb import provenance
from kinegraph.formats.gltf import Buffer, Document, add_animation, container, item, read_array, split_container
from kinegraph.motion.humanoid import SIDES, Humanoid, find_humanoid
from kinegraph.motion.kinematics import rotations_from_positions
from kinegraph.motion.quaternions import from_matrix, normalised
from kinegraph.motion.resampling import resample_motion
from kinegraph.motion.retargeting import RigMotion, retarget
from kinegraph.motion.rig import Rig
from kinegraph.motion.skeleton import ROOT_NAME
from kinegraph.validation import check_fps

if TYPE_CHECKING:
    from kinegraph.clip import Clip

READ_SUFFIXES: Final = (".bvh", ".glb", ".vrm")
DEFAULT_FPS: Final = 30.0
MAX_BYTES: Final = 1 << 28
"""Size of a character that is read."""
MAX_NODES: Final = 10_000
_MAX_MAP_BYTES: Final = 1 << 16
_COMPRESSED: Final = ("KHR_draco_mesh_compression", "EXT_meshopt_compression", "KHR_meshopt_compression")
_MALFORMED: Final = (KeyError, IndexError, TypeError, ValueError, AttributeError, OverflowError)


@dataclass(frozen=True, eq=False)
class Character:
    """A skinned human of a file; read once, it takes any number of clips."""

    name: str
    """Name of the file, for messages."""
    rig: Rig
    humanoid: Humanoid
    """Which of its nodes follow our joints."""
    floor: float
    """Height of the soles at rest, in the units of the file."""
    document: Document
    """JSON of the file; never changed. Empty for a BVH skeleton."""
    binary: bytes
    skeleton: BvhSkeleton | None = None
    """Of a `.bvh` file."""

    @property
    def pelvis(self) -> int:
        """Node of the pelvis."""
        return self.humanoid.bones["pelvis"]

    @property
    def suffix(self) -> str:
        """Format that a clip on it is saved in."""
        return ".glb" if self.skeleton is None else ".bvh"


@dataclass(frozen=True, eq=False)
class CharacterClip:
    """A clip on a character; made by `Clip.onto`."""

    clip: Clip
    character: Character
    fps: float
    """Keys per second."""
    root: bool
    """Whether the joint above the pelvis carries travel and heading."""

    @property
    def frames(self) -> int:
        """Number of keys of every track."""
        return len(self.motion().rotations[self.character.pelvis])

    def motion(self) -> RigMotion:
        """Compute the tracks of the character's nodes."""
        return _retargeted(self, self.character.rig, _root_node(self.character) if self.root else None)

    def encode(self) -> bytes:
        """Encode the character's file with the clip; equal clips give equal bytes.

        A `.glb` has it as one more animation, a `.bvh` as its motion.

        Raises:
            InvalidInputError: the character's legs have no length, or a BVH joint lacks channels.
        """
        return _encode(self) if self.character.skeleton is None else _encode_bvh(self, self.character.skeleton)

    def save(self, path: str | os.PathLike[str], *, force: bool = False) -> None:
        """Write a `.glb` file, or a `.bvh` for a BVH skeleton; it appears complete or not at all.

        Raises:
            InvalidInputError: the character's legs have no length.
            OutputError: the file cannot be written there; see `files.check_target`.
        """
        check_target(path, force, (self.character.suffix,))
        write_atomically(path, self.encode(), force=force)


def read_character(path: str | os.PathLike[str], names: Mapping[str, str] | None = None) -> Character:
    """Read a character.

    Args:
        path: `.glb` or `.vrm` file with one skinned human, or a `.bvh` skeleton.
        names: joint of `JOINT_NAMES` -> name of a node, for what is not found by itself.

    Raises:
        InvalidInputError: no such file, no binary glTF, no skin, two skeletons, not a human (missing limbs are named),
            compressed, damaged, or files outside its folder are referred to.
    """
    file = Path(path)
    try:
        data = _read_bytes(file, MAX_BYTES, READ_SUFFIXES)
    except InvalidInputError as error:
        raise InvalidInputError(f"{str(path)!r} cannot be used as a character: {error}") from error
    return decode_character(data, str(path), names, file.parent)


def decode_character(
    data: bytes, name: str, names: Mapping[str, str] | None = None, folder: Path | None = None
) -> Character:
    """Decode the bytes of a character's file.

    Args:
        data: content of the file.
        name: of the file, whose suffix tells the format.
        names: as in `read_character`.
        folder: where files that it refers to lie; None refuses them.

    Raises:
        InvalidInputError: as in `read_character`.
    """
    try:
        if Path(name).suffix.lower() == ".bvh":
            return _decode_bvh(data, name, names)
        document, binary = _embed(*split_container(data), folder)
        _refuse_compressed(document)
        rig = _read_rig(document)
        humanoid = find_humanoid(rig, vrm=_vrm_bones(document), names=names)
        floor = _floor(document, binary, rig, humanoid)
    except InvalidInputError as error:
        raise InvalidInputError(f"{name!r} cannot be used as a character: {error}") from error
    except _MALFORMED as error:
        raise InvalidInputError(
            f"{name!r} cannot be used as a character: it is damaged ({repr(error)[:200]})"
        ) from error
    return Character(name, rig, humanoid, floor, document, binary)


def _decode_bvh(data: bytes, name: str, names: Mapping[str, str] | None) -> Character:
    skeleton = read_skeleton(data)
    humanoid = find_humanoid(skeleton.rig, names=names)
    ankles = {humanoid.bones[f"{side}_ankle"] for side in SIDES}
    feet = [node for node in skeleton.rig.joints if ankles & set(skeleton.rig.ancestors(node))]
    floor = float(skeleton.rig.positions[feet, 1].min())
    return Character(name, skeleton.rig, humanoid, floor, {}, b"", skeleton)


def _encode_bvh(shown: CharacterClip, skeleton: BvhSkeleton) -> bytes:
    root = _root_node(shown.character) if shown.root else None
    if root is not None and not (root >= 0 and skeleton.moves(root) and skeleton.moves(shown.character.pelvis)):
        raise InvalidInputError("root motion needs a joint above the pelvis; both must have position channels")
    return encode_bvh(skeleton, _retargeted(shown, skeleton.rig, root), shown.fps)


def read_names(path: str | os.PathLike[str]) -> dict[str, str]:
    """Read a map of joints: a JSON object {"left_hip": "name of a node", ...}.

    Raises:
        InvalidInputError: no such file, or no such object.
    """
    data = _read_bytes(Path(path), _MAX_MAP_BYTES, (".json",))
    try:
        names = json.loads(data)
    except (ValueError, RecursionError) as error:
        raise InvalidInputError(f"{str(path)!r} is no JSON ({str(error)[:200]})") from error
    if not isinstance(names, dict) or not all(isinstance(name, str) for name in names.values()):
        raise InvalidInputError(f'{str(path)!r} must hold an object like {{"left_hip": "name of a joint"}}')
    return names


def _read_bytes(path: Path, most: int, suffixes: tuple[str, ...]) -> bytes:
    name = repr(str(path))
    if path.suffix.lower() not in suffixes:
        raise InvalidInputError(f"{name} has the wrong suffix; it must be {' or '.join(suffixes)}")
    try:
        if not path.is_file():
            raise InvalidInputError(f"there is no file {name}")
        if path.stat().st_size > most:
            raise InvalidInputError(f"{name} is larger than {most >> 20} MiB; make its textures smaller")
        return path.read_bytes()
    except (OSError, ValueError) as error:
        if isinstance(error, InvalidInputError):
            raise
        raise InvalidInputError(f"{name} cannot be read ({error}); check the name and its permissions") from error


def _refuse_compressed(document: Document) -> None:
    used = {*document.get("extensionsUsed", ()), *document.get("extensionsRequired", ())}
    if found := [extension for extension in _COMPRESSED if extension in used]:
        raise InvalidInputError(
            f"it is compressed ({', '.join(found)}); decompress it first: "
            "npx @gltf-transform/cli copy hero.glb plain.glb"
        )


def _embed(document: Document, binary: bytes, folder: Path | None) -> tuple[Document, bytes]:
    """Bring buffers and images that are files of their own into the binary chunk.

    Raises:
        InvalidInputError: a file is outside the folder, missing, or too large; or there is no folder.
    """
    buffers = document.get("buffers", [])
    images = document.get("images", [])
    if not any("uri" in entry for entry in (*buffers, *images)) and len(buffers) <= 1:
        length = buffers[0]["byteLength"] if buffers else 0
        if not isinstance(length, int) or not 0 <= length <= len(binary):
            raise InvalidInputError("its binary chunk is shorter than it says")
        return document, binary[:length]
    data, starts = bytearray(), []
    for index, entry in enumerate(buffers):
        part = _fetch(entry["uri"], folder) if "uri" in entry else binary if index == 0 else b""
        if not isinstance(entry["byteLength"], int) or not 0 <= entry["byteLength"] <= len(part):
            raise InvalidInputError(f"buffer {index} is shorter than it says")
        data += b"\0" * (-len(data) % 4)
        starts.append(len(data))
        data += part[: entry["byteLength"]]
    views = [
        {**view, "buffer": 0, "byteOffset": starts[view["buffer"]] + view.get("byteOffset", 0)}
        for view in document.get("bufferViews", [])
    ]
    embedded = []
    for image in images:
        if "uri" in image:
            part = _fetch(image["uri"], folder)
            data += b"\0" * (-len(data) % 4)
            views.append({"buffer": 0, "byteOffset": len(data), "byteLength": len(part)})
            data += part
            kind = "image/png" if part.startswith(b"\x89PNG") else "image/jpeg"
            image = {key: value for key, value in image.items() if key != "uri"}
            image |= {"bufferView": len(views) - 1, "mimeType": kind}
        embedded.append(image)
    document = {**document, "buffers": [{"byteLength": len(data)}], "bufferViews": views}
    return (document | {"images": embedded} if images else document), bytes(data)


def _fetch(uri: object, folder: Path | None) -> bytes:
    """Read a data URI, or a file in the folder or below."""
    if not isinstance(uri, str):
        raise InvalidInputError("it refers to a file by something that is no text")
    if uri.startswith("data:"):
        try:
            return base64.b64decode(uri.partition(",")[2], validate=True)
        except binascii.Error as error:
            raise InvalidInputError("it has a data URI that is damaged") from error
    if folder is None:
        raise InvalidInputError(f"it refers to the file {uri[:80]!r}; pack it all as one .glb")
    root = folder.resolve()
    target = root.joinpath(unquote(uri))
    if ":" in uri or "\\" in uri or "\0" in unquote(uri) or not target.resolve().is_relative_to(root):
        raise InvalidInputError(f"it refers to {uri[:80]!r}, which is not in its folder; pack the file as one .glb")
    return _read_bytes(target, MAX_BYTES, (target.suffix.lower(),))


def _read_rig(document: Document) -> Rig:
    """Read nodes and skins.

    Raises:
        InvalidInputError: no skin, too many nodes, or a node with two parents.
    """
    nodes = document.get("nodes", [])
    skins = document.get("skins", [])
    if not skins:
        raise InvalidInputError("it has no skin; a character is a mesh that is bound to a skeleton")
    if len(nodes) > MAX_NODES:
        raise InvalidInputError(f"it has {len(nodes)} nodes; at most {MAX_NODES} are read")
    parents = [-1] * len(nodes)
    for index, node in enumerate(nodes):
        for child in node.get("children", ()):
            item(document, "nodes", child)
            if parents[child] >= 0:
                raise InvalidInputError(f"node {child} is below two others")
            parents[child] = index
    transforms = [_transform(node) for node in nodes]
    for skin in skins:
        for joint in skin["joints"]:
            item(document, "nodes", joint)
    return Rig(
        names=tuple(str(node.get("name", f"node {index}")) for index, node in enumerate(nodes)),
        parents=tuple(parents),
        translations=np.array([translation for translation, _, _ in transforms]),
        rotations=np.array([rotation for _, rotation, _ in transforms]),
        scales=np.array([scale for _, _, scale in transforms]),
        skins=tuple(frozenset(skin["joints"]) for skin in skins),
    )


def _transform(node: Document) -> tuple[Floats, Floats, Floats]:
    """Read translation, rotation (w, x, y, z) and scale of a node; a matrix is taken apart.

    Raises:
        InvalidInputError: other than finite numbers.
    """
    if "matrix" in node:
        matrix = np.array(node["matrix"], dtype=np.float64).reshape(4, 4).T
        if not np.isfinite(matrix).all():
            raise InvalidInputError("a node's matrix is not finite")
        scale = np.linalg.norm(matrix[:3, :3], axis=0)
        scale[0] *= -1.0 if np.linalg.det(matrix[:3, :3]) < 0 else 1.0
        turn = matrix[:3, :3] / np.where(scale == 0, 1.0, scale)
        return matrix[:3, 3], from_matrix(turn), scale
    values = [node.get("translation", (0, 0, 0)), node.get("rotation", (0, 0, 0, 1)), node.get("scale", (1, 1, 1))]
    translation, rotation, scale = (np.array(value, dtype=np.float64) for value in values)
    if (len(translation), len(rotation), len(scale)) != (3, 4, 3):
        raise InvalidInputError("a node's transform has the wrong length")
    if not np.isfinite(np.concatenate([translation, rotation, scale])).all() or not rotation.any():
        raise InvalidInputError("a node's transform is not finite, or its rotation is zero")
    return translation, normalised(rotation[[3, 0, 1, 2]]), scale


def _vrm_bones(document: Document) -> dict[str, int] | None:
    """Read the humanoid of a VRM file, version 0 or 1: bone -> node; None where there is none."""
    extensions = document.get("extensions", {})
    if "VRMC_vrm" in extensions:
        bones = {bone: entry["node"] for bone, entry in extensions["VRMC_vrm"]["humanoid"]["humanBones"].items()}
    elif "VRM" in extensions:
        bones = {entry["bone"]: entry["node"] for entry in extensions["VRM"]["humanoid"]["humanBones"]}
    else:
        return None
    for node in bones.values():
        item(document, "nodes", node)
    return bones


def _floor(document: Document, binary: bytes, rig: Rig, humanoid: Humanoid) -> float:
    """Find the height of the soles at rest: the lowest vertex of the feet, or else by the joints."""
    feet = {
        humanoid.bones[f"{side}_{joint}"]
        for side in SIDES
        for joint in ("ankle", "foot")
        if f"{side}_{joint}" in humanoid.bones
    }
    low = float(rig.positions[list(feet), 1].min())
    knee = float(np.mean([rig.positions[humanoid.bones[f"{side}_knee"], 1] for side in SIDES]))
    heights = [
        low_vertex for low_vertex in _foot_vertices(document, binary, rig, feet) if low - (knee - low) < low_vertex
    ]
    if heights:
        return min(heights)
    return 0.0 if 0.0 <= low < 0.3 * (knee - low) else low


def _foot_vertices(document: Document, binary: bytes, rig: Rig, feet: set[int]) -> Iterator[float]:
    """Yield the height of the lowest vertex of the feet in each mesh; meshes that are not read are left out."""
    for node in document["nodes"]:
        if "skin" not in node or "mesh" not in node:
            continue
        skin = item(document, "skins", node["skin"])
        below = np.array([any(above in feet for above in rig.ancestors(joint)) for joint in skin["joints"]])
        bind = np.tile(np.eye(4), (len(below), 1, 1))
        if "inverseBindMatrices" in skin:
            bind = read_array(document, binary, skin["inverseBindMatrices"]).reshape(-1, 4, 4).transpose(0, 2, 1)
        matrices = rig.world[list(skin["joints"])] @ bind[: len(below)]
        for primitive in item(document, "meshes", node["mesh"])["primitives"]:
            attributes = primitive["attributes"]
            if not {"POSITION", "JOINTS_0", "WEIGHTS_0"} <= attributes.keys():
                continue
            try:
                arrays = [
                    read_array(document, binary, attributes[name]) for name in ("POSITION", "JOINTS_0", "WEIGHTS_0")
                ]
            except InvalidInputError:
                continue  # sparse, or in another buffer: the joints say enough
            yield from _lowest(arrays[0], arrays[1].astype(np.int64), arrays[2], matrices, below)


def _lowest(
    positions: NDArray[Any],
    joints: NDArray[np.int64],
    weights: NDArray[Any],
    matrices: Floats,
    below: NDArray[np.bool_],
) -> Iterator[float]:
    """Yield the lowest skinned vertex among those that hang on the feet for the most part."""
    share = (weights * below[joints]).sum(axis=-1)
    chosen = share > 0.5 * weights.sum(axis=-1)
    if chosen.any():
        points = np.column_stack([positions[chosen], np.ones(int(chosen.sum()))])
        heights = np.einsum("nk,nki,ni->n", weights[chosen], matrices[joints[chosen], 1], points)
        yield float((heights / weights[chosen].sum(axis=-1)).min())


def _root_node(character: Character) -> int:
    """Find the joint above the pelvis that can carry travel; -1 where there is none."""
    return character.rig.parents[character.pelvis]


def _retargeted(shown: CharacterClip, rig: Rig, root: int | None) -> RigMotion:
    clip = shown.clip
    motion = rotations_from_positions(clip.joints, clip.fps, loops=clip.loops)
    if shown.fps != clip.fps:
        motion = resample_motion(motion, clip.fps, shown.fps, loops=clip.loops)
    return retarget(rig, shown.character.humanoid, shown.character.floor, motion, shown.fps, root)


def _encode(shown: CharacterClip) -> bytes:
    """Add the animation to a copy of the document, which shares all that does not change."""
    document, character = dict(shown.character.document), shown.character
    nodes, rig, root = list(document["nodes"]), character.rig, None
    if shown.root:
        root = _root_node(character)
        if root < 0:
            root, rig = len(nodes), _with_root(rig, character.pelvis)
            nodes.append({"name": ROOT_NAME, "children": [character.pelvis]})
            document["scenes"] = [
                _with_root_in(scene, nodes[-1]["children"][0], root) for scene in document.get("scenes", ())
            ]
    motion = _retargeted(shown, rig, root)
    for node in {*motion.rotations, *motion.translations}:
        nodes[node] = _with_parts(nodes[node], rig, node)
    buffer = Buffer(character.binary, document.get("bufferViews", ()), document.get("accessors", ()))
    animation = _animation(buffer, shown, motion, document.get("animations", []))
    document |= {
        "nodes": nodes,
        "animations": [*document.get("animations", []), animation],
        "accessors": buffer.accessors,
        "bufferViews": buffer.views,
        "buffers": [{**(document.get("buffers") or [{}])[0], "byteLength": len(buffer.data)}],
    }
    return container(document, bytes(buffer.data))


def _with_root(rig: Rig, pelvis: int) -> Rig:
    """Add a node at the origin above the pelvis, the last of the rig."""
    parents = list(rig.parents)
    parents[pelvis] = len(parents)
    return Rig(
        (*rig.names, ROOT_NAME),
        (*parents, -1),
        np.concatenate([rig.translations, np.zeros((1, 3))]),
        np.concatenate([rig.rotations, [[1.0, 0.0, 0.0, 0.0]]]),
        np.concatenate([rig.scales, np.ones((1, 3))]),
        rig.skins,
    )


def _with_root_in(scene: Document, pelvis: int, root: int) -> Document:
    return {**scene, "nodes": [root if node == pelvis else node for node in scene.get("nodes", ())]}


def _with_parts(node: Document, rig: Rig, index: int) -> Document:
    """Write a node's matrix as translation, rotation and scale, as animated nodes must have them."""
    if "matrix" not in node:
        return node
    w, x, y, z = rig.rotations[index].tolist()
    plain = {key: value for key, value in node.items() if key != "matrix"}
    parts = {"translation": rig.translations[index].tolist(), "rotation": [x, y, z, w]}
    return plain | parts | {"scale": rig.scales[index].tolist()}


def _animation(buffer: Buffer, shown: CharacterClip, motion: RigMotion, others: list[Document]) -> Document:
    """Store the tracks; the name is the caption, with a number where that is taken."""
    clip = shown.clip
    taken = {other.get("name") for other in others}
    name = caption = clip.text[:64] or "clip"
    number = 1
    while name in taken:
        number += 1
        name = f"{caption} ({number})"
    animation = add_animation(buffer, name, shown.fps, motion.translations, motion.rotations)
    return {**animation, "extras": {"kinegraph": {**provenance(clip), "fps": shown.fps}}}


def onto(clip: Clip, character: Character, fps: float = DEFAULT_FPS, root: bool = False) -> CharacterClip:
    """Put a clip on a character; `Clip.onto` documents it.

    Raises:
        InvalidInputError: not a frame rate.
    """
    check_fps(fps)
    return CharacterClip(clip, character, float(fps), root)
