"""Constraints: what a clip has to do besides its sentence, where and when.

    Path, Waypoint        where the person is on the floor
    JointTarget           where a hand, a foot or any other joint is
    Keyframe              the whole body at a moment
    StartPose, EndPose    the first and the last frames, with their velocity
    Loop                  the last frame is the first again

Metres, +Y up; a clip starts at the origin and faces +Z, with its left side towards +X. Degrees of a heading count
from +Z towards +X: 90 is to the left, as in `motion.skeleton.facing_angle`. The root is the pelvis, seen from above.

Each constraint is an energy of the sampler: EnergyMoGen, Eq. 6-8. Values are checked here, without a clip; whether they
fit a clip and one another is checked by `feasibility`.

Above 500 lines because every constraint documents its fields, units and errors.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, Final, Literal, Protocol

import numpy as np

from kinegraph.arrays import DoubleArray, FloatArray
from kinegraph.constraint_values import (
    check_array,
    check_coordinates,
    check_moment,
    check_pose,
    check_rotations,
    check_weight,
    within_metres,
)
from kinegraph.errors import InvalidInputError
from kinegraph.limits import MAX_PATH_POINTS, MAX_POSE_FRAMES
from kinegraph.motion.body_frame import BodyFrame
from kinegraph.motion.kinematics import REST_OFFSETS, forward_kinematics
from kinegraph.motion.resampling import resample
from kinegraph.motion.skeleton import JOINT_INDEX, JOINTS
from kinegraph.validation import check_flag, check_fps, finite_number, short_repr

POSE_SECONDS: Final = 0.2
"""Length of what a `StartPose` or `EndPose` takes of a clip: enough for place and velocity."""
ALIASES: Final[Mapping[str, str]] = MappingProxyType(
    {"left_hand": "left_wrist", "right_hand": "right_wrist", "root": "pelvis"}
)
"""Further names of joints; "left foot" is `left_foot`, the ball of the foot."""


class Motion(Protocol):
    """What a pose can be taken from: a `Clip`."""

    @property
    def joints(self) -> FloatArray:
        """(frames, 22, 3) metres."""

    @property
    def fps(self) -> float:
        """Frames per second."""


@dataclass(frozen=True, eq=False)
class Path:
    """Let the root follow straight lines from point to point.

    Raises:
        InvalidInputError: naming the value.
    """

    points: DoubleArray
    """(points, 2) metres, x and z on the floor; a read-only copy."""
    times: DoubleArray | None = None
    """(points,) seconds, rising; before the first and after the last the root is free. None: at an even pace over the
    whole clip."""
    heading: Literal["along"] | DoubleArray | None = None
    """Where the body faces: "along" the path, (points,) degrees, or None for free."""
    weight: float = 1.0
    """0 to 100; 0 is a clip without it."""

    def __post_init__(self) -> None:
        points = check_array(self.points, "the points of a path", (-1, 2), "(points, 2): x and z of each")
        if not 2 <= len(points) <= MAX_PATH_POINTS:
            raise InvalidInputError(f"a path has 2 to {MAX_PATH_POINTS} points, not {len(points)}; one is a Waypoint")
        _set(self, points=within_metres(points, "a point of a path"), weight=check_weight(self.weight, "a path"))
        if self.times is not None:
            times = check_array(self.times, "the times of a path", (len(points),), f"({len(points)},), one a point")
            if times[0] < 0 or (np.diff(times) <= 0).any():
                raise InvalidInputError("the times of a path must rise from 0 s or later; put the points in order")
            _set(self, times=times)
        if self.heading is None or (isinstance(self.heading, str) and self.heading == "along"):
            return
        if isinstance(self.heading, str):
            raise InvalidInputError(
                f'the heading of a path is "along", degrees for each point, or None, not {short_repr(self.heading)}'
            )
        shape = f"({len(points)},), degrees a point"
        _set(self, heading=check_array(self.heading, "the heading of a path", (len(points),), shape))

    @property
    def length(self) -> float:
        """Metres along the path."""
        return float(np.linalg.norm(np.diff(self.points, axis=0), axis=1).sum())

    def moments(self, duration: float) -> DoubleArray:
        """Tell when the root passes each point.

        Args:
            duration: seconds from the first to the last frame of the clip.

        Returns:
            (points,) seconds, never falling.
        """
        if self.times is not None:
            return np.asarray(self.times)
        arc = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(self.points, axis=0), axis=1))])
        return np.asarray(arc * (duration / arc[-1]) if arc[-1] > 0 else np.linspace(0.0, duration, len(arc)))

    def covers(self, times: DoubleArray, duration: float) -> DoubleArray:
        """Tell at which of `times` (seconds) the path says where the root is: 1 or 0 for each."""
        moments = self.moments(duration)
        near = 1e-6
        return np.asarray((times >= moments[0] - near) & (times <= moments[-1] + near), dtype=np.float64)

    def positions(self, times: DoubleArray, duration: float) -> DoubleArray:
        """Interpolate the path.

        Args:
            times: (frames,) seconds; beyond the ends, the end counts.
            duration: seconds from the first to the last frame of the clip.

        Returns:
            (frames, 2) metres, x and z.
        """
        moments = self.moments(duration)
        return np.stack([np.interp(times, moments, self.points[:, axis]) for axis in (0, 1)], axis=-1)

    def headings(self, times: DoubleArray, duration: float) -> DoubleArray | None:
        """Interpolate where the body faces, the shorter way round; see `positions`.

        Returns:
            (frames,) radians from +Z towards +X, or None if it is free. "Along" is the direction of the piece of the
            path that is passed at the time.
        """
        if self.heading is None:
            return None
        moments = self.moments(duration)
        if not isinstance(self.heading, str):
            return np.interp(times, moments, np.unwrap(np.radians(self.heading)))
        steps = np.diff(self.points, axis=0)
        moving = np.linalg.norm(steps, axis=1) > 1e-9
        if not moving.any():
            return None
        angles = np.arctan2(steps[moving, 0], steps[moving, 1])
        piece = np.searchsorted(moments[:-1][moving], times, side="right") - 1
        return np.asarray(np.unwrap(angles)[np.clip(piece, 0, len(angles) - 1)])


@dataclass(frozen=True)
class Waypoint:
    """Let the root be at a place at a moment.

    Raises:
        InvalidInputError: naming the value.
    """

    seconds: float
    """From the start of the clip."""
    position: tuple[float, float]
    """Metres, x and z on the floor."""
    heading: float | None = None
    """Degrees from +Z towards +X; None is free."""
    weight: float = 1.0
    """0 to 100."""

    def __post_init__(self) -> None:
        _set(
            self,
            seconds=check_moment(self.seconds, "the time of a waypoint"),
            position=check_coordinates(self.position, "a waypoint", "xz"),
            weight=check_weight(self.weight, "a waypoint"),
        )
        if self.heading is not None:
            heading = finite_number(self.heading)
            if heading is None:
                raise InvalidInputError(f"the heading of a waypoint is degrees or None, not {short_repr(self.heading)}")
            _set(self, heading=heading)


@dataclass(frozen=True)
class JointTarget:
    """Let a joint be at a place, at a moment or for a while.

    Raises:
        InvalidInputError: naming the value.
    """

    joint: str
    """One of `motion.skeleton.JOINT_NAMES`, or "left hand", "right hand", "root"; kept as the joint's name."""
    position: tuple[float | None, float | None, float | None]
    """Metres, x, y and z; None for an axis that is free."""
    seconds: float | tuple[float, float]
    """From the start of the clip: a moment, or begin and end."""
    weight: float = 1.0
    """0 to 100."""

    def __post_init__(self) -> None:
        joint = joint_name(self.joint)
        position = check_coordinates(self.position, f"the target of {joint}", "xyz", free=True)
        if all(value is None for value in position):
            raise InvalidInputError(f"the target of {joint} has no axis that is not free; give x, y or z in metres")
        if isinstance(self.seconds, tuple | list):
            if len(self.seconds) != 2:
                raise InvalidInputError(
                    f"the time of a target is a moment or (begin, end), not {len(self.seconds)} times"
                )
            begin, end = (check_moment(value, f"the time of the target of {joint}") for value in self.seconds)
            if end < begin:
                raise InvalidInputError(f"the target of {joint} ends at {end:g} s, before it begins at {begin:g} s")
            _set(self, seconds=(begin, end))
        else:
            _set(self, seconds=check_moment(self.seconds, f"the time of the target of {joint}"))
        _set(self, joint=joint, position=position, weight=check_weight(self.weight, f"the target of {joint}"))

    @property
    def index(self) -> int:
        """Of the joint in `motion.skeleton.JOINT_NAMES`."""
        return JOINT_INDEX[self.joint]

    @property
    def interval(self) -> tuple[float, float]:
        """Begin and end in seconds; the same for a moment."""
        return self.seconds if isinstance(self.seconds, tuple) else (self.seconds, self.seconds)


