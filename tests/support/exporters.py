"""One known motion, written as BVH in the forms of many programs: names, hierarchy, units, axes, orders, rest poses.

`true_joints` gives the motion itself, from matrices of the tests' own: a body walks along a curve and waves its left
hand, so that facing, left and right and travel all show. The torso is rigid: skeletons with other spines show the same.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from kinegraph.motion.skeleton import JOINT_INDEX, JOINT_NAMES, PARENTS
from support.bvh_files import OFFSETS, turn

METRES = OFFSETS / 100
LIMBS = ("hip", "knee", "ankle", "foot", "collar", "shoulder", "elbow", "wrist")
SPINE = ("pelvis", "spine1", "spine2", "spine3", "neck", "head")


def local_rotations(time: float) -> np.ndarray:
    """Local rotations (22, 3, 3) at a time in seconds, relative to a T-pose facing +Z."""
    local = np.tile(np.eye(3), (22, 1, 1))
    stride = 2 * np.pi * 0.9 * time
    local[0] = turn("Y", 0.7 + 0.5 * time) @ turn("Z", 0.05 * np.sin(stride)) @ turn("X", 0.05)
    for side, sign in (("left", 1), ("right", -1)):
        swing = sign * np.sin(stride)
        local[JOINT_INDEX[f"{side}_hip"]] = turn("X", -0.15 - 0.45 * swing)
        local[JOINT_INDEX[f"{side}_knee"]] = turn("X", 0.35 + 0.3 * np.cos(stride) * sign)
        local[JOINT_INDEX[f"{side}_ankle"]] = turn("X", -0.1 + 0.1 * swing)
    local[JOINT_INDEX["right_shoulder"]] = turn("X", -0.3 * np.sin(stride)) @ turn("Z", 1.25)
    local[JOINT_INDEX["right_elbow"]] = turn("Y", 0.4)
    local[JOINT_INDEX["left_shoulder"]] = turn("Z", 0.35 + 0.1 * np.sin(stride))
    local[JOINT_INDEX["left_elbow"]] = turn("Z", 0.9 + 0.4 * np.sin(6 * time))
    local[JOINT_INDEX["neck"]] = turn("X", 0.1 * np.sin(2 * time))
    local[JOINT_INDEX["head"]] = turn("Y", 0.2 * np.sin(3 * time))
    return local


def true_motion(times: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Joints (k, 22, 3) metres and global rotations (k, 22, 3, 3) relative to the T-pose."""
    places, axes = np.zeros((len(times), 22, 3)), np.zeros((len(times), 22, 3, 3))
    for frame, time in enumerate(times):
        local = local_rotations(float(time))
        # a circle, walked forwards: the heading is 0.7 + 0.5 t
        angle = 0.7 + 0.5 * time
        places[frame, 0] = (-2.4 * np.cos(angle), 0.93 + 0.02 * np.sin(12 * time), 2.4 * np.sin(angle))
        axes[frame, 0] = local[0]
        for joint, parent in enumerate(PARENTS[1:], start=1):
            places[frame, joint] = places[frame, parent] + axes[frame, parent] @ METRES[joint]
            axes[frame, joint] = axes[frame, parent] @ local[joint]
    return places, axes


def true_joints(frames: int, fps: float = 20.0) -> np.ndarray:
    """Joints (frames, 22, 3) metres, Y up."""
    return true_motion(np.arange(frames) / fps)[0]


def names_of(spine: str, limbs: str, side: str = "{Side}{name}") -> dict[str, str]:
    """File names by joint: `-` where the skeleton lacks it; `side` may use Side, side, S, s and name."""
    names = {joint: name for joint, name in zip(SPINE, spine.split(), strict=True) if name != "-"}
    for joint, name in zip(LIMBS, limbs.split(), strict=True):
        for left in ("left", "right"):
            if name != "-":
                forms = {"Side": left.title(), "side": left, "S": left[0].upper(), "s": left[0]}
                names[f"{left}_{joint}"] = side.format(name=name, **forms)
    return names


