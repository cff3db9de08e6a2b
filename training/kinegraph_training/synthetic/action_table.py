"""Actions that training can name: wordings, body parts and other names of each label (`actions.toml`).

A label with a side is written once, with `{side}` and `{other}` for the opposite one, and becomes two labels.
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, Final

FILE: Final = Path(__file__).parent / "actions.toml"
SIDES: Final = ("left", "right")
PARTS: Final = ("legs", "arm", "arms", "body")
"""What an action moves: legs (arms only swing along), the arm of its side, both arms, or all of the body."""


@dataclass(frozen=True)
class Action:
    """One action with its wordings."""

    label: str
    finite: tuple[str, ...]
    """Verb phrases that follow a subject: "walks forward"."""
    participle: tuple[str, ...]
    """Verb phrases that follow "while"; number i belongs to finite phrase i."""
    noun: tuple[str, ...]
    """Noun phrases that name the action: "a walk"."""
    parts: str
    """One of `PARTS`."""
    steady: bool
    """Whether every two seconds of it show the same action."""
    side: str = ""
    """"left" or "right", where the label has one."""


@dataclass(frozen=True)
class ActionTable:
    """All actions by label, and the labels that other names stand for."""

    actions: Mapping[str, Action]
    names: Mapping[str, str]

    def canonical(self, label: str) -> str | None:
        """Return the table's label for a label of a data set; None for one that it does not know."""
        return self.names.get(label.lower())

    def get(self, label: str) -> Action | None:
        """Return the action of a canonical label, if there is one."""
        return self.actions.get(label)


@cache
def read_action_table(path: Path = FILE) -> ActionTable:
    """Read the action table.

    Raises:
        ValueError: a label or name occurs twice, or an entry is not as the table's head says.
    """
    actions: dict[str, Action] = {}
    names: dict[str, str] = {}
    for pattern, entry in tomllib.loads(path.read_text(encoding="utf-8")).items():
        for side in SIDES if "{side}" in pattern else ("",):
            action = _read_action(pattern, entry, side)
            for name in (action.label, *(_fill(alias, side) for alias in entry.get("aliases", ()))):
                if names.setdefault(name, action.label) != action.label or name in actions:
                    raise ValueError(f"{path}: the name {name!r} stands for two actions")
            actions[action.label] = action
    return ActionTable(actions, names)


def _read_action(pattern: str, entry: Mapping[str, Any], side: str) -> Action:
    finite, participle = (tuple(_fill(text, side) for text in entry[key]) for key in ("finite", "participle"))
    if len(finite) != len(participle) or not finite or entry["parts"] not in PARTS:
        raise ValueError(f"{pattern}: finite and participle must be as many, and parts one of {', '.join(PARTS)}")
    noun = tuple(_fill(text, side) for text in entry.get("noun", ()))
    return Action(_fill(pattern, side), finite, participle, noun, entry["parts"], bool(entry.get("steady")), side)


def _fill(text: str, side: str) -> str:
    """Put a side and its opposite into a text."""
    return text.replace("{side}", side).replace("{other}", {"left": "right", "right": "left"}.get(side, ""))