@dataclass(frozen=True, eq=False)
class Keyframe:
    """Let the whole body be in a pose at a moment.

    Raises:
        InvalidInputError: naming the value.
    """

    seconds: float
    """From the start of the clip."""
    joints: FloatArray
    """(22, 3) metres, where they shall be in the clip; a read-only copy."""
    weight: float = 1.0
    """0 to 100."""
    anywhere: bool = False
    """Whether place on the floor and heading are free: the pose counts, not where it is."""

    def __post_init__(self) -> None:
        _set(
            self,
            seconds=check_moment(self.seconds, "the time of a keyframe"),
            joints=check_pose(self.joints, "the joints of a keyframe", (JOINTS, 3), f"({JOINTS}, 3)"),
            weight=check_weight(self.weight, "a keyframe"),
            anywhere=check_flag(self.anywhere, "anywhere"),
        )

    @classmethod
    def of(
        cls, clip: Motion, seconds: float, *, at: float | None = None, weight: float = 1.0, anywhere: bool = False
    ) -> Keyframe:
        """Take the pose of a clip.

        Args:
            clip: it is taken from.
            seconds: in that clip; the nearest frame.
            at: seconds in the clip that is made; None is the same.
            weight, anywhere: see the fields.

        Raises:
            InvalidInputError: not a clip, or a time outside it.
        """
        joints, fps = _motion(clip, "a keyframe")
        moment = check_moment(seconds, "the time in the clip of a keyframe")
        if moment > len(joints) / fps:
            raise InvalidInputError(f"the clip of a keyframe has {len(joints) / fps:g} s and no pose at {moment:g} s")
        frame = min(round(moment * fps), len(joints) - 1)
        return cls(moment if at is None else at, joints[frame], weight, anywhere)

    @classmethod
    def from_rotations(
        cls,
        seconds: float,
        rotations: object,
        root: object,
        rest_offsets: object = None,
        *,
        weight: float = 1.0,
        anywhere: bool = False,
    ) -> Keyframe:
        """Pose the body by the rotations of its joints (`motion.kinematics.forward_kinematics`).

        Args:
            seconds: from the start of the clip.
            rotations: (22, 4) quaternions w, x, y, z, or (22, 3, 3) matrices, each relative to the joint's parent; of a
                T-pose they are the identity. Those of a frame of a `.json` clip are such.
            root: (3,) metres, where the pelvis is.
            rest_offsets: (22, 3) metres, each joint from its parent in the T-pose; None is the body of the default
                bundle. With other bones no motion of a bundle can be in the pose to the millimetre.
            weight, anywhere: see the fields.

        Raises:
            InvalidInputError: another shape, not finite, or no rotations.
        """
        turns = check_rotations(rotations, "the rotations of a keyframe", JOINTS)
        place = check_pose(root, "the root of a keyframe", (3,), "(3,)")
        offsets = REST_OFFSETS
        if rest_offsets is not None:
            offsets = check_pose(rest_offsets, "the rest_offsets of a keyframe", (JOINTS, 3), f"({JOINTS}, 3)")
        joints = forward_kinematics(offsets, place[None], turns[None])[0]
        return cls(seconds, joints.astype(np.float32), weight, anywhere)


