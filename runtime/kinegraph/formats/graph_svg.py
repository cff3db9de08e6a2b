"""A semantic graph as a picture: motion, actions and specifics in three columns, edges with their types and weights."""

from __future__ import annotations

import textwrap
from dataclasses import dataclass, replace
from typing import Final
from xml.sax.saxutils import escape

from kinegraph.graph import MOTION_ACTION, Action, Argument, SemanticGraph

COLUMNS: Final = (20.0, 290.0, 560.0)
"""Left edges of the three columns, pixels."""
WIDTH: Final = 190.0
FIRST: Final = 50.0
"""Top of the first row."""
GAP: Final = 14.0
LINE: Final = 17.0
LETTERS: Final = 25
"""Characters on a line of a box; a longer text is broken."""
FILLS: Final = ("#e0e7ff", "#dcfce7", "#fef3c7")


@dataclass(frozen=True)
class Box:
    """A node's place and words; `y` is its middle, `label` the type and weight of the edge that leads to it."""

    column: int
    y: float
    lines: tuple[str, ...]
    label: str = ""
    weight: float = 1.0
    present: bool = True

    @property
    def height(self) -> float:
        return 16 + LINE * (len(self.lines) + bool(self.label))


def graph_svg(graph: SemanticGraph) -> str:
    """The SVG document; equal graphs give equal text.

    A line's width grows with the weight of its edge; an edge of weight 0 is dashed and its node pale.
    """
    y, boxes, edges = FIRST, [], []
    for action in graph.actions:
        top, own = y, _box(1, action, action.weight > 0)
        parts = []
        for part in action.arguments:
            box = _box(2, part, action.weight * part.weight > 0)
            parts.append(replace(box, y=y + box.height / 2))
            y += box.height + GAP
        y = max(y, top + own.height + GAP)
        own = replace(own, y=(top + y - GAP) / 2)
        boxes += [own, *parts]
        edges += [(own, part) for part in parts]
    root = Box(0, (FIRST + y - GAP) / 2, _lines(graph.caption))
    edges += [(root, box) for box in boxes if box.column == 1]
    drawn = [_curve(*edge) for edge in edges] + [_drawn(box) for box in (root, *boxes)]
    return _document(graph.caption, drawn, min(0.0, root.y - root.height / 2 - FIRST), max(y, root.y + root.height / 2))


def _lines(text: str) -> tuple[str, ...]:
    return tuple(textwrap.wrap(text, LETTERS)) or (text,)


def _box(column: int, node: Action | Argument, present: bool) -> Box:
    """A node, not yet in its place."""
    role = node.role if isinstance(node, Argument) else MOTION_ACTION
    label = role if node.weight == 1 else f"{role} ×{node.weight:g}"
    return Box(column, 0.0, _lines(node.text), label, node.weight, present)


def _document(title: str, drawn: list[str], top: float, bottom: float) -> str:
    width, height = COLUMNS[-1] + WIDTH + 20, bottom + 20 - top
    heads = "".join(
        f'<text x="{x + WIDTH / 2:g}" y="{top + 26:g}" text-anchor="middle" fill="#6b7280">{name}</text>'
        for x, name in zip(COLUMNS, ("motion", "actions", "specifics"), strict=True)
    )
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{width:g}" height="{height:g}" '
        f'viewBox="0 {top:g} {width:g} {height:g}" font-family="system-ui, sans-serif" font-size="13">'
        f'<title>{escape(title)}</title><rect y="{top:g}" width="100%" height="100%" fill="#ffffff"/>'
        f"{heads}{''.join(drawn)}</svg>\n"
    )


def _drawn(box: Box) -> str:
    x, top = COLUMNS[box.column], box.y - box.height / 2
    opacity = "" if box.present else ' opacity="0.35"'
    rows = [(line, "#111827", 13) for line in box.lines]
    if box.label:
        rows.insert(0, (box.label, "#6b7280", 10))
    words = "".join(
        f'<text x="{x + WIDTH / 2:g}" y="{top + 21 + LINE * row:g}" text-anchor="middle" fill="{colour}" '
        f'font-size="{size}">{escape(line)}</text>'
        for row, (line, colour, size) in enumerate(rows)
    )
    return (
        f'<g{opacity}><rect x="{x:g}" y="{top:g}" width="{WIDTH:g}" height="{box.height:g}" rx="8" '
        f'fill="{FILLS[box.column]}" stroke="#9ca3af"/>{words}</g>'
    )


def _curve(parent: Box, child: Box) -> str:
    """From the right of one box to the left of the other."""
    x0, x1 = COLUMNS[parent.column] + WIDTH, COLUMNS[child.column]
    middle = (x0 + x1) / 2
    width, dash = min(6.0, 0.6 + 1.2 * child.weight), "" if child.weight else ' stroke-dasharray="4 4"'
    return (
        f'<path d="M{x0:g} {parent.y:g} C{middle:g} {parent.y:g} {middle:g} {child.y:g} {x1:g} {child.y:g}" '
        f'fill="none" stroke="#6b7280" stroke-width="{width:g}"{dash}/>'
    )