def rest_a() -> np.ndarray:
    """Global rotations (22, 3, 3) of an A-pose: arms 45 degrees down."""
    rest = np.tile(np.eye(3), (22, 1, 1))
    for part in ("shoulder", "elbow", "wrist"):
        rest[JOINT_INDEX[f"left_{part}"]], rest[JOINT_INDEX[f"right_{part}"]] = turn("Z", -0.785), turn("Z", 0.785)
    return rest


def rest_along_x() -> np.ndarray:
    """Rotations that lay every bone along its own X axis, as in Biped and in files of Maya."""
    rest = np.tile(turn("Z", -np.pi / 2), (22, 1, 1))  # up becomes X
    for joint, name in enumerate(JOINT_NAMES):
        if name.partition("_")[2] in ("hip", "knee", "ankle", "foot"):
            rest[joint] = turn("Z", np.pi / 2)
        if name.partition("_")[2] in ("shoulder", "elbow", "wrist"):
            rest[joint] = np.eye(3) if name.startswith("left") else turn("Y", np.pi)
    return rest


@dataclass(frozen=True)
class Exporter:
    """How a program writes a motion."""

    names: Mapping[str, str]
    unit: float = 0.01
    """Metres."""
    order: str = "ZXY"
    fps: float = 30.0
    up: str = "y"
    """"z", or "turned": Z is up, but the rest pose has Y up."""
    rest: str = "T"
    """"T", "A" or "x"."""
    root: str = ""
    """Joint above the pelvis."""
    between: Mapping[str, str] = field(default_factory=dict)
    """Joint -> name of one more joint half way to it."""
    lies_on: Mapping[str, str] = field(default_factory=dict)
    """Joint -> joint at whose place it lies."""
    positions: str = "root"
    """Joints with position channels: of the root, "all", or "zero": all, but zero."""
    tpose_first: bool = False
    frame_more: bool = False
    mirrored: bool = False
    time_format: str = ".7f"

    def text(self, frames: int) -> str:
        """Write `frames` of the motion."""
        return _Writer(self).text(frames)