@dataclass(frozen=True, eq=False)
class StartPose:
    """Let the clip begin as another one ended, velocity included.

    Raises:
        InvalidInputError: naming the value.
    """

    joints: FloatArray
    """(frames, 22, 3) metres, the first frames of the clip; given a clip, its last 0.2 s. A read-only copy."""
    weight: float = 1.0
    """0 to 100."""
    fps: float | None = None
    """Frames per second of `joints`; None is that of the clip that is made."""

    def __post_init__(self) -> None:
        _set_pose(self, "a start pose", ending=True)

    def frames(self, fps: float) -> FloatArray:
        """Resample to the rate of the clip that is made; see `_placed_pose`.

        Returns:
            (frames, 22, 3) metres; the first frame is above the origin and faces +Z.
        """
        return _placed_pose(self.joints, self.fps, fps, 0)


@dataclass(frozen=True, eq=False)
class EndPose:
    """Let the clip end as another one begins, velocity included, wherever on the floor that is.

    For a place, add a `Waypoint` at the end.

    Raises:
        InvalidInputError: naming the value.
    """

    joints: FloatArray
    """(frames, 22, 3) metres, the last frames of the clip; given a clip, its first 0.2 s. A read-only copy."""
    weight: float = 1.0
    """0 to 100."""
    fps: float | None = None
    """Frames per second of `joints`; None is that of the clip that is made."""

    def __post_init__(self) -> None:
        _set_pose(self, "an end pose", ending=False)

    def frames(self, fps: float) -> FloatArray:
        """Resample to the rate of the clip that is made; see `_placed_pose`.

        Returns:
            (frames, 22, 3) metres; the last frame is above the origin and faces +Z.
        """
        return _placed_pose(self.joints, self.fps, fps, -1)


