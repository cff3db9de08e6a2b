"""Combine data folders into one: one body for all clips, one name for each action.

    python -m kinegraph_training.combine --data DATA/cmu --data DATA/open --without-source iclone --out data/open

Every clip is brought to one skeleton (`data.common_skeleton`), its label to the action table's name for it
(`synthetic/actions.toml`). Splits stay. Each row of the index says which folder and source the clip came from and under
which licence, so that a model can say what it was made from.
"""

from __future__ import annotations

import argparse
import sys
from collections import Counter, defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

from kinegraph.errors import InvalidInputError, KinegraphError
from kinegraph.motion.skeleton import start_at_origin
from kinegraph_training.data.clips import IN_ORDER, MotionClip, read_jsonl, read_split, split_label
from kinegraph_training.data.common_skeleton import rest_directions, to_common_skeleton
from kinegraph_training.data.folder import pack_clips, to_json_lines, write_files
from kinegraph_training.synthetic.action_table import ActionTable, read_action_table

LABEL_KEYS: Final = ("content", "label")
"""Keys of index.jsonl that may name the action, the first that is there."""
KEPT: Final = ("attr", "distance_m", "group", "net_turn_deg", "overlap_group", "take", "windows")
"""Keys of index.jsonl that are carried over."""


@dataclass(frozen=True)
class SourceClip:
    """Clip with the row of the index that it came with."""

    clip: MotionClip
    split: str
    row: Mapping[str, Any]
    folder: str

    @property
    def body(self) -> tuple[str, str, str]:
        """Key of its skeleton: clips of one source were solved for one body."""
        return self.folder, str(self.row.get("source", "")), str(self.row.get("skeleton", ""))


def combine(folders: Sequence[Path], out: Path, table: ActionTable, without: Iterable[str] = ()) -> list[SourceClip]:
    """Read, convert and write the clips of all folders.

    Args:
        folders: data folders.
        out: folder to write.
        table: names of actions.
        without: sources (`source` in index.jsonl) to leave out.

    Returns:
        The clips as they were written.

    Raises:
        InvalidInputError: a folder lacks a file, or two clips have one id.
        OutputError: `out` cannot be written.
    """
    clips = [clip for folder in folders for clip in read_folder(folder) if clip.row.get("source") not in set(without)]
    counts = Counter(clip.clip.id for clip in clips)
    if twice := [name for name, count in counts.items() if count > 1]:
        raise InvalidInputError(f"{len(twice)} ids occur in two folders, first {twice[0]!r}; rename the clips of one")
    bodies: defaultdict[tuple[str, str, str], list[SourceClip]] = defaultdict(list)
    for clip in clips:
        bodies[clip.body].append(clip)
    rests = {body: rest_directions([each.clip.joints for each in members]) for body, members in bodies.items()}
    converted = [convert(clip, rests[clip.body], table) for clip in clips]
    write_combined(out, converted)
    return converted


def read_folder(folder: Path) -> list[SourceClip]:
    """Read the clean clips of every split of a data folder, labelled or not."""
    index = read_jsonl(folder / "index.jsonl")
    clips = []
    for split in sorted(path.stem for path in folder.glob("*.npz")):
        clips += [SourceClip(clip, split, index.get(clip.id, {}), folder.name) for clip in read_split(folder, split)]
    return clips


def convert(source: SourceClip, rests: dict[int, Any], table: ActionTable) -> SourceClip:
    """Bring a clip to the common skeleton, and its label to the names of the action table."""
    joints = start_at_origin(to_common_skeleton(source.clip.joints, rests))
    label = next((str(source.row[key]) for key in LABEL_KEYS if source.row.get(key)), "")
    # A label that the table does not know, such as one of several activities, says no more than the captions do.
    names = tuple(table.canonical(part) for part in split_label(label))
    actions = tuple(name for name in names if name is not None) if None not in names else ()
    clip = replace(source.clip, joints=joints, actions=actions, in_order=IN_ORDER in label and len(actions) > 1)
    return replace(source, clip=clip)


def write_combined(out: Path, clips: Sequence[SourceClip]) -> None:
    """Write a data folder, all or nothing, its index last."""
    files = {
        f"{split}.npz": pack_clips([(each.clip.id, each.clip.joints) for each in clips if each.split == split], 20)
        for split in sorted({each.split for each in clips})
    }
    captions = [
        {"id": each.clip.id, "split": each.split, "captions": list(each.clip.captions)}
        | ({"partial_captions": list(each.clip.partial_captions)} if each.clip.partial_captions else {})
        for each in clips
    ]
    files["captions.jsonl"] = to_json_lines(captions)
    files["index.jsonl"] = to_json_lines([index_row(clip) for clip in clips])
    write_files(out, files)


def index_row(source: SourceClip) -> dict[str, Any]:
    """Make the row of a clip: labels, what it was made from, and what was measured of it."""
    clip, row = source.clip, source.row
    return {
        "id": clip.id,
        "split": source.split,
        "content": clip.action,
        "style_canon": clip.style,
        "frames": len(clip.joints),
        "fps": 20,
        "data": source.folder,
        "source": row.get("source", source.folder),
        "source_file": row.get("source_file", ""),
        "licence": row.get("licence", ""),
        **{key: row[key] for key in KEPT if key in row},
    }


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; returns 2 on bad input, with the reason on stderr."""
    parser = argparse.ArgumentParser(prog="python -m kinegraph_training.combine", description=__doc__.split("\n")[0])
    parser.add_argument("--data", type=Path, action="append", required=True, help="data folder; may be repeated")
    parser.add_argument("--out", type=Path, required=True, help="folder to write")
    parser.add_argument("--without-source", action="append", default=[], help="source to leave out; may be repeated")
    parsed = parser.parse_args(arguments)
    try:
        clips = combine(parsed.data, parsed.out, read_action_table(), parsed.without_source)
    except KinegraphError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    minutes = sum(len(clip.clip.joints) for clip in clips) / 20 / 60
    labels = {clip.clip.action for clip in clips if clip.clip.actions}
    unnamed = sum(not clip.clip.actions for clip in clips)
    print(
        f"{parsed.out}: {len(clips)} clips, {minutes:.0f} minutes, {len(labels)} actions, {unnamed} clips without one"
    )
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
