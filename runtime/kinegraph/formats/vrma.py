"""`.vrma`: a clip as a VRM animation, which plays on any VRM character (VRM Consortium, VRMC_vrm_animation 1.0).

A glTF 2.0 file with nodes, one animation, and an extension that says which node is which bone of VRM's humanoid.
Programs play each rotation relative to the rest pose, so that of the file must be what VRM characters rest in: a T-pose
with flat feet, level gaze and relaxed shoulders. The clip is retargeted to such a body.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from kinegraph.arrays import Floats
from kinegraph.formats.glb import GENERATOR, provenance
from kinegraph.formats.gltf import Buffer, add_animation, container
from kinegraph.motion.humanoid import VRM_BONES, Humanoid
from kinegraph.motion.kinematics import CHILDREN, rest_pose, rotations_from_positions
from kinegraph.motion.quaternions import IDENTITY, normalised
from kinegraph.motion.retargeting import FLAT_FOOT, UPRIGHT_NECK, retarget
from kinegraph.motion.rig import Rig
from kinegraph.motion.skeleton import JOINT_INDEX, JOINT_NAMES, JOINTS, PARENTS

if TYPE_CHECKING:
    from kinegraph.clip import Clip

RELAXED: Final[dict[str, Floats]] = {
    "head": UPRIGHT_NECK,
    "left_foot": FLAT_FOOT,
    "right_foot": FLAT_FOOT,
    "left_shoulder": normalised(np.array([0.95, 0.0, -0.31])),
    "right_shoulder": normalised(np.array([-0.95, 0.0, -0.31])),
}
"""Joint -> direction from its parent while a person stands at ease (mean of recorded clips), where not our T-pose's."""


def encode(clip: Clip) -> bytes:
    """Encode a clip as a VRM animation."""
    motion = rotations_from_positions(clip.joints, clip.fps, loops=clip.loops)
    rig, humanoid = _body(motion.rest_offsets)
    moving = retarget(rig, humanoid, 0.0, motion, clip.fps)
    buffer = Buffer()
    bones = {VRM_BONES[name]: {"node": joint} for joint, name in enumerate(JOINT_NAMES)}
    animation = add_animation(buffer, clip.text[:64] or "clip", clip.fps, moving.translations, moving.rotations)
    document = {
        "asset": {"version": "2.0", "generator": GENERATOR, "extras": provenance(clip)},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [
            {
                "name": name,
                "translation": rig.translations[joint].tolist(),
                **({"children": list(CHILDREN[joint])} if CHILDREN[joint] else {}),
            }
            for joint, name in enumerate(rig.names)
        ],
        "animations": [animation],
        "accessors": buffer.accessors,
        "bufferViews": buffer.views,
        "buffers": [{"byteLength": buffer.size}],
        "extensionsUsed": ["VRMC_vrm_animation"],
        "extensions": {"VRMC_vrm_animation": {"specVersion": "1.0", "humanoid": {"humanBones": bones}}},
    }
    return container(document, buffer)


def _body(offsets: Floats) -> tuple[Rig, Humanoid]:
    """Build the resting body: the clip's bone lengths, node numbers those of our joints."""
    offsets = offsets.copy()
    for name, direction in RELAXED.items():
        joint = JOINT_INDEX[name]
        offsets[joint] = direction * np.linalg.norm(offsets[joint])
    offsets[0] = rest_pose(offsets)[0]
    names = tuple(VRM_BONES[name] for name in JOINT_NAMES)
    still = np.tile(np.array(IDENTITY), (JOINTS, 1))
    rig = Rig(names, PARENTS, offsets, still, np.ones((JOINTS, 3)), (frozenset(range(JOINTS)),))
    spine = tuple(JOINT_INDEX[name] for name in ("spine1", "spine2", "spine3"))
    return rig, Humanoid({name: joint for name, joint in JOINT_INDEX.items() if joint not in spine}, spine, "VRM")
