"""`.json`: the clip as text that any language can read.

Holds what `.npz` holds, and the solved skeleton:

    joints          (frames, 22, 3) metres, Y up
    parents         (22,) indices, -1 for the root
    rest_offsets    (22, 3) metres from the parent in a T-pose
    rotations       (frames, 22, 4) quaternions w, x, y, z relative to the parent; the root is at joint 0
    seed            a string, because JavaScript's integers end at 2**53
    unknown         words that the bundle was never shown: objects of text, start, end, nearest, reason
    notes           strings: what of the text could not be honoured
    misses          how far the clip is from its constraints: objects of what, metres, worst, degrees
"""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import NDArray

from kinegraph.errors import InvalidInputError
from kinegraph.formats.npz import read_misses
from kinegraph.motion.kinematics import rotations_from_positions
from kinegraph.motion.skeleton import JOINT_NAMES, PARENTS
from kinegraph.unknown import Unknown, read_list

if TYPE_CHECKING:
    from kinegraph.clip import Clip

DIGITS: Final = 5
"""Decimal places: a hundredth of a millimetre, a thousandth of a degree."""


def encode(clip: Clip) -> bytes:
    """Encode a clip as JSON in UTF-8; equal clips give equal bytes."""
    motion = rotations_from_positions(clip.joints, clip.fps, loops=clip.loops)
    document = {
        "text": clip.text,
        "seed": str(clip.seed),
        "bundle": clip.bundle,
        "unknown": [words.to_dict() for words in clip.unknown],
        "notes": clip.notes,
        "misses": [miss.to_dict() for miss in clip.misses],
        "fps": clip.fps,
        "joint_names": JOINT_NAMES,
        "parents": PARENTS,
        "rest_offsets": _rounded(motion.rest_offsets),
        "joints": _rounded(clip.joints),
        "rotations": _rounded(motion.rotations),
    } | ({"loops": True} if clip.loops else {})
    return json.dumps(document, ensure_ascii=False, separators=(",", ":")).encode()


def decode(data: bytes) -> dict[str, Any]:
    """Decode a file into the fields of its clip; the skeleton is solved again from the joints.

    Raises:
        InvalidInputError: not a JSON file that `encode` could have written.
    """
    # lists that hold next to nothing would take twenty times the memory of their text
    if data.count(b"[") + data.count(b"{") > len(data) / 10 + 100_000:
        raise InvalidInputError("it holds more lists than numbers")
    try:
        document = json.loads(data)
        if tuple(document["joint_names"]) != JOINT_NAMES:
            raise InvalidInputError(f"it has other joints; kinegraph reads {', '.join(JOINT_NAMES)}")
        joints = np.array(document["joints"], dtype=np.float64)
        fields = {name: document[name] for name in ("text", "bundle", "fps")}
        # files of older versions have none of the three
        unknown, notes, misses = (read_list(document.get(name, []), name) for name in ("unknown", "notes", "misses"))
        fields |= {"unknown": tuple(map(Unknown.from_dict, unknown)), "notes": tuple(notes)}
        fields |= {"misses": read_misses(misses), "loops": document.get("loops", False)}
        return {"joints": joints, "seed": parse_seed(document["seed"]), **fields}
    except KeyError as error:
        raise InvalidInputError(f"it has no {error}") from error
    except InvalidInputError:
        raise
    except (ValueError, TypeError, OverflowError, RecursionError) as error:
        raise InvalidInputError(str(error)[:200]) from error


def parse_seed(text: object) -> int:
    """Convert a seed from the string that files store it as.

    Raises:
        InvalidInputError: not a string of digits.
    """
    if not isinstance(text, str) or not (text.isascii() and text.isdigit() and len(text) < 20):
        raise InvalidInputError("its seed is no whole number in quotes")
    return int(text)


def _rounded(values: NDArray[Any]) -> Any:
    """Convert an array to nested lists of rounded numbers."""
    # adding 0.0 turns -0.0 into 0.0
    return (np.round(values.astype(np.float64), DIGITS) + 0.0).tolist()
