"""Graph attention of the released GraphMotion, whose numbers differ from Eq. 1-3 of its paper.

- The softmax runs over the receiving nodes: each *column* of the attention sums to 1.
- Scores of typed edges count a hundredth.
- Nodes that are not there are not masked: one without edges sends 1/13 of its feature to every node.

Weights were trained so, and fit nothing else. `kinegraph_training.models.graph_encoder` is the paper's.

Shapes: b graphs, k = 13 nodes, D width, 12 edge types in the order of `kinegraph.graph.ROLES`.
"""

from __future__ import annotations

import torch
from torch import Tensor, nn
from torch.nn import functional

from kinegraph.graph import MOTION_ACTION, ROLES

TYPE_SCALE = 0.01
"""Factor of the scores of typed edges."""
NO_EDGE = -9e15
"""Score where there is no edge; in float32 it swallows any score that is added."""


def parameter_name(role: str) -> str:
    """Return the checkpoint's name of an edge type's vector."""
    return "MA" if role == MOTION_ACTION else role.replace("-", "_")


class ReleasedGraphAttention(nn.Module):
    """One layer, one head; symbols as in the checkpoint: `W`, `a`, and a vector for each edge type."""

    def __init__(self, width: int) -> None:
        super().__init__()
        self.W = nn.Parameter(torch.empty(width, width))
        self.a = nn.Parameter(torch.empty(2 * width, 1))
        for role in ROLES:
            self.register_parameter(parameter_name(role), nn.Parameter(torch.empty(2 * width, 1)))

    def forward(self, nodes: Tensor, adjacency: Tensor, relations: Tensor) -> Tensor:
        """Let nodes attend to one another.

        Args:
            nodes: (b, k, D).
            adjacency: (b, k, k) 1 where there is an edge.
            relations: (b, 12, k, k) 1 where there is an edge of a type; a pair may have several.

        Returns:
            (b, k, D).
        """
        width = nodes.shape[-1]
        h = nodes @ self.W
        vectors = torch.cat([self.a, *(getattr(self, parameter_name(role)) for role in ROLES)], dim=1)
        receiving, sending = h @ vectors[:width], h @ vectors[width:]  # (b, k, 1 + 12)
        scores = functional.leaky_relu(receiving[:, :, None] + sending[:, None], 0.2).permute(0, 3, 1, 2)
        base = torch.where(adjacency > 0, scores[:, 0], torch.full_like(scores[:, 0], NO_EDGE))
        typed = (scores[:, 1:] * (relations > 0).to(scores.dtype)).sum(dim=1)
        attention = torch.softmax(base + TYPE_SCALE * typed, dim=1)  # over the receiving node i
        return functional.elu(attention @ h) + nodes
