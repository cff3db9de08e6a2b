"""Inputs and outputs of the graphs of released networks, GraphMotion's and MLD's, in the terms of `bundle.contract`.

Latent, time and conditions are one sequence of tokens there ("concat"), so each level has as many conditions as slots.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

from kinegraph.bundle.contract import (
    COARSE_DECODERS,
    INT,
    LEVELS,
    Family,
    GraphContract,
    LevelSpec,
    TensorSpec,
    decoder,
    levels_of,
    text_encoder,
)
from kinegraph.graph import ROLES

SLOTS: Final[Mapping[str, int]] = {"motion": 1, "action": 4, "specific": 8}
"""Nodes of each kind that released networks have room for; further ones are left out."""

SLOT_COUNT: Final = sum(SLOTS.values())


def slots_seen(level: LevelSpec) -> int:
    """Count the slots that a level of a released network sees; they are the first ones."""
    return sum(SLOTS[kind] for kind in level.nodes)


def released_graph_encoder(text_width: int) -> GraphContract:
    """Declare the graph attention of the released GraphMotion, over all `SLOTS` at once.

    `adjacency` is 1 where there is an edge, `relations` where there is one of a type of `graph.ROLES`.

    Args:
        text_width: D.
    """
    slots = SLOT_COUNT
    inputs = (
        TensorSpec("nodes", ("B", slots, text_width)),
        TensorSpec("adjacency", ("B", slots, slots)),
        TensorSpec("relations", ("B", len(ROLES), slots, slots)),
    )
    return GraphContract("graph_encoder", inputs, (TensorSpec("nodes_out", ("B", slots, text_width)),))


def released_level(name: str, level: LevelSpec, text_width: int, coarse: LevelSpec | None) -> tuple[GraphContract, ...]:
    """Declare the three graphs of a released level: condition tokens, time tokens, denoiser.

    Condition tokens (the coarser latent's first, positions included) are computed once per level, time tokens once for
    all K steps. `mask` is 1 on the conditions that a row has.

    Args:
        name: of the level.
        level: dimensions of that level.
        text_width: D.
        coarse: the coarser level, whose latent is an input; None at the coarsest.
    """
    nodes = (TensorSpec("nodes", ("R", slots_seen(level), text_width)),)
    latents = () if coarse is None else (TensorSpec("coarse", ("R", coarse.tokens, coarse.latent_width)),)
    count = slots_seen(level) + (0 if coarse is None else coarse.tokens)
    latent = ("R", level.tokens, level.latent_width)
    condition = TensorSpec("condition", ("R", count, level.width))
    inputs = (
        TensorSpec("latent", latent),
        TensorSpec("time", ("R", level.width)),
        condition,
        TensorSpec("mask", ("R", count)),
    )
    timestep, time = TensorSpec("timestep", ("K",), INT), TensorSpec("time", ("K", level.width))
    return (
        GraphContract(f"context_{name}", nodes + latents, (condition,)),
        GraphContract(f"modulation_{name}", (timestep,), (time,)),
        GraphContract(f"denoiser_{name}", inputs, (TensorSpec("noise", latent),)),
    )


def released_contracts(
    family: Family, levels: Mapping[str, LevelSpec], text_width: int, features: int
) -> dict[str, GraphContract]:
    """Declare every graph of a bundle with released networks, as `contracts` does for our own.

    Args:
        family: not "kinegraph".
        levels: one spec for each level that the family has (`levels_of`).
        text_width: D.
        features: F, width of the feature layout.
    """
    graphs = [text_encoder(text_width), *([] if family == "mld" else [released_graph_encoder(text_width)])]
    coarse: LevelSpec | None = None
    for name in levels_of(family):
        graphs += released_level(name, levels[name], text_width, coarse)
        coarse = levels[name]
    graphs.append(decoder("decoder", levels[LEVELS[-1]], features))
    graphs += [decoder(graph, levels[level], features) for level, graph in COARSE_DECODERS.items() if level in levels]
    return {graph.name: graph for graph in graphs}
