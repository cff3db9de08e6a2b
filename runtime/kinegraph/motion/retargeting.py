"""Retargeting: a clip on the skeleton of a character, whatever its proportions, rest pose and joint orientations.

Symbols, all in world space: R_b is the rotation of bone b at rest, W_j(t) the rotation of our joint j from our T-pose,
and A_b the rotation that brings the character's resting bone onto ours. Then bone b has the rotation

    W_j(t) A_b R_b,

so it points where ours points, whatever R_b, the axes of the joint, may be. Rest poses are aligned from the pelvis
outwards by shortest rotations. Between a bone and the next only the change D = W_j A_b matters: with D_p of the bone
above and the rotation R_p of the parent node at rest, the local rotation is

    R_p^-1 D_p^-1 D R_p  times the local rotation at rest.

Nodes in between (twist joints) and beyond (fingers, hair) stay as they rest. Lengths are scaled by that of the legs;
feet then get the height and the standstill of ours by two-bone inverse kinematics, and arms keep out of stout bodies.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np

from kinegraph.arrays import Floats, IntArray
from kinegraph.errors import InvalidInputError
from kinegraph.motion.body_shape import BodyShape, fit_shape, parts_of_nodes
from kinegraph.motion.clearance import Segment, clear_arms, push_of_thigh, push_of_trunk
from kinegraph.motion.humanoid import SIDES, Humanoid
from kinegraph.motion.kinematics import BY_DEPTH, SkeletonMotion
from kinegraph.motion.postprocess import (
    MAX_CORRECTION,
    MAX_EXTENSION,
    ease_corrections,
    find_contacts,
    median_place,
    two_bone_ik,
)
from kinegraph.motion.quaternions import (
    IDENTITY,
    about_axis,
    conjugate,
    continuous_signs,
    from_matrix,
    multiply,
    normalised,
    rotate,
    shortest_rotation,
    slerp,
)
from kinegraph.motion.rig import Rig
from kinegraph.motion.skeleton import HORIZONTAL, JOINT_INDEX, JOINTS, PARENTS, PELVIS, facing_angle

FLAT_FOOT: Final = normalised(np.array([0.0, -0.64, 0.77]))
"""From ankle to toe of our body while the sole is flat on the floor (HumanML3D's bone lengths)."""
UPRIGHT_NECK: Final = normalised(np.array([0.0, 0.99, 0.12]))
"""From neck to head of our body while it looks straight ahead (mean of recorded clips)."""
LOW: Final = 0.03
"""Metres over the floor, of our body, up to which a toe is brought to the height of ours."""
HIGH: Final = 0.13
"""Metres from which it is left where it is."""
NEAR_FLOOR: Final = 0.02
"""Metres over which the weight of a foot in the height of the hips falls by e."""
UPRIGHT: Final = float(np.cos(np.radians(30.0)))
"""Cosine between body and +Y from which a rest pose counts as standing; others (Z up by mistake) are stood up."""

SPINE: Final = tuple(JOINT_INDEX[name] for name in ("spine1", "spine2", "spine3"))
NEXT: Final[dict[str, str]] = {"neck": "head"} | {
    f"{side}_{joint}": f"{side}_{child}"
    for side in SIDES
    for joint, child in (
        ("hip", "knee"), ("knee", "ankle"), ("collar", "shoulder"), ("shoulder", "elbow"), ("elbow", "wrist"),
    )
}  # fmt: skip
"""Joint -> the next one; the bone between them points as ours does."""


@dataclass(frozen=True, eq=False)
class RigMotion:
    """Tracks of the nodes that move; every other node stays as it is in the file."""

    rotations: Mapping[int, Floats]
    """Node -> (frames, 4) local quaternions w, x, y, z, with continuous signs."""
    translations: Mapping[int, Floats]
    """Node -> (frames, 3) local positions, in the units of the file."""
    scale: float
    """Units of the file per metre of ours."""


@dataclass(frozen=True, eq=False)
class _Body:
    """A character at rest in our frame: on y = 0, hips above the origin, facing +Z, with legs as long as ours."""

    rig: Rig
    bones: Mapping[str, int]
    spine: tuple[int, ...]
    points: Floats
    """(nodes, 3) metres of ours."""
    stand: Floats
    """(4,) rotation from the file's world into our frame."""
    face: Floats
    """(4,) rotation about +Y from ours to where the character faces."""
    scale: float
    """Units of the file per metre of ours."""
    origin: Floats
    """(3,) point of the file's floor below the hips."""


def retarget(
    rig: Rig,
    humanoid: Humanoid,
    floor: float,
    motion: SkeletonMotion,
    fps: float,
    root: int | None = None,
    shape: BodyShape | None = None,
) -> RigMotion:
    """Compute the tracks of a character for a clip.

    Args:
        rig: nodes of the character at rest.
        humanoid: which of them follow our joints.
        floor: height of the soles at rest, in the units of the file.
        motion: of our skeleton.
        fps: its frames per second.
        root: node above the pelvis that is to carry travel and heading; None lets the pelvis carry them.
        shape: how stout the character is, in the units of the file; arms are kept out of that.

    Returns:
        Local rotations of all nodes that follow a joint, and the position of the pelvis; with `root` also its tracks.

    Raises:
        InvalidInputError: the character's legs have no length.
    """
    body = _measure(rig, humanoid, floor, motion.rest_offsets)
    turned, ours = _world_motion(motion)
    changes = _changes(body, turned, motion.rest_offsets)
    pelvis = _place(body, changes, ours, fps)
    if shape is not None:
        _keep_arms_out(body, changes, shape.scaled(1.0 / body.scale))
    return _tracks(body, changes, pelvis, ours, root)


def measure_shape(rig: Rig, humanoid: Humanoid, floor: float, points: Floats, nodes: IntArray) -> BodyShape | None:
    """Measure how stout a character is.

    Args:
        rig, humanoid, floor: as for `retarget`.
        points: (n, 3) of the skin at rest, in the world of the file.
        nodes: (n,) that each is bound to.

    Returns:
        Its shape, in the units of the file; None where the skin says too little.
    """
    stand, _, _, below = _rest_frame(rig, humanoid, floor)
    joints, skin = (rotate(stand, each) - below for each in (rig.positions, points))
    if not (np.isfinite(joints).all() and np.isfinite(skin).all()):
        return None
    parts = parts_of_nodes(rig, humanoid.bones, humanoid.spine, joints)
    names = np.array([parts.get(node, "") for node in range(len(joints))])
    return fit_shape(skin, names[nodes], joints, humanoid.bones)


def _rest_frame(rig: Rig, humanoid: Humanoid, floor: float) -> tuple[Floats, Floats, Floats, Floats]:
    """Find the frame of a resting character.

    Returns:
        Rotation of the file's world into our frame, heading, nodes (nodes, 3) so rotated, and the point (3,) among
        these on the floor below the hips.
    """
    bones = humanoid.bones
    stand, face, upright = _body_frame(rig.positions, bones)
    points = rotate(stand, rig.positions)
    below = points[[bones[f"{side}_hip"] for side in SIDES]].mean(axis=0) * HORIZONTAL
    below[1] = floor if upright else points[list(bones.values()), 1].min()
    return stand, face, points, below


def _measure(rig: Rig, humanoid: Humanoid, floor: float, offsets: Floats) -> _Body:
    """Bring a resting character into our frame."""
    bones = humanoid.bones
    stand, face, points, below = _rest_frame(rig, humanoid, floor)
    legs = [np.diff(points[[bones[f"{side}_{joint}"] for joint in ("hip", "knee", "ankle")]], axis=0) for side in SIDES]
    leg = float(np.linalg.norm(legs, axis=-1).sum() / 2)
    if not np.isfinite(points).all() or leg < 1e-9:
        raise InvalidInputError("its legs have no length: hip, knee and ankle are in one place")
    scale = leg / float(np.linalg.norm(offsets[[4, 7, 5, 8]], axis=-1).sum() / 2)
    hips = [bones[f"{side}_hip"] for side in SIDES]
    origin = rig.positions[hips].mean(axis=0) * HORIZONTAL + (0.0, floor, 0.0)
    return _Body(rig, bones, humanoid.spine, (points - below) / scale, stand, face, scale, origin)


def _body_frame(points: Floats, bones: Mapping[str, int]) -> tuple[Floats, Floats, bool]:
    """Find the rotation into our frame, the heading at rest, and whether the character stands upright."""
    left, right = (
        np.sum([points[bones[f"{side}_{joint}"]] for joint in ("hip", "shoulder")], axis=0) for side in SIDES
    )
    top = points[bones["head" if "head" in bones else "neck"]]
    up = normalised(top - points[[bones[f"{side}_ankle"] for side in SIDES]].mean(axis=0))
    upright = bool(up[1] > UPRIGHT)
    up = np.array([0.0, 1.0, 0.0]) if upright else up
    across = left - right
    x = normalised(across - (across @ up) * up)
    z = np.cross(x, up)
    heading = about_axis(1, np.asarray(np.arctan2(z[0], z[2]) if upright else 0.0))
    return from_matrix(np.stack([x, up, z])), heading, upright


def _world_motion(motion: SkeletonMotion) -> tuple[Floats, Floats]:
    """Compute rotations (22, frames, 4) from the T-pose in the world, and joints (frames, 22, 3) in metres."""
    turned = np.ascontiguousarray(np.moveaxis(motion.rotations, 1, 0))
    joints = np.zeros((len(motion.root), JOINTS, 3))
    joints[:, PELVIS] = motion.root
    for level in BY_DEPTH:
        above = turned[[PARENTS[joint] for joint in level]]
        step = rotate(above, motion.rest_offsets[level][:, None])
        joints[:, level] = joints[:, [PARENTS[joint] for joint in level]] + step.swapaxes(0, 1)
        turned[level] = multiply(above, turned[level])
    return turned, joints


def _changes(body: _Body, turned: Floats, offsets: Floats) -> dict[int, Floats]:
    """Compute the change W A of every node that follows a joint: node -> (frames, 4), parents first."""
    spine = _spine(body, turned, offsets)
    aligned = _aligned(body, spine, offsets)
    joints = {node: JOINT_INDEX[name.replace("head", "neck")] for name, node in body.bones.items()}
    turns = np.stack([spine[node].turn if node in spine else turned[joints[node]] for node in aligned])
    changes = multiply(turns, np.stack(list(aligned.values()))[:, None])
    return dict(zip(aligned, changes, strict=True))


def _aligned(body: _Body, spine: Mapping[int, _Vertebra], offsets: Floats) -> dict[int, Floats]:
    """Compute the alignment A of every node that follows a joint: node -> (4,), parents first.

    Bones as many steps from the pelvis as one another are turned together, the shortest way.
    """
    bones = {node: (vertebra.bone, vertebra.direction) for node, vertebra in spine.items()}
    fixed: dict[int, Floats] = {}
    for name, node in body.bones.items():
        if node in spine:
            continue
        if name in NEXT and NEXT[name] in body.bones:
            end = body.points[body.bones[NEXT[name]]]
            bones[node] = end - body.points[node], offsets[JOINT_INDEX[NEXT[name]]]
        elif name in ("neck", "head"):
            fixed[node] = shortest_rotation(UPRIGHT_NECK, offsets[JOINT_INDEX["head"]])
    fixed |= _align_feet(body, offsets)
    names = {node for name, node in body.bones.items() if not name.endswith(("_wrist", "_foot"))}
    above: dict[int, int] = {}
    steps: dict[int, int] = {}
    for node in body.rig.order:
        if node in names or node in spine:
            above[node] = next((a for a in body.rig.ancestors(body.rig.parents[node]) if a in steps), -1)
            steps[node] = steps.get(above[node], -1) + 1
    aligned = {-1: np.array(IDENTITY)}
    for step in range(max(steps.values()) + 1):
        level = [node for node in steps if steps[node] == step]
        aligned |= {node: fixed.get(node, aligned[above[node]]) for node in level}
        if turning := [node for node in level if node in bones]:
            start = np.stack([aligned[above[node]] for node in turning])
            resting, ours = (np.stack(ends) for ends in zip(*(bones[node] for node in turning), strict=True))
            turned = multiply(shortest_rotation(rotate(start, resting), ours), start)
            aligned |= dict(zip(turning, turned, strict=True))
    return {node: aligned[node] for node in steps}


def _align_feet(body: _Body, offsets: Floats) -> dict[int, Floats]:
    """Align feet by their headings only: a sole that rests flat is flat where ours is, however high the ankle."""
    ankles = [body.bones[f"{side}_ankle"] for side in SIDES]
    toes = [body.bones.get(f"{side}_foot", -1) for side in SIDES]
    ahead = [
        (0.0, 0.0, 1.0) if toe < 0 else (body.points[toe] - body.points[ankle]) * HORIZONTAL
        for ankle, toe in zip(ankles, toes, strict=True)
    ]
    rest = offsets[[JOINT_INDEX[f"{side}_foot"] for side in SIDES]]
    flat, heading = shortest_rotation(
        np.stack([np.broadcast_to(FLAT_FOOT, (2, 3)), np.array(ahead)]), np.stack([rest, rest * HORIZONTAL])
    )
    return dict(zip(ankles, multiply(flat, heading), strict=True))


@dataclass(frozen=True, eq=False)
class _Vertebra:
    """What a node of the spine follows."""

    bone: Floats
    """(3,) to the next node, at rest."""
    direction: Floats
    """(3,) of ours at rest."""
    turn: Floats
    """(frames, 4) rotation of ours."""


def _spine(body: _Body, turned: Floats, offsets: Floats) -> dict[int, _Vertebra]:
    """Spread our three joints of the spine over the character's.

    The last node, the chest, follows ours; the others lie at equal steps from spine1 on.
    """
    bones = [offsets[JOINT_INDEX[name]] for name in ("spine2", "spine3", "neck")]
    count = len(body.spine)
    ends = [*body.spine[1:], body.bones["neck" if "neck" in body.bones else "head"]]
    spread: dict[int, _Vertebra] = {}
    for index, node in enumerate(body.spine):
        place = 2.0 * index / (count - 1) if count > 1 else 2.0
        low = min(int(place), 1)
        share = place - low
        direction = (1 - share) * normalised(bones[low]) + share * normalised(bones[low + 1])
        lower, upper = turned[SPINE[low]], turned[SPINE[low + 1]]
        turn = lower if share == 0 else upper if share == 1 else slerp(lower, upper, np.full(len(lower), share))
        spread[node] = _Vertebra(body.points[ends[index]] - body.points[node], direction, turn)
    return spread


def _place(body: _Body, changes: dict[int, Floats], ours: Floats, fps: float) -> Floats:
    """Place the pelvis (frames, 3) and bend the legs, so that feet are as high as ours and stand as ours do.

    Hips go with ours; then they move by what the feet near the floor miss, which keeps the legs' directions. What one
    leg still misses is left to two-bone inverse kinematics. Changes of the legs are replaced.
    """
    legs, pelvis = _Legs(body, changes, ours, fps), body.bones["pelvis"]
    root = ours[:, [JOINT_INDEX[f"{side}_hip"] for side in SIDES]].mean(axis=1)
    weights = np.exp(-legs.height / NEAR_FLOOR)[..., None]
    missed = legs.correction(root, legs.shift(root, fps))
    root = root + (weights * missed).sum(axis=0) / weights.sum(axis=0)
    shift = legs.shift(root, fps)  # whatever the height of the hips
    root[:, 1] -= legs.out_of_reach(root, shift).max(axis=0)
    changes |= legs.planted(root, shift, changes)
    return np.asarray(root + rotate(changes[pelvis], body.points[pelvis] - legs.middle))


class _Legs:
    """The legs of the character, from the middle of the hips, with directions like ours; and where toes should be.

    Arrays are (2, frames, ...), left and right.
    """

    def __init__(self, body: _Body, changes: Mapping[int, Floats], ours: Floats, fps: float) -> None:
        points = body.points
        self.nodes = [[body.bones[f"{side}_{joint}"] for side in SIDES] for joint in ("hip", "knee", "ankle")]
        hips, knees, ankles = (points[nodes] for nodes in self.nodes)
        toes = np.stack([_toe_at_rest(body, side, ours) for side in SIDES])
        self.middle = hips.mean(axis=0)
        turns = np.stack([[changes[node] for node in nodes] for nodes in self.nodes])
        thighs, shins, feet = rotate(turns, np.stack([knees - hips, ankles - knees, toes - ankles])[:, :, None])
        self.hip = rotate(changes[body.bones["pelvis"]], (hips - self.middle)[:, None])
        self.knee = self.hip + thighs
        self.ankle = self.knee + shins
        self.toe = self.ankle + feet
        self.our_toe = ours[:, [JOINT_INDEX[f"{side}_foot"] for side in SIDES]].swapaxes(0, 1)
        self.height = np.maximum(self.our_toe[..., 1], 0.0)
        # smoothstep from HIGH to LOW
        share = np.clip((HIGH - self.height) / (HIGH - LOW), 0.0, 1.0)
        self.lowness = share**2 * (3 - 2 * share)
        self.goal_height = self.height + toes[:, None, 1]
        self.contacts = [find_contacts(toe, fps) for toe in self.our_toe]
        # pelvises that are wider than ours move their feet further when they turn
        ours_apart = np.linalg.norm(ours[0, JOINT_INDEX["left_hip"]] - ours[0, JOINT_INDEX["right_hip"]])
        apart = 2 * np.linalg.norm(hips - self.middle, axis=-1)
        self.most = MAX_CORRECTION * np.maximum(1.0, apart / ours_apart)

    def shift(self, root: Floats, fps: float) -> Floats:
        """Compute what makes toes move as ours do while these are planted.

        Args:
            root: (frames, 3) the middle of the hips.
            fps: frames per second.

        Returns:
            (2, frames, 3) metres over the floor.
        """
        toes = root + self.toe
        apart = (toes - self.our_toe) * HORIZONTAL
        shift = np.zeros_like(toes)
        for foot, contacts in enumerate(self.contacts):
            for start, end in contacts:
                back = median_place(apart[foot, start:end]) - apart[foot, start:end]
                distance = np.maximum(np.sqrt((back * back).sum(axis=-1, keepdims=True)), 1e-9)
                shift[foot, start:end] = back * np.minimum(1.0, self.most[foot] / distance)
            shift[foot] = ease_corrections(toes[foot], shift[foot], contacts, fps)
        return np.asarray(shift)

    def correction(self, root: Floats, shift: Floats) -> Floats:
        """Compute what shifts toes, and brings them to the height of ours: (2, frames, 3) metres."""
        correction = shift.copy()
        correction[..., 1] = self.lowness * (self.goal_height - root[:, 1] - self.toe[..., 1])
        return correction

    def out_of_reach(self, root: Floats, shift: Floats) -> Floats:
        """Compute the metres (2, frames) by which a corrected toe is too far away for the leg."""
        wanted = self.ankle + self.correction(root, shift) - self.hip
        bones = np.stack([self.knee - self.hip, self.ankle - self.knee, self.ankle - self.hip, wanted])
        upper, lower, now, far = np.linalg.norm(bones, axis=-1)
        return np.asarray(self.lowness * np.maximum(far - np.maximum(now, MAX_EXTENSION * (upper + lower)), 0.0))

    def planted(self, root: Floats, shift: Floats, changes: Mapping[int, Floats]) -> dict[int, Floats]:
        """Bend the legs so that toes are corrected; feet keep their directions: node -> its change."""
        goals = root + self.ankle + self.correction(root, shift)
        hip, knee, ankle, goal = (
            each.reshape(-1, 3) for each in (root + self.hip, root + self.knee, root + self.ankle, goals)
        )
        new_knee, new_ankle = two_bone_ik(hip, knee, ankle, goal)
        before, after = np.stack([knee - hip, ankle - knee]), np.stack([new_knee - hip, new_ankle - new_knee])
        nodes = [*self.nodes[0], *self.nodes[1]]
        turns = shortest_rotation(before, after).reshape(4, -1, 4)
        return dict(zip(nodes, multiply(turns, np.stack([changes[node] for node in nodes])), strict=True))


def _toe_at_rest(body: _Body, side: str, ours: Floats) -> Floats:
    """Locate the toe; that of a character without is on the floor, as far ahead as ours."""
    if f"{side}_foot" in body.bones:
        return np.asarray(body.points[body.bones[f"{side}_foot"]])
    foot = ours[0, JOINT_INDEX[f"{side}_foot"]] - ours[0, JOINT_INDEX[f"{side}_ankle"]]
    ankle = body.points[body.bones[f"{side}_ankle"]]
    return np.asarray(ankle * HORIZONTAL + (0.0, 0.0, FLAT_FOOT[2] * np.linalg.norm(foot)))


def _keep_arms_out(body: _Body, changes: dict[int, Floats], shape: BodyShape) -> None:
    """Swing arms that would be in the trunk or the thighs; replaces changes of upper arms and forearms."""
    bones, points, segments = body.bones, body.points, _Segments(body, changes)
    pelvis = bones["pelvis"]
    pushes = [push_of_trunk(shape, segments[pelvis], segments[body.spine[-1] if body.spine else pelvis])]
    for side, radii in zip(SIDES, shape.thighs, strict=True):
        if radii.all():
            thigh = segments[bones[f"{side}_hip"]]
            pushes.append(push_of_thigh(radii, shape.forearm, thigh, points[bones[f"{side}_knee"]]))
    upper, fore = ([segments[bones[f"{side}_{joint}"]] for side in SIDES] for joint in ("shoulder", "elbow"))
    shoulders, elbows = (np.stack([each.at for each in limbs], axis=1) for limbs in (upper, fore))
    wrists = np.stack([f.point(points[bones[f"{side}_wrist"]]) for f, side in zip(fore, SIDES, strict=True)], axis=1)
    palms = np.stack([f.point(palm) for f, palm in zip(fore, shape.palms, strict=True)], axis=1)
    new_elbows, new_wrists = clear_arms(pushes, shoulders, elbows, wrists, palms)
    if new_elbows is elbows:
        return
    for index, side in enumerate(SIDES):
        for joint, bone, new in (
            ("shoulder", elbows - shoulders, new_elbows - shoulders),
            ("elbow", wrists - elbows, new_wrists - new_elbows),
        ):
            node = bones[f"{side}_{joint}"]
            changes[node] = multiply(shortest_rotation(bone[:, index], new[:, index]), changes[node])


class _Segments(dict[int, Segment]):
    """Node that follows a joint -> where it is in each frame, relative to the pelvis; filled in as asked for."""

    def __init__(self, body: _Body, changes: Mapping[int, Floats]) -> None:
        super().__init__()
        self._body, self._changes = body, changes

    def __missing__(self, node: int) -> Segment:
        rest, turn = self._body.points[node], self._changes[node]
        at: Floats = np.zeros((len(turn), 3))
        if node != self._body.bones["pelvis"]:
            rig = self._body.rig
            above = next(a for a in rig.ancestors(rig.parents[node]) if a in self._changes)
            at = self[above].point(rest)
        self[node] = Segment(rest, at, turn)
        return self[node]


def _tracks(body: _Body, changes: Mapping[int, Floats], pelvis: Floats, ours: Floats, root: int | None) -> RigMotion:
    """Turn changes in our frame into local rotations and positions of nodes."""
    rig, first = body.rig, body.bones["pelvis"]
    place = {node: index for index, node in enumerate(changes)}
    above = [next((place[a] for a in rig.ancestors(rig.parents[node]) if a in place), -1) for node in changes]
    every = np.stack([*changes.values(), np.broadcast_to(conjugate(body.face), changes[first].shape)])
    steps = multiply(conjugate(every[above]), every[:-1])
    at = body.origin + rotate(body.face, pelvis * body.scale)
    nodes, translations = list(changes), dict[int, Floats]()
    # world changes are face C stand; `face` drops out between two bones
    stands = np.stack([np.array(IDENTITY) if node == first else body.stand for node in nodes])
    stand = np.broadcast_to(body.stand, stands.shape)
    if root is not None:
        # the root carries rigidly what is below it: x -> turn (x - origin) + origin + travel
        heading = about_axis(1, facing_angle(ours).astype(np.float64))
        turn = multiply(multiply(body.face, heading), conjugate(body.face))
        travel = rotate(body.face, ours[:, PELVIS] * HORIZONTAL * body.scale)
        start = rig.positions[root] - body.origin
        translations[root] = _into(rig, rig.parents[root], body.origin + travel + rotate(turn, start))
        at = body.origin + rotate(conjugate(turn), at - body.origin - travel)
        steps[place[first]] = multiply(conjugate(turn), steps[place[first]])
        nodes, steps = [*nodes, root], np.concatenate([steps, turn[None]])
        stands, stand = (np.concatenate([each, [IDENTITY]]) for each in (stands, stand))
    translations[first] = _into(rig, rig.parents[first], at)
    parent = rig.orientations[[rig.parents[node] for node in nodes]]
    before = multiply(conjugate(parent), conjugate(stands))
    after = multiply(multiply(stand, parent), rig.rotations[nodes])
    local = normalised(multiply(multiply(before[:, None], steps), after[:, None]))
    local = continuous_signs(np.moveaxis(local, 0, 1))
    return RigMotion({node: local[:, index] for index, node in enumerate(nodes)}, translations, body.scale)


def _into(rig: Rig, parent: int, points: Floats) -> Floats:
    """Express points (frames, 3) of the world in the frame of a resting node; -1 is the world."""
    if parent < 0:
        return points
    matrix = rig.world[parent]
    return np.asarray(np.linalg.solve(matrix[:3, :3], (points - matrix[:3, 3]).T).T)
