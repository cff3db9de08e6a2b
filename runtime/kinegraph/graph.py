"""The twelve edge types of the semantic graph (GraphMotion, section B.1) and their stable numbers.

The hierarchical semantic graph (GraphMotion, section 3.1): the caption (motion), its actions, their arguments
(specifics), on twelve types of weighted edges. Edits are in `kinegraph.edits`."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from typing import Any, Final, NoReturn

from kinegraph.errors import InvalidGraphError
from kinegraph.limits import MAX_NODES, MAX_TEXT

MOTION_ACTION: Final = "ARGM-MA"
OTHERS: Final = "OTHERS"

ROLES: Final[tuple[str, ...]] = (
    "ARG0",
    "ARG1",
    "ARG2",
    "ARG3",
    "ARG4",
    "ARGM-LOC",
    "ARGM-MNR",
    "ARGM-TMP",
    "ARGM-DIR",
    "ARGM-ADV",
    MOTION_ACTION,
    OTHERS,
)
"""Position in this tuple is the relation number fed to the graph encoder; trained weights depend on it."""

ARGUMENT_ROLES: Final[tuple[str, ...]] = tuple(role for role in ROLES if role != MOTION_ACTION)
"""Roles an action's argument may bear; ARGM-MA is reserved for motion-action edges."""

ROLE_INDEX: Final[dict[str, int]] = {role: index for index, role in enumerate(ROLES)}


MAX_WEIGHT: Final = 100.0
"""Of an edge; beyond it attention sees nothing else anyway."""


@dataclass(frozen=True)
class Argument:
    """A specific node, hanging on one action."""

    role: str
    """One of `roles.ARGUMENT_ROLES`: the type of its edge."""
    text: str
    """`caption[start:end]`."""
    start: int
    end: int
    """Characters of the caption, end exclusive."""
    weight: float = 1.0
    """Of the edge to its action: 1 leaves the model as it is, 0 removes the node."""


@dataclass(frozen=True)
class Action:
    """A verb and its arguments."""

    text: str
    """`caption[start:end]`."""
    start: int
    end: int
    order: int
    """Place in the sequence of actions. Stays with the node when others are removed."""
    weight: float = 1.0
    """Of the edge to the motion node."""
    arguments: tuple[Argument, ...] = ()


