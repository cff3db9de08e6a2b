"""`Clip`: a motion as joints over time, with everything needed to generate it again."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from kinegraph.arrays import FloatArray
from kinegraph.errors import InvalidInputError
from kinegraph.files import suffix_of, write_atomically
from kinegraph.graph import SemanticGraph
from kinegraph.motion.blending import make_loop
from kinegraph.motion.resampling import in_place, resample
from kinegraph.motion.skeleton import DEFAULT_NAMES, JOINTS
from kinegraph.unknown import Unknown
from kinegraph.validation import check_flag, check_fps, short_repr

if TYPE_CHECKING:
    from kinegraph.constraints import Miss
    from kinegraph.formats.character import Character, CharacterClip


@dataclass(frozen=True, eq=False)
class Clip:
    """A motion of the 22-joint body of `motion.skeleton`.

    Raises:
        InvalidInputError: a field has the wrong shape or type, or a joint is not finite.
    """

    joints: FloatArray
    """(frames, 22, 3) metres, Y up, floor y = 0; starts at the origin facing +Z; a read-only copy."""

    fps: float
    """Frames per second, 1 to 240."""

    seed: int
    """Seed of the noise it was generated from."""

    text: str
    """Caption it was generated for."""

    bundle: str
    """Name and version of the bundle that generated it."""

    graph: SemanticGraph | None = None
    """Semantic graph it was generated from, edits included; None where there was none, or more than one."""

    loops: bool = False
    """True for a loop, whose last frame equals the first but for travel; `.bvh` does not store it."""

    unknown: tuple[Unknown, ...] = ()
    """Words of the text that the bundle was never shown; a bundle without `vocabulary.npz` finds none."""

    notes: tuple[str, ...] = ()
    """What of the text could not be honoured, a sentence each."""

    misses: tuple[Miss, ...] = ()
    """How far the clip is from each constraint that it was made under, in their order; `.npz` and `.json` store it."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "joints", _validate_joints(self.joints))
        check_fps(self.fps)
        whole = isinstance(self.seed, int | np.integer) and not isinstance(self.seed, bool)
        if not whole or not 0 <= self.seed < 2**63:
            raise InvalidInputError(f"seed is {short_repr(self.seed)}; it must be a whole number from 0 to 2**63 - 1")
        _validate_strings(text=self.text, bundle=self.bundle)
        check_flag(self.loops, "loops")
        if not isinstance(self.graph, SemanticGraph | None):
            raise InvalidInputError(f"graph is of type {type(self.graph).__name__}; it must be a SemanticGraph or None")
        if not isinstance(self.unknown, tuple) or not all(isinstance(words, Unknown) for words in self.unknown):
            raise InvalidInputError(f"unknown is {short_repr(self.unknown)}; it must be a tuple of Unknown")
        if not isinstance(self.notes, tuple):
            raise InvalidInputError(f"notes is of type {type(self.notes).__name__}; it must be a tuple of strings")
        _validate_strings(**{f"notes[{index}]": note for index, note in enumerate(self.notes)})
        if not isinstance(self.misses, tuple) or self.misses:
            _validate_misses(self.misses)
        object.__setattr__(self, "fps", float(self.fps))
        object.__setattr__(self, "seed", int(self.seed))

    @property
    def frames(self) -> int:
        """Number of frames."""
        return len(self.joints)

    @property
    def duration(self) -> float:
        """Seconds; every frame is shown for 1 / fps."""
        return self.frames / self.fps

    @property
    def shown(self) -> FloatArray:
        """Frames of a moving picture, each shown for 1 / fps: all but the one that closes a loop."""
        return self.joints[:-1] if self.loops and self.frames > 1 else self.joints

    def resampled(self, fps: float) -> Clip:
        """Resample to another frame rate; see `motion.resampling.resample`.

        Args:
            fps: frames per second, 1 to 240.

        Raises:
            InvalidInputError: not a frame rate.
        """
        check_fps(fps)
        joints = resample(self.joints, self.fps, float(fps), loops=self.loops)
        return replace(self, joints=joints, fps=float(fps))

    def in_place(self) -> Clip:
        """Remove travel over the floor, for games that move the character themselves.

        To get a loop in place, call `looped` first: a loop then also ends facing where it began. How far the clip is
        from constraints (`misses`) does not hold for it any more, and is left out.
        """
        return replace(self, joints=in_place(self.joints, loops=self.loops), misses=())

    def looped(self, *, foot_fix: bool = True) -> Clip:
        """Cut and blend the clip into a loop; see `motion.blending.make_loop`.

        The last frame is the first again, one round later, as animation programs, engines and glTF players expect: a
        round takes (frames - 1) / fps seconds. `.gif` and `.mp4`, which show every frame, leave it out. It begins at
        another frame and place, so `misses` are left out.

        Args:
            foot_fix: lock planted feet, also over the seam.

        Raises:
            InvalidInputError: fewer than 8 frames.
        """
        check_flag(foot_fix, "foot_fix")
        return replace(self, joints=make_loop(self.joints, self.fps, foot_fix=foot_fix), loops=True, misses=())

    def onto(
        self,
        character: str | os.PathLike[str] | Character,
        *,
        fps: float = 30.0,
        root: bool = False,
        names: Mapping[str, str] | None = None,
    ) -> CharacterClip:
        """Retarget the clip to a character; see `motion.retargeting`.

        Args:
            character: `.glb`, `.gltf` or `.vrm` file with a skinned human, `.bvh` skeleton, or what
                `formats.character.read_character` made of it.
            fps: keys per second, 1 to 240.
            root: let the joint above the character's pelvis carry travel and heading, as engines expect for root
                motion. To leave travel to the game, call `in_place` first.
            names: joint of `motion.skeleton.JOINT_NAMES` -> name of the character's joint, for joints that are not
                found by themselves.

        Returns:
            What `save` writes as `.glb`: the character's file with the clip as one more animation. On a BVH skeleton
            it writes a `.bvh` with the skeleton's own joints and channels.

        Raises:
            InvalidInputError: not a frame rate, or the file cannot be used; see `formats.character.read_character`.
        """
        from kinegraph.formats.character import Character, onto, read_character

        known = character if isinstance(character, Character) else read_character(character, names)
        return onto(self, known, fps, root)

    def save(
        self, path: str | os.PathLike[str], *, force: bool = False, names: str = DEFAULT_NAMES, root: bool = False
    ) -> None:
        """Write a file; its suffix chooses the format (`formats.WRITERS`).

        The file appears complete or not at all.

        Args:
            path: file to write, in a folder that exists.
            force: replace an existing file.
            names: naming convention of the joints in `.bvh` and `.glb`: "smpl" or "mixamo".
            root: in `.bvh` and `.glb`, add a joint "root" on the floor, above the pelvis, that carries travel and
                heading, as engines expect for root motion.

        Raises:
            InvalidInputError: unknown naming convention, or the format has no convention or no root joint.
            OutputError: the file cannot be written there; see `files.check_target`.
            MissingExtraError: the format needs a package that is not installed.
        """
        # imported here because formats know clips, not the other way round
        from kinegraph.formats import WRITERS, check_clip_target, encode

        check_flag(force, "force")
        check_flag(root, "root")
        check_clip_target(path, force)
        write_atomically(path, encode(self, suffix_of(path, WRITERS), names, root), force=force)