class _Writer:
    def __init__(self, exporter: Exporter) -> None:
        self.form = exporter
        self.rest = {"T": lambda: np.tile(np.eye(3), (22, 1, 1)), "A": rest_a, "x": rest_along_x}[exporter.rest]()
        upright, flipped = np.eye(3), np.diag([-1.0, 1.0, 1.0]) if exporter.mirrored else np.eye(3)
        turned = upright if exporter.up == "y" else np.array([[1.0, 0, 0], [0, 0, -1.0], [0, 1.0, 0]])
        self.world = turned @ flipped
        self.frame = upright @ flipped if exporter.up == "turned" else self.world
        """What the axes of bones at rest are turned by."""
        self.lines: list[str] = []
        self.nodes: list[tuple[int, int, str]] = []
        """Joint whose frame and place it has (share of the way in the third), in the order of the channels."""

    def text(self, frames: int) -> str:
        places, axes = true_motion(np.arange(frames) / self.form.fps)
        if self.form.tpose_first:
            places[0], axes[0] = places[0], np.eye(3)
            for joint, parent in enumerate(PARENTS[1:], start=1):
                places[0, joint] = places[0, parent] + METRES[joint]
        axes = self.world @ axes @ np.swapaxes(self.rest, -1, -2) @ self.frame.T
        root = (places[:, 0] @ self.world.T) / self.form.unit
        self.rows: list[list[np.ndarray]] = []
        self.lines = ["HIERARCHY"]
        if self.form.root:
            self._open("ROOT", self.form.root, np.zeros(3), 0, "root")
            self.rows += [[*np.zeros((3, frames))], [*np.zeros((3, frames))]]
            self._joint(0, "JOINT", axes, np.tile(np.eye(3), (frames, 1, 1)), root)
            self.lines.append("}")
        else:
            self._joint(0, "ROOT", axes, np.tile(np.eye(3), (frames, 1, 1)), root)
        columns = np.array([column for group in self.rows for column in group]).T
        said = frames - self.form.frame_more
        motion = [" ".join(f"{number:.6f}" for number in row) for row in columns]
        time = format(1 / self.form.fps, self.form.time_format)
        return "\n".join([*self.lines, "MOTION", f"Frames: {said}", f"Frame Time: {time}", *motion]) + "\n"

    def _offset(self, parent: int, joint: int) -> np.ndarray:
        """Offset in units from the place of one joint to that of another, in the rest frame of the parent."""
        place = {name: self._rest_place(JOINT_INDEX[name]) for name in JOINT_NAMES}
        start, end = (place[self.form.lies_on.get(JOINT_NAMES[at], JOINT_NAMES[at])] for at in (parent, joint))
        return self.frame @ self.rest[parent] @ (end - start) / self.form.unit

    def _rest_place(self, joint: int) -> np.ndarray:
        return METRES[joint] + (self._rest_place(PARENTS[joint]) if joint else -METRES[0])

    def _open(self, kind: str, name: str, offset: np.ndarray, depth: int, channels: str) -> None:
        rotations = " ".join(f"{axis}rotation" for axis in self.form.order)
        moving = "6 Xposition Yposition Zposition" if channels == "root" else "3"
        numbers = " ".join(f"{value:.6f}" for value in offset)
        self.lines += [f"{kind} {name}", "{", f"OFFSET {numbers}", f"CHANNELS {moving} {rotations}"]

    def _joint(
        self, joint: int, kind: str, axes: np.ndarray, above: np.ndarray, root: np.ndarray | None, parent: int = -1
    ) -> None:
        name, frames = JOINT_NAMES[joint], len(axes)
        offset = np.zeros(3) if root is not None else self._offset(parent, joint)
        middle = self.form.between.get(name)
        if middle:
            offset = offset / 2
            self._channels("JOINT", middle, offset, np.zeros((frames, 3)), None)
        angles = euler(np.swapaxes(above, -1, -2) @ axes[:, joint], self.form.order)
        self._channels(kind, self.form.names[name], offset, angles, root)
        children = [child for child in range(22) if self._parent(child) == joint]
        for child in children:
            self._joint(child, "JOINT", axes, axes[:, joint], None, joint)
        if not children:
            missing = [child for child in range(22) if PARENTS[child] == joint]
            end = self._offset(joint, missing[0]) if missing else self.frame @ self.rest[joint] @ [0, 0.05, 0]
            self.lines += ["End Site", "{", "OFFSET " + " ".join(f"{value:.6f}" for value in end), "}"]
        self.lines += ["}"] * (2 if middle else 1)

    def _channels(self, kind: str, name: str, offset: np.ndarray, angles: np.ndarray, root: np.ndarray | None) -> None:
        positions = root is not None or self.form.positions != "root"
        self._open(kind, name, offset, 0, "root" if positions else "")
        if positions:
            still = np.zeros(3) if self.form.positions == "zero" else offset
            self.rows.append([*(root if root is not None else np.tile(still, (len(angles), 1))).T])
        self.rows.append([*angles.T])

    def _parent(self, joint: int) -> int:
        """The nearest ancestor that the skeleton has; -1 for the root and for joints that it lacks."""
        if JOINT_NAMES[joint] not in self.form.names or joint == 0:
            return -1
        parent = PARENTS[joint]
        while JOINT_NAMES[parent] not in self.form.names:
            parent = PARENTS[parent]
        return parent


def euler(matrices: np.ndarray, order: str) -> np.ndarray:
    """Degrees (k, 3) in the order of the channels: R = R_first R_second R_third (Tait-Bryan angles)."""
    i, j, k = ("XYZ".index(axis) for axis in order)
    sign = 1.0 if (i, j, k) in ((0, 1, 2), (1, 2, 0), (2, 0, 1)) else -1.0
    second = np.arcsin(np.clip(sign * matrices[:, i, k], -1, 1))
    first = np.arctan2(-sign * matrices[:, j, k], matrices[:, k, k])
    third = np.arctan2(-sign * matrices[:, i, j], matrices[:, i, i])
    return np.degrees(np.stack([first, second, third], axis=-1))