@dataclass(frozen=True)
class SemanticGraph:
    """A caption with its actions; checked when made.

    Raises:
        InvalidGraphError: text that is not the caption's at these offsets, a role that does not exist, a weight that is
            negative or not finite, no action, or more than `limits.MAX_NODES` nodes.
    """

    caption: str
    actions: tuple[Action, ...]

    def __post_init__(self) -> None:
        if not isinstance(self.caption, str) or not 1 <= len(self.caption) <= MAX_TEXT:
            raise InvalidGraphError(f"caption must be a text of 1 to {MAX_TEXT} characters")
        if not self.actions:
            raise InvalidGraphError("a graph needs at least one action")
        if self.node_count > MAX_NODES:
            raise InvalidGraphError(f"a graph may have {MAX_NODES} nodes, this one has {self.node_count}")
        for number, action in enumerate(self.actions):
            where = f"actions[{number}]"
            _check_node(action, self.caption, where)
            if type(action.order) is not int or not 0 <= action.order < MAX_NODES:
                raise InvalidGraphError(f"{where}.order must be 0 to {MAX_NODES - 1}, not {action.order!r}")
            for place, argument in enumerate(action.arguments):
                inner = f"{where}.arguments[{place}]"
                _check_node(argument, self.caption, inner)
                if argument.role not in ARGUMENT_ROLES:
                    raise InvalidGraphError(
                        f"{inner}.role must be one of {', '.join(ARGUMENT_ROLES)}, not {argument.role!r}"
                    )

    @property
    def node_count(self) -> int:
        """Motion node, actions and specifics."""
        return 1 + len(self.actions) + sum(len(action.arguments) for action in self.actions)

    @property
    def nodes(self) -> tuple[Action | Argument, ...]:
        """All nodes but the motion node, in the order of the model: actions, then their arguments."""
        return (*self.actions, *(part for action in self.actions for part in action.arguments))

    def to_dict(self) -> dict[str, Any]:
        """What `to_json` writes. An action's order is told only where it is not its place in the list."""
        actions = []
        for place, action in enumerate(self.actions):
            row: dict[str, Any] = {
                "text": action.text,
                "start": action.start,
                "end": action.end,
                "weight": float(action.weight),
            }
            if action.order != place:
                row["order"] = action.order
            row["arguments"] = [
                {
                    "role": part.role,
                    "text": part.text,
                    "start": part.start,
                    "end": part.end,
                    "weight": float(part.weight),
                }
                for part in action.arguments
            ]
            actions.append(row)
        return {"caption": self.caption, "actions": actions}

    def to_json(self, *, indent: int | None = None) -> str:
        """As JSON text, every character of the caption as it is."""
        return json.dumps(self.to_dict(), ensure_ascii=False, indent=indent)

    @staticmethod
    def from_json(text: str) -> SemanticGraph:
        """Read what `to_json` or a person wrote.

        Raises:
            InvalidGraphError: no JSON, an unknown or missing key, a wrong type, or see `SemanticGraph`.
        """
        try:
            value = json.loads(text, parse_constant=_refuse_constant)
        except (ValueError, RecursionError) as error:
            raise InvalidGraphError(f"the graph is not valid JSON: {error}") from error
        return SemanticGraph.from_dict(value)

    @staticmethod
    def from_dict(value: object) -> SemanticGraph:
        """From parsed JSON; see `from_json`."""
        record = _record(value, "the graph", {"caption", "actions"}, set())
        actions = tuple(_action(item, place) for place, item in enumerate(_list(record["actions"], "actions")))
        return SemanticGraph(record["caption"], actions)


def _action(value: object, place: int) -> Action:
    where = f"actions[{place}]"
    record = _record(value, where, {"text", "start", "end"}, {"weight", "order", "arguments"})
    arguments = tuple(
        Argument(**_record(item, f"{where}.arguments[{number}]", {"role", "text", "start", "end"}, {"weight"}))
        for number, item in enumerate(_list(record.get("arguments", []), f"{where}.arguments"))
    )
    return Action(**{"order": place, **record, "arguments": arguments})


def _record(value: object, where: str, required: set[str], optional: set[str]) -> dict[str, Any]:
    if not isinstance(value, dict):
        raise InvalidGraphError(f"{where} must be a JSON object")
    missing, unknown = sorted(required - set(value)), sorted(set(value) - required - optional)
    if missing:
        raise InvalidGraphError(f"{where} lacks {', '.join(missing)}")
    if unknown:
        raise InvalidGraphError(
            f"{where} has unknown keys {', '.join(unknown)}; known are {', '.join(sorted(required | optional))}"
        )
    return value


def _list(value: object, where: str) -> list[object]:
    if not isinstance(value, list):
        raise InvalidGraphError(f"{where} must be a list")
    return value


def _check_node(node: Action | Argument, caption: str, where: str) -> None:
    start, end = node.start, node.end
    if type(start) is not int or type(end) is not int or not 0 <= start < end <= len(caption):
        raise InvalidGraphError(
            f"{where}: start and end must be offsets into the caption of {len(caption)} characters, "
            f"not {start!r} and {end!r}"
        )
    if node.text != caption[start:end]:
        raise InvalidGraphError(f"{where}.text {node.text!r} is not caption[{start}:{end}] {caption[start:end]!r}")
    weight = node.weight
    if isinstance(weight, bool) or not isinstance(weight, int | float) or not math.isfinite(weight):
        raise InvalidGraphError(f"{where}.weight must be a finite number, not {weight!r}")
    if not 0 <= weight <= MAX_WEIGHT:
        raise InvalidGraphError(f"{where}.weight must be 0 to {MAX_WEIGHT:g}, not {weight!r}")


def _refuse_constant(token: str) -> NoReturn:
    raise InvalidGraphError(f"{token} is not a number")
