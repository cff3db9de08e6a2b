"""`kinegraph retarget`, and `--character` of the commands that make clips: clips on a user's character."""

from __future__ import annotations

import argparse
import time
from pathlib import Path
from typing import TYPE_CHECKING

from kinegraph.cli.console import as_json
from kinegraph.errors import InvalidInputError

# Modules that load numpy are imported where they are used: `--help` must be instant.
if TYPE_CHECKING:
    from kinegraph.formats.character import Character


def retarget(args: argparse.Namespace) -> int:
    """Run `kinegraph retarget`: put a saved clip on a character."""
    from kinegraph.files import check_target
    from kinegraph.formats import read

    start = time.perf_counter()
    character = load_character(args.character, args.map)
    check_target(args.output, args.force, (character.suffix,))
    clip = read(args.clip)
    clip = clip.in_place() if args.in_place else clip
    shown = clip.onto(character, fps=character_fps(args.fps), root=args.root)
    shown.save(args.output, force=args.force)
    record = {
        "file": str(args.output),
        "frames": shown.frames,
        "scale": shown.motion().scale,
        "fps": shown.fps,
        "rig": character.humanoid.found_by,
        "bones": {joint: character.rig.names[node] for joint, node in character.humanoid.bones.items()},
        "spine": [character.rig.names[node] for node in character.humanoid.spine],
        "total_ms": round(1000 * (time.perf_counter() - start), 1),
    }
    if args.json:
        print(as_json(record))
    else:
        print(f"{record['file']}: {record['frames']} frames at {shown.fps:g} per second; rig: {record['rig']}")
    return 0


def load_character(path: Path, names: Path | None) -> Character:
    """Read a character, with the joints of a map where there is one.

    Raises:
        InvalidInputError: see `formats.character.read_character` and `character_files.read_names`.
    """
    from kinegraph.formats.character import read_character
    from kinegraph.formats.character_files import read_names

    return read_character(path, None if names is None else read_names(names))


def character_fps(fps: float | None) -> float:
    """Return the frame rate of a character's animation: what was asked for, or 30."""
    from kinegraph.formats.character import DEFAULT_FPS

    return DEFAULT_FPS if fps is None else fps


def check_character(args: argparse.Namespace) -> None:
    """Refuse options that do not fit `--character`, before anything is computed.

    Raises:
        InvalidInputError: another format than the character's, a naming convention, or `--map` alone.
    """
    if args.character is None:
        if args.map is not None:
            raise InvalidInputError("--map names the joints of a --character; give both")
        return
    suffix = ".bvh" if args.character.suffix.lower() == ".bvh" else ".glb"
    if args.output.suffix.lower() != suffix:
        raise InvalidInputError(f"a clip on {str(args.character)!r} is saved as {suffix}, not as {str(args.output)!r}")
    if args.names != "smpl":
        raise InvalidInputError("--names is for our own skeleton; a --character keeps the names of its joints")
