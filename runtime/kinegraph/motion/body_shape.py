"""How stout a character is: widths of trunk, thighs and forearms, measured on points of its skin at rest.

The trunk is a stack of ellipses, one for each of `LEVELS` heights between crotch and shoulders; a thigh is a row of
circles about the line from hip to knee. Quantiles in place of extremes, and points of far-off extra joints left out,
keep belts, hair and wings from counting as flesh.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from kinegraph.arrays import Floats
from kinegraph.motion.humanoid import SIDES
from kinegraph.motion.rig import Rig

LEVELS: Final = 12
"""Ellipses of the trunk."""
CIRCLES: Final = 4
"""Circles of a thigh."""
FULL: Final = 0.95
"""Quantile of distances that counts as the extent of a section."""
SQUARE: Final = 1.2
"""Most by which an ellipse grows to hold the corners of an angular section."""
WIDEST: Final = 1.75
"""Most half width of the trunk, in half widths of the shoulders."""
FLESH: Final = 0.8
"""Share of a forearm's radius that keeps away from the trunk; the rest is what flesh yields."""
ENOUGH: Final = 60
"""Points of a part from which it is measured."""

TRUNK: Final = "trunk"


@dataclass(frozen=True, eq=False)
class BodyShape:
    """Extents of a body at rest: floor at y = 0, hips above the origin, facing +Z; lengths as its maker chose."""

    heights: Floats
    """(LEVELS,) of the ellipses, rising."""
    half_widths: Floats
    """(LEVELS,) along x."""
    half_depths: Floats
    """(LEVELS,) along z."""
    depths: Floats
    """(LEVELS,) z of the middles."""
    thighs: Floats
    """(2, CIRCLES) radii from hip to knee, left and right; zero where nothing was measured."""
    forearm: float
    """Radius that keeps away."""
    palms: Floats
    """(2, 3) middles of the hands, left and right."""

    def scaled(self, factor: float) -> BodyShape:
        """Multiply all lengths."""
        return BodyShape(
            self.heights * factor,
            self.half_widths * factor,
            self.half_depths * factor,
            self.depths * factor,
            self.thighs * factor,
            self.forearm * factor,
            self.palms * factor,
        )


def parts_of_nodes(rig: Rig, bones: Mapping[str, int], spine: Sequence[int], points: Floats) -> dict[int, str]:
    """Say of each node which part of the body moves with it: `TRUNK`, "left_hip", "left_elbow" ..., or none.

    Args:
        rig: of the character.
        bones, spine: of its `Humanoid`.
        points: (nodes, 3) at rest, hips above the origin, facing +Z.

    Returns:
        Node -> part; nodes of other parts are missing.
    """
    named = {node: name for name, node in bones.items()} | dict.fromkeys((*spine, bones["pelvis"]), TRUNK)
    reach = max(abs(float(points[bones[f"{side}_shoulder"], 0])) for side in SIDES)
    middle = points[bones["pelvis"]]
    parts: dict[int, str] = {}
    for node in rig.order:
        part = named.get(node) or parts.get(rig.parents[node], "")
        # extra joints of the trunk that lie far out move wings, capes or tails
        far = node not in named and part == TRUNK and np.abs(points[node] - middle)[[0, 2]].max() > reach
        if part and not far:
            parts[node] = part
    return parts


def fit_shape(points: Floats, parts: NDArray[np.str_], joints: Floats, bones: Mapping[str, int]) -> BodyShape | None:
    """Measure a body.

    Args:
        points: (n, 3) spread evenly over the skin at rest: floor at y = 0, hips above the origin, facing +Z.
        parts: (n,) part of each, see `parts_of_nodes`; "" for others.
        joints: (nodes, 3) at rest in the same frame.
        bones: nodes that follow our joints.

    Returns:
        None where trunk or forearms have too few points.
    """
    trunk = points[parts == TRUNK]
    shoulders = np.stack([joints[bones[f"{side}_shoulder"]] for side in SIDES])
    elbows, wrists = (np.stack([joints[bones[f"{side}_{joint}"]] for side in SIDES]) for joint in ("elbow", "wrist"))
    arms = [_distances(points[parts == f"{side}_elbow"], elbows[i], wrists[i])[0] for i, side in enumerate(SIDES)]
    if len(trunk) < ENOUGH or min(map(len, arms)) < ENOUGH:
        return None
    low, high = float(np.quantile(trunk[:, 1], 0.01)), float(shoulders[:, 1].mean())
    if not low < high:
        return None
    edges = np.linspace(low, high, LEVELS + 1)
    sections = _sections(trunk, edges, WIDEST * float(np.abs(shoulders[:, 0]).max()))
    if sections is None:
        return None
    thighs = np.zeros((2, CIRCLES))
    palms = wrists + 0.3 * (wrists - elbows)
    for index, side in enumerate(SIDES):
        hip, knee = joints[bones[f"{side}_hip"]], joints[bones[f"{side}_knee"]]
        thighs[index] = _radii(points[parts == f"{side}_hip"], hip, knee)
        if (hand := parts == f"{side}_wrist").sum() >= ENOUGH:
            palms[index] = points[hand].mean(axis=0)
    radius = FLESH * float(np.median(np.concatenate(arms)))
    return BodyShape((edges[1:] + edges[:-1]) / 2, *sections, thighs, radius, palms)


def _sections(trunk: Floats, edges: Floats, widest: float) -> tuple[Floats, Floats, Floats] | None:
    """Fit an ellipse to the points between every two edges: half widths, half depths and middles in depth."""
    level = np.digitize(trunk[:, 1], edges) - 1
    rows = np.full((len(edges) - 1, 3), np.nan)
    for index in range(len(rows)):
        x, z = np.abs(trunk[level == index, 0]), trunk[level == index, 2]
        if len(x) < ENOUGH // 4:
            continue
        back, front = np.quantile(z, (1.0 - FULL, FULL))
        width, depth, middle = max(np.quantile(x, FULL), 1e-9), max((front - back) / 2, 1e-9), (front + back) / 2
        corner = float(np.quantile(np.hypot(x / width, (z - middle) / depth), 0.9))
        rows[index] = np.array([width, depth, middle]) * (*[np.clip(corner, 1.0, SQUARE)] * 2, 1.0)
    known = ~np.isnan(rows[:, 0])
    if not known.any():
        return None
    places = np.arange(len(rows))
    filled = [np.interp(places, places[known], column[known]) for column in rows.T]
    return np.minimum(filled[0], widest), filled[1], filled[2]


def _distances(points: Floats, start: Floats, end: Floats) -> tuple[Floats, Floats]:
    """Compute distances (n,) from a bone, and places (n,) along it, of the points beside it."""
    bone = end - start
    along = (points - start) @ bone / max(float(bone @ bone), 1e-18)
    beside = (along > 0.1) & (along < 0.9)
    foot = start + along[beside, None] * bone
    return np.linalg.norm(points[beside] - foot, axis=-1), along[beside]


def _radii(points: Floats, hip: Floats, knee: Floats) -> Floats:
    """Measure the radii (CIRCLES,) of a thigh; zero where nothing is bound to it."""
    distances, along = _distances(points, hip, knee)
    if len(distances) < ENOUGH:
        return np.zeros(CIRCLES)
    circle = np.minimum((along * CIRCLES).astype(int), CIRCLES - 1)
    every = float(np.median(distances))
    return np.array([np.median(distances[circle == i]) if (circle == i).any() else every for i in range(CIRCLES)])