@dataclass(frozen=True)
class Loop:
    """Let the clip end in the pose and with the velocity that it begins with, wherever on the floor that is."""

    weight: float = 1.0
    """0 to 100."""

    def __post_init__(self) -> None:
        _set(self, weight=check_weight(self.weight, "a loop"))


Constraint = Path | Waypoint | JointTarget | Keyframe | StartPose | EndPose | Loop
KINDS: Final = (Path, Waypoint, JointTarget, Keyframe, StartPose, EndPose, Loop)


@dataclass(frozen=True)
class Miss:
    """How far a clip is from a constraint."""

    what: str
    """The constraint in a few words, see `describe`."""
    metres: float
    """Mean over the frames and joints that it names."""
    worst: float
    """Largest of them, metres."""
    degrees: float | None = None
    """Mean error of the heading, if it names one."""

    def to_dict(self) -> dict[str, Any]:
        """Convert to plain values for JSON."""
        return {"what": self.what, "metres": self.metres, "worst": self.worst, "degrees": self.degrees}

    @staticmethod
    def from_dict(value: object) -> Miss:
        """Read what `to_dict` wrote.

        Raises:
            InvalidInputError: it is something else.
        """
        keys = ("what", "metres", "worst", "degrees")
        if not isinstance(value, dict) or set(value) != set(keys):
            raise InvalidInputError(f"a miss must be an object with the keys {', '.join(keys)}")
        what, *numbers = (value[key] for key in keys)
        metres, worst, degrees = map(finite_number, numbers)
        if not isinstance(what, str) or metres is None or worst is None or (degrees is None) != (numbers[2] is None):
            raise InvalidInputError(f"a miss must name what was missed, and by how much, not {short_repr(what)}")
        return Miss(what, metres, worst, degrees)


