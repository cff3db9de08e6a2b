"""Hierarchical semantic graph of a caption (GraphMotion, section 3.1), with its JSON.

Nodes are on three levels: the caption (motion), its actions, and their arguments (specifics). Weighted edges of twelve
types (section B.1) lead from the motion node to the actions and from each action to its arguments. An action may be
negated: it must not happen. `kinegraph.edits` changes a graph.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import Any, Final, NoReturn

from kinegraph.errors import InvalidGraphError
from kinegraph.limits import MAX_NODES, MAX_TEXT
from kinegraph.validation import finite_number, short_repr

MOTION_ACTION: Final = "ARGM-MA"
"""Type of the edges from the motion node to the actions."""
OTHERS: Final = "OTHERS"
"""Type of the edges to arguments without one of the other roles."""

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
"""Edge types. The index in this tuple is the relation number of the graph encoder; trained weights depend on it."""

ARGUMENT_ROLES: Final[tuple[str, ...]] = tuple(role for role in ROLES if role != MOTION_ACTION)
"""Roles of arguments; ARGM-MA is reserved for the edges to actions."""

ROLE_INDEX: Final[dict[str, int]] = {role: index for index, role in enumerate(ROLES)}
"""Relation number of each edge type."""

MAX_WEIGHT: Final = 100.0
"""Largest weight of an edge."""


@dataclass(frozen=True)
class Argument:
    """A specific node: an argument of one action."""

    role: str
    """One of `ARGUMENT_ROLES`: the type of its edge."""
    text: str
    """`caption[start:end]`."""
    start: int
    end: int
    """Characters of the caption, end exclusive."""
    weight: float = 1.0
    """Weight of the edge from its action: 1 is neutral, 0 is the same as no such node."""


@dataclass(frozen=True)
class Action:
    """An action node: a verb and its arguments."""

    text: str
    """`caption[start:end]`."""
    start: int
    end: int
    order: int
    """Index in the sequence of actions; it stays when other actions are removed."""
    weight: float = 1.0
    """Weight of the edge from the motion node."""
    arguments: tuple[Argument, ...] = ()
    negated: bool = False
    """True for an action that must not happen ("without waving"); a graph may consist of such actions only."""


@dataclass(frozen=True)
class SemanticGraph:
    """A caption with its actions, validated on construction.

    Raises:
        InvalidGraphError: text that differs from the caption at its offsets, an unknown role, a weight that is
            not in 0 to `MAX_WEIGHT`, `negated` that is no bool, no action, or more than `limits.MAX_NODES` nodes.
    """

    caption: str
    actions: tuple[Action, ...]

    def __post_init__(self) -> None:
        if not isinstance(self.caption, str) or not 1 <= len(self.caption) <= MAX_TEXT:
            raise InvalidGraphError(f"caption must be a text of 1 to {MAX_TEXT} characters")
        _check_nodes(self.actions, Action, "actions")
        if not self.actions:
            raise InvalidGraphError("a graph needs at least one action")
        for index, action in enumerate(self.actions):
            _check_nodes(action.arguments, Argument, f"actions[{index}].arguments")
        if self.node_count > MAX_NODES:
            raise InvalidGraphError(f"a graph may have {MAX_NODES} nodes, this one has {self.node_count}")
        for index, action in enumerate(self.actions):
            where = f"actions[{index}]"
            _check_node(action, self.caption, where)
            if type(action.order) is not int or not 0 <= action.order < MAX_NODES:
                raise InvalidGraphError(f"{where}.order must be 0 to {MAX_NODES - 1}, not {short_repr(action.order)}")
            if type(action.negated) is not bool:
                raise InvalidGraphError(f"{where}.negated must be true or false, not {short_repr(action.negated)}")
            for argument_index, argument in enumerate(action.arguments):
                argument_where = f"{where}.arguments[{argument_index}]"
                _check_node(argument, self.caption, argument_where)
                if not isinstance(argument.role, str) or argument.role not in ARGUMENT_ROLES:
                    raise InvalidGraphError(
                        f"{argument_where}.role must be one of {', '.join(ARGUMENT_ROLES)}, "
                        f"not {short_repr(argument.role)}"
                    )

    @property
    def node_count(self) -> int:
        """Number of nodes: the motion node, actions and specifics."""
        return 1 + len(self.actions) + sum(len(action.arguments) for action in self.actions)

    @property
    def nodes(self) -> tuple[Action | Argument, ...]:
        """All nodes except the motion node, in the order of the model: actions, then their arguments."""
        return (*self.actions, *(argument for action in self.actions for argument in action.arguments))

    def to_dict(self) -> dict[str, Any]:
        """Convert to plain values for JSON.

        An action's order is written only where it differs from its index, `negated` only where it is true.
        """
        actions = []
        for index, action in enumerate(self.actions):
            row: dict[str, Any] = {
                "text": action.text,
                "start": action.start,
                "end": action.end,
                "weight": float(action.weight),
            }
            if action.order != index:
                row["order"] = action.order
            if action.negated:
                row["negated"] = True
            row["arguments"] = [
                {
                    "role": argument.role,
                    "text": argument.text,
                    "start": argument.start,
                    "end": argument.end,
                    "weight": float(argument.weight),
                }
                for argument in action.arguments
            ]
            actions.append(row)
        return {"caption": self.caption, "actions": actions}

    def to_json(self, *, indent: int | None = None) -> str:
        """Convert to JSON text; characters of the caption are not escaped to ASCII."""
        return json.dumps(self.to_dict(), ensure_ascii=False, indent=indent)

    @staticmethod
    def from_json(text: str) -> SemanticGraph:
        """Read JSON text, as `to_json` writes it.

        Raises:
            InvalidGraphError: invalid JSON, an unknown or missing key, a wrong type, or as `SemanticGraph` raises.
        """
        if not isinstance(text, str | bytes):
            raise InvalidGraphError(f"the graph must be JSON text, not {short_repr(text)}")
        try:
            value = json.loads(text, parse_constant=_refuse_constant)
        except (ValueError, RecursionError) as error:
            raise InvalidGraphError(f"the graph is not valid JSON: {error}") from error
        return SemanticGraph.from_dict(value)

    @staticmethod
    def from_dict(value: object) -> SemanticGraph:
        """Read parsed JSON; raises as `from_json` does."""
        record = _check_record(value, "the graph", {"caption", "actions"}, set())
        items = _check_list(record["actions"], "actions")
        actions = tuple(_read_action(item, index) for index, item in enumerate(items))
        return SemanticGraph(record["caption"], actions)


def _read_action(value: object, index: int) -> Action:
    where = f"actions[{index}]"
    record = _check_record(value, where, {"text", "start", "end"}, {"weight", "order", "arguments", "negated"})
    items = _check_list(record.get("arguments", []), f"{where}.arguments")
    arguments = tuple(_read_argument(item, f"{where}.arguments[{number}]") for number, item in enumerate(items))
    return Action(**{"order": index, **record, "arguments": arguments})


def _read_argument(value: object, where: str) -> Argument:
    return Argument(**_check_record(value, where, {"role", "text", "start", "end"}, {"weight"}))


def _check_record(value: object, where: str, required: set[str], optional: set[str]) -> dict[str, Any]:
    if not isinstance(value, dict):
        raise InvalidGraphError(f"{where} must be a JSON object")
    missing, unknown = sorted(required - set(value)), sorted(map(short_repr, set(value) - required - optional))
    if missing:
        raise InvalidGraphError(f"{where} lacks {', '.join(missing)}")
    if unknown:
        raise InvalidGraphError(
            f"{where} has unknown keys {', '.join(unknown)}; known are {', '.join(sorted(required | optional))}"
        )
    return value


def _check_list(value: object, where: str) -> list[object]:
    if not isinstance(value, list):
        raise InvalidGraphError(f"{where} must be a list")
    return value


def _check_nodes(nodes: object, kind: type, where: str) -> None:
    if not isinstance(nodes, tuple) or not all(isinstance(node, kind) for node in nodes):
        raise InvalidGraphError(f"{where} must be a tuple of {kind.__name__}, not {short_repr(nodes)}")


def _check_node(node: Action | Argument, caption: str, where: str) -> None:
    start, end = node.start, node.end
    if type(start) is not int or type(end) is not int or not 0 <= start < end <= len(caption):
        raise InvalidGraphError(
            f"{where}: start and end must be offsets into the caption of {len(caption)} characters, "
            f"not {short_repr(start)} and {short_repr(end)}"
        )
    if not isinstance(node.text, str) or node.text != caption[start:end]:
        raise InvalidGraphError(
            f"{where}.text {short_repr(node.text)} is not caption[{start}:{end}] {caption[start:end]!r}"
        )
    weight = finite_number(node.weight) if isinstance(node.weight, int | float) else None
    if weight is None:
        raise InvalidGraphError(f"{where}.weight must be a finite number, not {short_repr(node.weight)}")
    if not 0 <= weight <= MAX_WEIGHT:
        raise InvalidGraphError(f"{where}.weight must be 0 to {MAX_WEIGHT:g}, not {weight:g}")


def _refuse_constant(token: str) -> NoReturn:
    raise InvalidGraphError(f"{token} is not a number")
