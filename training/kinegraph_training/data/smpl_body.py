"""Joints of the SMPL family from the caller's body model: SMPL-H and SMPL-X in `.npz`.

M. Loper et al., *SMPL: A Skinned Multi-Person Linear Model*, 2015: the joints of a shape are
J(beta) = R (T + B_S(beta)) (Eq. 8 and 10), with the template T, the shape blend shapes B_S and the joint regressor R;
a pose turns them along the kinematic tree (Eq. 4). Skin needs more than this; joints do not, so neither torch nor the
package smplx is needed.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from kinegraph.arrays import Floats
from kinegraph.errors import InvalidInputError
from kinegraph.motion.quaternions import multiply, rotate
from kinegraph.motion.skeleton import JOINTS

KINDS: Final = ("smplh", "smplx")
GENDERS: Final = ("neutral", "male", "female")
_ARRAYS: Final = ("J_regressor", "v_template", "shapedirs", "kintree_table")


@dataclass(frozen=True)
class SmplBody:
    """What of a body model its joints need. The first 22 joints of SMPL-H and SMPL-X are those of kinegraph."""

    template: Floats
    """(22, 3) metres: joints of the mean shape."""
    shapes: Floats
    """(22, 3, b): what a unit of each shape parameter adds."""
    parents: tuple[int, ...]
    """-1 for the pelvis."""

    def joints(self, shape: Floats, rotations: Floats, root: Floats) -> Floats:
        """Pose the joints.

        Args:
            shape: (b',) parameters; as many as the model has are used.
            rotations: (frames, 22, 3) axis times angle, relative to the parent.
            root: (frames, 3) metres, added to the pelvis of the shape.

        Returns:
            (frames, 22, 3) metres, in the axes of `root`.
        """
        count = min(len(shape), self.shapes.shape[-1])
        rest = self.template + self.shapes[..., :count] @ shape[:count]
        local = from_axis_angle(rotations)
        places, turns = np.empty(rotations.shape), np.empty(local.shape)
        for joint, parent in enumerate(self.parents):
            if parent < 0:
                places[:, joint], turns[:, joint] = rest[joint] + root, local[:, joint]
                continue
            offset = np.broadcast_to(rest[joint] - rest[parent], root.shape)
            places[:, joint] = places[:, parent] + rotate(turns[:, parent], offset)
            turns[:, joint] = multiply(turns[:, parent], local[:, joint])
        return places


def from_axis_angle(vectors: Floats) -> Floats:
    """Convert axis times angle (..., 3) in radians to quaternions (..., 4), w first."""
    angle = np.linalg.norm(vectors, axis=-1, keepdims=True)
    # sin(a / 2) / a, which is 1/2 at 0
    share = 0.5 * np.sinc(angle / (2 * np.pi))
    return np.concatenate([np.cos(angle / 2), share * vectors], axis=-1)


def find_model(folder: Path, kind: str, gender: str) -> Path:
    """Find the file of a body model in a folder laid out as the models are published, or as the package smplx wants.

    Raises:
        InvalidInputError: it is not there; the message says which files would do.
    """
    upper = f"{kind.upper()}_{gender.upper()}"
    names = (f"{kind}/{upper}.npz", f"{kind}/{gender}/model.npz", f"{upper}.npz", f"{gender}/model.npz")
    for name in names:
        if (folder / name).is_file():
            return folder / name
    pickles = [name.replace(".npz", ".pkl") for name in names]
    if any((folder / name).is_file() for name in pickles):
        raise InvalidInputError(
            f"{folder} has the body model {kind}, {gender} as .pkl, which runs code when it is read; download the .npz "
            "of the same model (for SMPL-H the extended model of the AMASS page)"
        )
    raise InvalidInputError(
        f"{folder} lacks the body model {kind}, {gender}: {' or '.join(names)}; download it from the models' page "
        f"({kind.replace('smplh', 'mano').replace('smplx', 'smpl-x')}.is.tue.mpg.de)"
    )


def read_body(path: Path) -> SmplBody:
    """Read a body model.

    Raises:
        InvalidInputError: no body model, or one of another layout.
    """
    try:
        with np.load(path, allow_pickle=False) as stored:
            missing = [name for name in _ARRAYS if name not in stored]
            if missing:
                raise InvalidInputError(f"{path} lacks {', '.join(missing)}; it is no body model of SMPL-H or SMPL-X")
            regressor, template, shapes, tree = (np.asarray(stored[name]) for name in _ARRAYS)
    except (OSError, ValueError, EOFError) as error:
        if isinstance(error, InvalidInputError):
            raise
        raise InvalidInputError(f"{path} cannot be read as a body model: {error}") from error
    vertices = len(template)
    right = regressor.ndim == 2 and len(regressor) >= JOINTS and regressor.shape[1] == vertices
    if not right or template.shape != (vertices, 3) or shapes.shape[:2] != (vertices, 3) or tree.shape[1] < JOINTS:
        raise InvalidInputError(f"{path} has arrays of other shapes than a body model of SMPL-H or SMPL-X")
    regressor = regressor[:JOINTS].astype(np.float64)
    parents = (-1, *(int(parent) for parent in tree[0, 1:JOINTS]))
    if any(not 0 <= parent < joint for joint, parent in enumerate(parents[1:], start=1)):
        raise InvalidInputError(f"{path}: kintree_table is no tree with parents before children")
    return SmplBody(
        template=regressor @ template,
        shapes=np.einsum("jv,vcb->jcb", regressor, shapes.astype(np.float64)),
        parents=parents,
    )