def _validate_strings(**values: object) -> None:
    """Refuse what is no string, or holds half a surrogate pair, by the name of the field."""
    for name, value in values.items():
        if not isinstance(value, str):
            raise InvalidInputError(f"{name} is {short_repr(value)}; it must be a string")
        if any("\ud800" <= character <= "\udfff" for character in value):
            raise InvalidInputError(f"{name} holds half a surrogate pair, which is no text")


def _validate_misses(misses: object) -> None:
    """Refuse misses that are none; the type is loaded only where there are any."""
    from kinegraph.constraints import Miss

    if not isinstance(misses, tuple) or not all(isinstance(miss, Miss) for miss in misses):
        raise InvalidInputError(f"misses is {short_repr(misses)}; it must be a tuple of Miss")


def _validate_joints(joints: object) -> FloatArray:
    """Copy joints to a read-only array, or refuse them.

    Raises:
        InvalidInputError: not real numbers, another shape, or not finite.
    """
    if not isinstance(joints, np.ndarray | list | tuple):
        raise InvalidInputError(f"joints must be an array, not {short_repr(joints)}")
    try:
        array = np.asarray(joints)
    except ValueError as error:
        raise InvalidInputError(f"joints are no array of numbers ({error})") from error
    if array.dtype.kind not in "fiu":
        raise InvalidInputError(f"joints have type {array.dtype}; they must be real numbers")
    if array.ndim != 3 or array.shape[1:] != (JOINTS, 3) or len(array) == 0:
        allowed = f"(frames, {JOINTS}, 3) with at least one frame"
        raise InvalidInputError(f"joints have shape {array.shape}; it must be {allowed}")
    with np.errstate(over="ignore"):
        copy = np.array(array, dtype=np.float32)
    if not np.isfinite(copy).all():
        frame, joint, _ = np.argwhere(~np.isfinite(copy))[0]
        raise InvalidInputError(f"joint {joint} of frame {frame} is not finite; joints must be finite metres")
    copy.flags.writeable = False
    return copy
