"""Read AMASS from its folder: SMPL-H or SMPL-X parameters in `.npz`, and captions in a file of the caller's.

    CMU/01/01_01_poses.npz       poses (frames, 156 or 165), trans, betas, gender, mocap_framerate; Z up, metres

Joints come from the body models that the caller downloaded (`smpl_body`). Files without a caption are left out: AMASS
has none of its own.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Final

import numpy as np

from kinegraph.arrays import Floats
from kinegraph.errors import InvalidInputError
from kinegraph.motion.skeleton import JOINT_NAMES, JOINTS
from kinegraph_training.data.captions_file import read_captions
from kinegraph_training.data.folder import PreparedClip, assign_splits
from kinegraph_training.data.recording import MAX_FPS, MIN_FPS, Recording, check_size
from kinegraph_training.data.smpl_body import GENDERS, SmplBody, find_model, read_body
from kinegraph_training.data.timeline import Stretch, cut_recording
from kinegraph_training.data.understanding import Stated, understand

FPS: Final = 20.0
"""Of prepared clips."""
WIDTHS: Final = {156: "smplh", 165: "smplx"}
"""Columns of `poses` -> body model."""
_SUFFIX: Final = re.compile(r"\.npz$", re.IGNORECASE)


@dataclass(frozen=True)
class AmassRecording:
    """One file, to be converted."""

    name: str
    """Path below the folder, without suffix."""
    path: Path
    split: str
    captions: tuple[str, ...]
    models: Path


def find_files(folder: Path, captions: Path, models: Path, *, val: float, test: float) -> list[AmassRecording]:
    """List the files that have captions; reads no motion.

    Args:
        folder: of AMASS, searched with its subfolders.
        captions: captions file (`captions_file.read_captions`); files are named by their path below the folder.
        models: folder of the body models.
        val: share of the files for model selection.
        test: share of the files for a test.

    Raises:
        InvalidInputError: no folder, or captions of a file that is not there; the message names them.
    """
    for place, option in ((folder, "--amass"), (models, "--body-models")):
        if not place.is_dir():
            raise InvalidInputError(f"{place} is no folder; {option} must name one")
    texts: dict[str, tuple[str, ...]] = {}
    for name, told in read_captions(captions).items():
        plain = _SUFFIX.sub("", name.replace("\\", "/").removeprefix("./"))
        texts[plain] = (*texts.get(plain, ()), *told)
    lost = [name for name in texts if ".." in name.split("/") or not (folder / f"{name}.npz").is_file()]
    if lost:
        more = f" and {len(lost) - 10} more" if len(lost) > 10 else ""
        raise InvalidInputError(f"captions without a file below {folder}: {', '.join(lost[:10])}{more}")
    splits = assign_splits(sorted(texts), val=val, test=test)
    return [AmassRecording(name, folder / f"{name}.npz", splits[name], texts[name], models) for name in sorted(texts)]


def read_amass(recording: AmassRecording) -> list[PreparedClip]:
    """Read a file and cut it into clips.

    Raises:
        InvalidInputError: the file or its body model cannot be used, or no caption describes each window of it.
    """
    names = {name: name for name in JOINT_NAMES}
    try:
        motion = understand(
            read_parameters(recording.path, recording.models), Stated(scale=1.0, joint_sources=names), FPS
        )
    except InvalidInputError as error:
        raise InvalidInputError(f"{recording.path}: {error}") from error
    whole = Stretch(0.0, 0.0, recording.captions)
    clips = cut_recording(recording.name, motion.joints, [whole], f"{recording.name}.npz", recording.split, FPS)
    if not clips:
        raise InvalidInputError(
            f"{recording.path}: {len(motion.joints) / FPS:.1f} s are too short, or so long that it is cut, and no "
            "caption describes each part: add one without order, number or end"
        )
    return clips


def read_parameters(path: Path, models: Path) -> Recording:
    """Read a file of AMASS as joints at its own frame rate; between frames they are interpolated linearly.

    Raises:
        InvalidInputError: no file of AMASS, or its body model is not there.
    """
    try:
        with np.load(path, allow_pickle=False) as stored:
            arrays = {name: np.asarray(stored[name]) for name in stored.files if stored[name].dtype != object}
    except (OSError, ValueError, EOFError) as error:
        raise InvalidInputError(f"it cannot be read as .npz without pickle ({error})") from error
    missing = [name for name in ("poses", "trans", "betas", "gender") if name not in arrays]
    if missing:
        raise InvalidInputError(f"it lacks {', '.join(missing)}; motion of AMASS has them (shape.npz is no motion)")
    poses, trans = arrays["poses"].astype(np.float64), arrays["trans"].astype(np.float64)
    if poses.ndim != 2 or poses.shape[1] not in WIDTHS or trans.shape != (len(poses), 3):
        widths = " or ".join(f"{width} ({kind})" for width, kind in WIDTHS.items())
        raise InvalidInputError(f"poses have shape {poses.shape} and trans {trans.shape}; poses have {widths} columns")
    check_size(len(poses), JOINTS, "the file has")
    if not (np.isfinite(poses).all() and np.isfinite(trans).all()):
        raise InvalidInputError("poses or trans hold NaN or infinity")
    body = _body(models, WIDTHS[poses.shape[1]], _gender(arrays))
    shape = np.atleast_1d(arrays["betas"].astype(np.float64)).ravel()
    joints = body.joints(shape, poses[:, : 3 * JOINTS].reshape(-1, JOINTS, 3), trans)
    return Recording(
        names=JOINT_NAMES,
        frames=len(joints),
        fps=_frame_rate(arrays),
        sample=lambda t: _interpolated(joints, t),
        up="z",
    )


@lru_cache(maxsize=8)
def _body(models: Path, kind: str, gender: str) -> SmplBody:
    return read_body(find_model(models, kind, gender))


def _gender(arrays: Mapping[str, np.ndarray]) -> str:
    """Return the gender that the file says; some say it in bytes."""
    value = arrays["gender"].item()
    gender = (value.decode("ascii", errors="replace") if isinstance(value, bytes) else str(value)).lower()
    if gender not in GENDERS:
        raise InvalidInputError(f"gender is {gender[:40]!r}; it must be one of {', '.join(GENDERS)}")
    return gender


def _frame_rate(arrays: Mapping[str, np.ndarray]) -> float:
    """Return the frame rate; SMPL-H and SMPL-X files spell it differently."""
    name = next((name for name in ("mocap_framerate", "mocap_frame_rate") if name in arrays), None)
    fps = float(arrays[name].item()) if name else 0.0
    if not MIN_FPS <= fps <= MAX_FPS:
        raise InvalidInputError(f"mocap_framerate is {fps:g}; it must be {MIN_FPS:g} to {MAX_FPS:g} frames per second")
    return fps


def _interpolated(joints: Floats, times: Floats) -> Floats:
    before = np.floor(times).astype(np.int64)
    after = np.minimum(before + 1, len(joints) - 1)
    share = (times - before)[:, None, None]
    return np.asarray(joints[before] + share * (joints[after] - joints[before]))
