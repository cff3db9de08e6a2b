"""Draw a semantic graph as SVG: motion, actions and specifics in three columns, edges with types and weights."""

from __future__ import annotations

import textwrap
from dataclasses import dataclass, replace
from typing import Final
from xml.sax.saxutils import escape

from kinegraph.graph import MOTION_ACTION, Action, Argument, SemanticGraph

COLUMNS: Final = (20.0, 290.0, 560.0)
"""Left edges of the three columns, pixels."""
BOX_WIDTH: Final = 190.0
FIRST_ROW: Final = 50.0
"""Top of the first row, pixels."""
ROW_GAP: Final = 14.0
LINE_HEIGHT: Final = 17.0
LINE_LENGTH: Final = 25
"""Characters on a line of a box, before the text is wrapped."""
FILLS: Final = ("#e0e7ff", "#dcfce7", "#fef3c7")
"""Colours of the boxes, by column."""
_DASH: Final = ' stroke-dasharray="4 4"'


@dataclass(frozen=True)
class Box:
    """A node of the picture."""

    column: int
    y: float
    """Middle of the box, pixels."""
    lines: tuple[str, ...]
    """Wrapped text."""
    label: str = ""
    """Type and weight of the edge that leads to the node."""
    weight: float = 1.0
    """Weight of that edge."""
    is_active: bool = True
    """False if an edge of weight 0 removes the node."""
    negated: bool = False
    """True for an action that must not happen; its box and the edge to it are dashed."""

    @property
    def height(self) -> float:
        """Height of the box, pixels."""
        return 16 + LINE_HEIGHT * (len(self.lines) + bool(self.label))


def graph_svg(graph: SemanticGraph) -> str:
    """Draw a graph as an SVG document; equal graphs give equal text.

    A line's width grows with the weight of its edge. An edge of weight 0 is dashed and its node pale. A negated action
    has the label "not", and dashed lines lead to it and surround it.
    """
    y, boxes, edges = FIRST_ROW, [], []
    for action in graph.actions:
        top, action_box = y, _make_box(1, action, action.weight > 0)
        argument_boxes = []
        for argument in action.arguments:
            box = _make_box(2, argument, action.weight * argument.weight > 0)
            argument_boxes.append(replace(box, y=y + box.height / 2))
            y += box.height + ROW_GAP
        y = max(y, top + action_box.height + ROW_GAP)
        action_box = replace(action_box, y=(top + y - ROW_GAP) / 2)  # centred on its arguments
        boxes += [action_box, *argument_boxes]
        edges += [(action_box, box) for box in argument_boxes]
    root = Box(0, (FIRST_ROW + y - ROW_GAP) / 2, _wrap(graph.caption))
    edges += [(root, box) for box in boxes if box.column == 1]
    elements = [_draw_edge(*edge) for edge in edges] + [_draw_box(box) for box in (root, *boxes)]
    top, bottom = min(0.0, root.y - root.height / 2 - FIRST_ROW), max(y, root.y + root.height / 2)
    return _document(graph.caption, elements, top, bottom)


def _wrap(text: str) -> tuple[str, ...]:
    return tuple(textwrap.wrap(text, LINE_LENGTH)) or (text,)


def _make_box(column: int, node: Action | Argument, is_active: bool) -> Box:
    """Make the box of a node, its y still to be set."""
    role = node.role if isinstance(node, Argument) else MOTION_ACTION
    label = role if node.weight == 1 else f"{role} ×{node.weight:g}"
    negated = isinstance(node, Action) and node.negated
    return Box(column, 0.0, _wrap(node.text), f"not {label}" if negated else label, node.weight, is_active, negated)


def _document(title: str, elements: list[str], top: float, bottom: float) -> str:
    width, height = COLUMNS[-1] + BOX_WIDTH + 20, bottom + 20 - top
    headings = "".join(
        f'<text x="{x + BOX_WIDTH / 2:g}" y="{top + 26:g}" text-anchor="middle" fill="#6b7280">{name}</text>'
        for x, name in zip(COLUMNS, ("motion", "actions", "specifics"), strict=True)
    )
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{width:g}" height="{height:g}" '
        f'viewBox="0 {top:g} {width:g} {height:g}" font-family="system-ui, sans-serif" font-size="13">'
        f'<title>{escape(title)}</title><rect y="{top:g}" width="100%" height="100%" fill="#ffffff"/>'
        f"{headings}{''.join(elements)}</svg>\n"
    )


def _draw_box(box: Box) -> str:
    x, top = COLUMNS[box.column], box.y - box.height / 2
    opacity, dash = "" if box.is_active else ' opacity="0.35"', _DASH if box.negated else ""
    rows = [(line, "#111827", 13) for line in box.lines]
    if box.label:
        rows.insert(0, (box.label, "#6b7280", 10))
    texts = "".join(
        f'<text x="{x + BOX_WIDTH / 2:g}" y="{top + 21 + LINE_HEIGHT * row:g}" text-anchor="middle" fill="{colour}" '
        f'font-size="{size}">{escape(line)}</text>'
        for row, (line, colour, size) in enumerate(rows)
    )
    return (
        f'<g{opacity}><rect x="{x:g}" y="{top:g}" width="{BOX_WIDTH:g}" height="{box.height:g}" rx="8" '
        f'fill="{FILLS[box.column]}" stroke="#9ca3af"{dash}/>{texts}</g>'
    )


def _draw_edge(parent: Box, child: Box) -> str:
    """Draw a curve from the right of one box to the left of the other."""
    x0, x1 = COLUMNS[parent.column] + BOX_WIDTH, COLUMNS[child.column]
    middle = (x0 + x1) / 2
    width, dash = min(6.0, 0.6 + 1.2 * child.weight), _DASH if child.negated or not child.weight else ""
    return (
        f'<path d="M{x0:g} {parent.y:g} C{middle:g} {parent.y:g} {middle:g} {child.y:g} {x1:g} {child.y:g}" '
        f'fill="none" stroke="#6b7280" stroke-width="{width:g}"{dash}/>'
    )
