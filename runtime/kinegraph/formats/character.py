"""A user's character: a `.glb`, `.gltf` or `.vrm` file with a skinned human, and a clip added as an animation.

The file keeps all that it has. Its JSON is not interpreted beyond nodes, skins and vertices, which tell where the floor
is and how stout the body; chunks, key order and unknown extensions stay. (pygltflib, tried first, rewrites buffers,
drops keys it does not know, and takes 0.6 s for 400 nodes and 800 accessors; it reads our files in the tests.)
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np

from kinegraph.arrays import Floats
from kinegraph.errors import InvalidInputError
from kinegraph.files import check_target, write_atomically
from kinegraph.formats.bind_pose import in_bind_pose
from kinegraph.formats.bvh_skeleton import BvhSkeleton, read_skeleton
from kinegraph.formats.bvh_skeleton import encode as encode_bvh
from kinegraph.formats.character_files import MAX_BYTES, embed, read_bytes, refuse_compressed
from kinegraph.formats.glb import provenance
from kinegraph.formats.gltf import (
    Buffer,
    Document,
    DocumentText,
    add_animation,
    container,
    parse_document,
    split_container,
)
from kinegraph.formats.gltf_rig import read_rig, vrm_bones, with_parts
from kinegraph.formats.gltf_skin import find_floor, spread_points
from kinegraph.motion.body_shape import BodyShape
from kinegraph.motion.humanoid import SIDES, Humanoid, find_humanoid
from kinegraph.motion.kinematics import rotations_from_positions
from kinegraph.motion.resampling import resample_motion
from kinegraph.motion.retargeting import RigMotion, measure_shape, retarget
from kinegraph.motion.rig import Rig
from kinegraph.motion.skeleton import DEFAULT_NAMES, ROOT_NAME
from kinegraph.validation import check_fps

if TYPE_CHECKING:
    from kinegraph.clip import Clip

READ_SUFFIXES: Final = (".bvh", ".glb", ".gltf", ".vrm")
DEFAULT_FPS: Final = 30.0
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
    shape: BodyShape | None = None
    """How stout it is; arms are kept out of that. None for a BVH skeleton, and where the skin says too little."""
    skeleton: BvhSkeleton | None = None
    """Of a `.bvh` file."""

    @property
    def pelvis(self) -> int:
        """Node of the pelvis."""
        return self.humanoid.bones["pelvis"]

    @cached_property
    def text(self) -> DocumentText:
        """JSON of the document."""
        return DocumentText(self.document)

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


def check_no_names(names: str) -> None:
    """Refuse a naming of our own joints for a clip on a character, which keeps the names of its file.

    Raises:
        InvalidInputError: other names than the default.
    """
    if names != DEFAULT_NAMES:
        raise InvalidInputError("names are for our own body, and a character keeps its own; leave out names")


def read_character(path: str | os.PathLike[str], names: Mapping[str, str] | None = None) -> Character:
    """Read a character.

    Args:
        path: `.glb`, `.gltf` or `.vrm` file with one skinned human, or a `.bvh` skeleton.
        names: joint of `JOINT_NAMES` -> name of a node, for what is not found by itself.

    Raises:
        InvalidInputError: no such file, no binary glTF, no skin, two skeletons, not a human (missing limbs are named),
            compressed, damaged, or files outside its folder are referred to.
    """
    file = Path(path)
    try:
        data = read_bytes(file, MAX_BYTES, READ_SUFFIXES)
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
        plain = Path(name).suffix.lower() == ".gltf"
        document, binary = embed(*((parse_document(data), b"") if plain else split_container(data)), folder)
        refuse_compressed(document)
        document, rig = in_bind_pose(document, binary, read_rig(document))
        humanoid = find_humanoid(rig, vrm=vrm_bones(document), names=names)
        floor = find_floor(document, binary, rig, humanoid)
        shape = measure_shape(rig, humanoid, floor, *spread_points(document, binary, rig))
    except InvalidInputError as error:
        raise InvalidInputError(f"{name!r} cannot be used as a character: {error}") from error
    except _MALFORMED as error:
        raise InvalidInputError(
            f"{name!r} cannot be used as a character: it is damaged ({repr(error)[:200]})"
        ) from error
    return Character(name, rig, humanoid, floor, document, binary, shape)


def _check_standing(positions: Floats, humanoid: Humanoid) -> None:
    """Refuse offsets (nodes, 3) that are no pose, as where every bone lies along one axis of its parent.

    Raises:
        InvalidInputError: head and feet are on one side of the hips.
    """
    hips, ankles = (
        np.mean([positions[humanoid.bones[f"{side}_{name}"]] for side in SIDES], axis=0) for name in ("hip", "ankle")
    )
    if (positions[humanoid.bones["head"]] - hips) @ (ankles - hips) >= 0:
        raise InvalidInputError(
            "its OFFSETs are no standing pose, as head and feet are on one side of the hips; export the skeleton in a "
            "T-pose"
        )


def _decode_bvh(data: bytes, name: str, names: Mapping[str, str] | None) -> Character:
    skeleton = read_skeleton(data)
    humanoid = find_humanoid(skeleton.rig, names=names)
    _check_standing(skeleton.rig.positions, humanoid)
    ankles = {humanoid.bones[f"{side}_ankle"] for side in SIDES}
    feet = [node for node in skeleton.rig.joints if ankles & set(skeleton.rig.ancestors(node))]
    floor = float(skeleton.rig.positions[feet, 1].min())
    return Character(name, skeleton.rig, humanoid, floor, {}, b"", skeleton=skeleton)


def _encode_bvh(shown: CharacterClip, skeleton: BvhSkeleton) -> bytes:
    root = _root_node(shown.character) if shown.root else None
    if root is not None and not (root >= 0 and skeleton.moves(root) and skeleton.moves(shown.character.pelvis)):
        raise InvalidInputError("root motion needs a joint above the pelvis; both must have position channels")
    return encode_bvh(skeleton, _retargeted(shown, skeleton.rig, root), shown.fps)


def _root_node(character: Character) -> int:
    """Find the joint above the pelvis that can carry travel; -1 where there is none."""
    return character.rig.parents[character.pelvis]


def _retargeted(shown: CharacterClip, rig: Rig, root: int | None) -> RigMotion:
    clip = shown.clip
    motion = rotations_from_positions(clip.joints, clip.fps, loops=clip.loops)
    if shown.fps != clip.fps:
        motion = resample_motion(motion, clip.fps, shown.fps, loops=clip.loops)
    character = shown.character
    return retarget(rig, character.humanoid, character.floor, motion, shown.fps, root, character.shape)


def _encode(shown: CharacterClip) -> bytes:
    """Add the animation to the file; what does not change is neither copied nor encoded again."""
    character, changed, root = shown.character, Document(), None
    document, rig = character.document, character.rig
    nodes = list(document["nodes"])
    if shown.root:
        root = _root_node(character)
        if root < 0:
            root, rig = len(nodes), _with_root(rig, character.pelvis)
            nodes.append({"name": ROOT_NAME, "children": [character.pelvis]})
            changed["scenes"] = [_with_root_in(scene, character.pelvis, root) for scene in document.get("scenes", ())]
    motion = _retargeted(shown, rig, root)
    for node in {*motion.rotations, *motion.translations}:
        nodes[node] = with_parts(nodes[node], rig, node)
    if nodes != document["nodes"]:
        changed["nodes"] = nodes
    views, accessors = document.get("bufferViews", ()), document.get("accessors", ())
    buffer = Buffer(character.binary, views, accessors)
    appended = {
        "animations": [_animation(buffer, shown, motion, document.get("animations", []))],
        "accessors": buffer.accessors[len(accessors) :],
        "bufferViews": buffer.views[len(views) :],
    }
    changed["buffers"] = [{**(document.get("buffers") or [{}])[0], "byteLength": buffer.size}]
    return container(character.text.changed(changed, appended), buffer)


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
