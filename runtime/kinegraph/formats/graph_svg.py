"""A semantic graph as a picture: motion, actions and specifics in three columns, edges with their types and weights."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final
from xml.sax.saxutils import escape

from kinegraph.graph import Action, Argument, SemanticGraph
from kinegraph.text.roles import MOTION_ACTION

COLUMNS: Final = (20.0, 310.0, 600.0)
"""Left edges of the three columns, pixels."""
WIDTH: Final = 190.0
FIRST: Final = 50.0
GAP: Final = 24.0
ROW: Final = 57.0
"""Top of the first row, space between boxes, and the least height of an action's rows."""
LINE: Final = 17.0
LETTERS: Final = 25
"""Characters on a line of a box; a longer text is broken."""
FILLS: Final = ("#e0e7ff", "#dcfce7", "#fef3c7")


@dataclass(frozen=True)
class Box:
    """A node's place: `y` is its middle."""

    column: int
    y: float
    lines: tuple[str, ...]

    @property
    def height(self) -> float:
        return 16 + LINE * len(self.lines)

    def below(self, top: float) -> Box:
        """The same box with its upper edge there."""
        return replace(self, y=top + self.height / 2)


def graph_svg(graph: SemanticGraph) -> str:
    """The SVG document; equal graphs give equal text.

    A line's width grows with the weight of its edge; an edge of weight 0 is dashed and its node pale.
    """
    y, placed = FIRST, []
    for action in graph.actions:
        top, parts = y, []
        for part in action.arguments:
            box = Box(2, 0.0, _lines(part.text)).below(y)
            parts.append((box, part))
            y += box.height + GAP
        y = max(y, top + ROW)
        placed.append((Box(1, (top + y - GAP) / 2, _lines(action.text)), action, parts))
    root = Box(0, (FIRST + y - GAP) / 2, _lines(graph.caption))
    drawn = []
    for own, action, parts in placed:
        drawn.append(_edge(root, own, action))
        drawn += [_edge(own, box, part) for box, part in parts]
    drawn.append(_box(root, True))
    for own, action, parts in placed:
        drawn.append(_box(own, action.weight > 0))
        drawn += [_box(box, action.weight > 0 and part.weight > 0) for box, part in parts]
    height = max(y, root.y + root.height / 2) + 20
    top = min(0.0, root.y - root.height / 2 - FIRST)
    total = COLUMNS[2] + WIDTH + 20
    heads = "".join(
        f'<text x="{x + WIDTH / 2:g}" y="{top + 26:g}" text-anchor="middle" fill="#6b7280">{name}</text>'
        for x, name in zip(COLUMNS, ("motion", "actions", "specifics"), strict=True)
    )
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{total:g}" height="{height - top:g}" '
        f'viewBox="0 {top:g} {total:g} {height - top:g}" font-family="system-ui, sans-serif" font-size="13">'
        f'<title>{escape(graph.caption)}</title><rect y="{top:g}" width="100%" height="100%" fill="#ffffff"/>'
        f"{heads}{''.join(drawn)}</svg>\n"
    )


def _lines(text: str) -> tuple[str, ...]:
    return tuple(textwrap.wrap(text, LETTERS)) or (text,)


def _box(box: Box, present: bool) -> str:
    x, top = COLUMNS[box.column], box.y - box.height / 2
    opacity = "" if present else ' opacity="0.35"'
    words = _words(box.lines, x + WIDTH / 2, top + 8 + LINE - 4)
    return (
        f'<g{opacity}><rect x="{x:g}" y="{top:g}" width="{WIDTH:g}" height="{box.height:g}" rx="8" '
        f'fill="{FILLS[box.column]}" stroke="#9ca3af"/>{words}</g>'
    )


def _words(lines: Sequence[str], x: float, y: float) -> str:
    rows = (f'<tspan x="{x:g}" dy="{LINE if n else 0:g}">{escape(line)}</tspan>' for n, line in enumerate(lines))
    return f'<text x="{x:g}" y="{y:g}" text-anchor="middle" fill="#111827">{"".join(rows)}</text>'


def _edge(parent: Box, child: Box, node: Action | Argument) -> str:
    """A curve from the right of one box to the left of the other, named at the child's end."""
    x0, x1 = COLUMNS[parent.column] + WIDTH, COLUMNS[child.column]
    middle = (x0 + x1) / 2
    role = node.role if isinstance(node, Argument) else MOTION_ACTION
    weight = "" if node.weight == 1 else f" ×{node.weight:g}"
    width, dash = min(6.0, 0.6 + 1.2 * node.weight), "" if node.weight else ' stroke-dasharray="4 4"'
    return (
        f'<path d="M{x0:g} {parent.y:g} C{middle:g} {parent.y:g} {middle:g} {child.y:g} {x1:g} {child.y:g}" '
        f'fill="none" stroke="#6b7280" stroke-width="{width:g}"{dash}/>'
        f'<text x="{x1 - 6:g}" y="{child.y - 7:g}" text-anchor="end" font-size="11" fill="#374151" '
        f'paint-order="stroke" stroke="#ffffff" stroke-width="4">{role}{weight}</text>'
    )