MIXAMO_LIMBS = "UpLeg Leg Foot ToeBase Shoulder Arm ForeArm Hand"
MIXAMO_SPINE = "Hips Spine Spine1 Spine2 Neck Head"


def prefixed(prefix: str, names: Mapping[str, str], suffix: str = "") -> dict[str, str]:
    return {joint: f"{prefix}{name}{suffix}" for joint, name in names.items()}


_MIXAMO = names_of(MIXAMO_SPINE, MIXAMO_LIMBS)
_XSENS = names_of("Hips Chest Chest2 Chest4 Neck Head", "Hip Knee Ankle Toe Collar Shoulder Elbow Wrist")
_BIPED = "Thigh Calf Foot Toe0 Clavicle UpperArm Forearm Hand"
_HUMANOID = "UpperLeg LowerLeg Foot Toes Shoulder UpperArm LowerArm Hand"

EXPORTERS: dict[str, Exporter] = {
    "Mixamo": Exporter(prefixed("mixamorig:", _MIXAMO)),
    "Rokoko": Exporter(
        names_of("Hips Spine1 Spine2 Spine4 Neck Head", "Thigh Shin Foot Toe Shoulder Arm ForeArm Hand"),
        order="YXZ", fps=100.0, root="Root", positions="all", frame_more=True,
    ),
    "Xsens MVN": Exporter(_XSENS, order="YXZ", fps=60.0),
    "Xsens segments": Exporter(
        names_of("Pelvis L5 L3 T8 Neck Head", "UpperLeg LowerLeg Foot Toe Shoulder UpperArm Forearm Hand"), order="XYZ"
    ),
    "100STYLE": Exporter(_XSENS, order="YXZ", fps=60.0, time_format=".6f"),
    "3ds Max Biped": Exporter(
        prefixed("Bip01 ", names_of("Pelvis Spine Spine1 Spine2 Neck Head", _BIPED, "{S} {name}")),
        unit=0.0254, order="ZYX", up="turned", rest="x", root="Bip01",
    ),
    "Unity": Exporter(
        names_of("Hips Spine Chest UpperChest Neck Head", _HUMANOID), unit=1.0, order="ZXY", positions="all"
    ),
    "VRoid": Exporter(
        names_of(
            "J_Bip_C_Hips J_Bip_C_Spine J_Bip_C_Chest J_Bip_C_UpperChest J_Bip_C_Neck J_Bip_C_Head",
            "UpperLeg LowerLeg Foot ToeBase Shoulder UpperArm LowerArm Hand", "J_Bip_{S}_{name}",
        ),
        unit=1.0, order="XYZ", root="Root",
    ),
    "Unreal": Exporter(
        names_of(
            "pelvis spine_01 spine_02 spine_03 neck_01 head", "thigh calf foot ball clavicle upperarm lowerarm hand",
            "{name}_{s}",
        ),
        order="XYZ", up="z", rest="A", root="root", between={"left_wrist": "lowerarm_twist_01_l"},
    ),
    "Rigify": Exporter(
        prefixed("DEF-", names_of(
            "spine spine.001 spine.002 spine.003 spine.004 spine.006",
            "thigh shin foot toe shoulder upper_arm forearm hand", "{name}.{S}",
        )),
        unit=1.0, order="XYZ", up="z", rest="A", fps=24.0, between={"left_elbow": "DEF-upper_arm.L.001"},
    ),
    "Daz Genesis 8": Exporter(
        names_of(
            "pelvis abdomenLower abdomenUpper chestLower neckLower head",
            "ThighBend Shin Foot Toe Collar ShldrBend ForearmBend Hand", "{s}{name}",
        ),
        order="XYZ", rest="A", root="hip",
        between={"left_knee": "lThighTwist", "left_wrist": "lForearmTwist"},
    ),
    "SOMA": Exporter(
        names_of("Hips Spine1 Spine2 Chest Neck1 Head", "Leg Shin Foot ToeBase Shoulder Arm ForeArm Hand"),
        order="ZYX", fps=120.0, root="Root",
    ),
    "MakeHuman": Exporter(
        names_of("hip abdomen chest - neck head", "hip knee foot - collar shoulder elbow hand", "{s}{name}")
        | {"left_foot": "toe1.l", "right_foot": "toe1.r"},
        order="YZX",
    ),
    "CMU, cgspeed": Exporter(
        names_of("Hips LowerBack Spine Spine1 Neck Head", MIXAMO_LIMBS),
        unit=0.0254 / 0.45, order="ZYX", fps=120.0, tpose_first=True,
        between={"left_hip": "LHipJoint", "right_hip": "RHipJoint", "head": "Neck1"},
        lies_on={"spine1": "pelvis", "spine3": "neck", "left_collar": "neck", "right_collar": "neck"},
    ),
    "CMU, Daz-friendly": Exporter(
        names_of("hip abdomen chest - neck head", "Thigh Shin Foot - Collar Shldr ForeArm Hand", "{s}{name}"),
        unit=0.0254, order="XYZ", between={"left_hip": "lButtock", "right_hip": "rButtock"},
    ),
    "Biovision": Exporter(
        names_of("Hips Chest Chest2 - Neck Head", "Hip Knee Ankle - Collar Shoulder Elbow Wrist"), unit=0.0254,
    ),
    "Perception Neuron": Exporter(
        prefixed("Robot_", names_of(MIXAMO_SPINE, "UpLeg Leg Foot - Shoulder Arm ForeArm Hand")),
        order="YXZ", fps=60.0, positions="all",
    ),
    "HumanIK": Exporter(prefixed("Character1_", _MIXAMO), order="XYZ", root="Character1_Reference", positions="zero"),
    "Character Creator": Exporter(
        prefixed("CC_Base_", names_of(
            "Hip Waist Spine01 Spine02 NeckTwist01 Head",
            "Thigh Calf Foot ToeBase Clavicle Upperarm Forearm Hand", "{S}_{name}",
        )),
        order="YXZ", rest="A", root="RL_BoneRoot",
    ),
    "OptiTrack": Exporter(
        prefixed("Anna:", names_of(
            "Hip Ab - Chest Neck Head", "Thigh Shin Foot Toe Shoulder UArm FArm Hand", "{S}{name}"
        )),
        unit=0.001, fps=120.0, order="XYZ",
    ),
    "LaFAN1": Exporter(
        names_of(MIXAMO_SPINE, "UpLeg Leg Foot Toe Shoulder Arm ForeArm Hand"), order="ZYX", rest="x"
    ),
    "DeepMotion": Exporter(
        names_of(
            "hips_JNT spine_JNT spine1_JNT spine2_JNT neck_JNT head_JNT",
            "upleg leg foot toebase shoulder arm forearm hand", "{s}_{name}_JNT",
        ),
    ),
    "SMPL": Exporter(
        prefixed("m_avg_", names_of(
            "Pelvis Spine1 Spine2 Spine3 Neck Head", "Hip Knee Ankle Foot Collar Shoulder Elbow Wrist", "{S}_{name}"
        )),
        unit=1.0, order="XYZ", root="m_avg_root", up="turned",
    ),
    "Bandai Namco": Exporter(
        names_of("Hips - Spine Chest Neck Head", _HUMANOID, "{name}_{S}"),
        order="ZYX", positions="all", root="joint_Root",
    ),
    "Somebody's": Exporter(prefixed("Hero_rig|", prefixed("Hero_", _MIXAMO)), order="ZXY", rest="A"),
}  # fmt: skip
"""In the forms of as many programs, after their documentation; the motion is always the same."""