def describe(constraint: Constraint) -> str:
    """Name a constraint in a few words: "left_wrist at 2 s"."""
    match constraint:
        case Path():
            return f"path of {constraint.length:.2g} m"
        case Waypoint():
            return f"waypoint at {constraint.seconds:g} s"
        case JointTarget():
            begin, end = constraint.interval
            return (
                f"{constraint.joint} at {begin:g} s"
                if begin == end
                else f"{constraint.joint} from {begin:g} to {end:g} s"
            )
        case Keyframe():
            return f"keyframe at {constraint.seconds:g} s"
        case StartPose():
            return "start pose"
        case EndPose():
            return "end pose"
        case Loop():
            return "loop"


def joint_name(name: object) -> str:
    """Return the name of a joint in `motion.skeleton.JOINT_NAMES` for one as people write it.

    Raises:
        InvalidInputError: no joint has that name.
    """
    written = name.strip().lower().replace(" ", "_").replace("-", "_") if isinstance(name, str) else ""
    joint = ALIASES.get(written, written)
    if joint not in JOINT_INDEX:
        allowed = ", ".join([*ALIASES, *JOINT_INDEX])
        raise InvalidInputError(f"there is no joint {short_repr(name)}; the joints are {allowed}")
    return joint


def _set(constraint: object, **fields: object) -> None:
    """Set fields of a frozen dataclass while it is made."""
    for name, value in fields.items():
        object.__setattr__(constraint, name, value)


def pose_frames(fps: float) -> int:
    """Return the frames of a clip that make its start or end pose."""
    return max(1, round(POSE_SECONDS * fps))


def latest_moment(constraint: Constraint) -> float:
    """Return the last second that a constraint names; 0 for those that name none."""
    match constraint:
        case Waypoint() | Keyframe():
            return constraint.seconds
        case JointTarget():
            return constraint.interval[1]
        case Path() if constraint.times is not None:
            return float(constraint.times[-1])
    return 0.0


def _set_pose(pose: StartPose | EndPose, what: str, *, ending: bool) -> None:
    """Check the fields of a start or end pose; of a clip, keep the frames that count."""
    joints: object = pose.joints
    if hasattr(joints, "fps"):
        joints, fps = _motion(joints, what)
        count = min(len(joints), pose_frames(fps))
        joints = joints[-count:] if ending else joints[:count]
        _set(pose, fps=fps)
    shape = f"(frames, {JOINTS}, 3), or it is a clip"
    frames = check_pose(joints, f"the joints of {what}", (-1, JOINTS, 3), shape)
    if not 1 <= len(frames) <= MAX_POSE_FRAMES:
        raise InvalidInputError(f"{what} has 1 to {MAX_POSE_FRAMES} frames, not {len(frames)}; use fewer, or a clip")
    if pose.fps is not None:
        check_fps(pose.fps)
    _set(pose, joints=frames, weight=check_weight(pose.weight, what))


def _motion(clip: object, what: str) -> tuple[FloatArray, float]:
    """Read joints and frame rate of a clip.

    Raises:
        InvalidInputError: it has none, or those of another skeleton.
    """
    joints, fps = getattr(clip, "joints", None), getattr(clip, "fps", None)
    if joints is None or fps is None:
        raise InvalidInputError(
            f"{what} is taken from a Clip, not from {short_repr(clip)}; read a file with kinegraph.formats.read"
        )
    check_fps(fps)
    return check_pose(joints, f"the clip of {what}", (-1, JOINTS, 3), f"(frames, {JOINTS}, 3)"), float(fps)


def _placed_pose(joints: FloatArray, own_fps: float | None, fps: float, anchor: int) -> FloatArray:
    """Resample frames and bring them above the origin, facing +Z at frame `anchor`; heights stay.

    Args:
        joints: (frames, 22, 3) metres.
        own_fps: their frames per second; None is `fps`.
        fps: wanted.
        anchor: index of the frame that is placed.
    """
    if own_fps is not None and own_fps != fps and len(joints) > 1:
        joints = resample(joints, own_fps, fps)
    return BodyFrame.of(joints[anchor]).to_body(joints).astype(np.float32)
