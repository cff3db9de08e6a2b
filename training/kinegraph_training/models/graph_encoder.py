"""Action-aware graph reasoning (GraphMotion, section 3.1, Eq. 1-3)."""

from __future__ import annotations

import torch
from torch import Tensor, nn
from torch.nn import functional

from kinegraph.bundle.contract import PADDING_BIAS
from kinegraph.graph import ROLES


class GraphEncoder(nn.Module):
    """One graph attention layer with relational scores; b graphs, n nodes, D width, r = 12 edge types.

    Symbols of the paper: W `transform`, M `common` (its halves act on h_i and h_j), M_r `relational`.
    """

    def __init__(self, width: int) -> None:
        super().__init__()
        self.transform = nn.Linear(width, width, bias=False)
        self.common = nn.Parameter(torch.randn(2, width) * width**-0.5)
        self.relational = nn.Parameter(torch.randn(2, width, len(ROLES)) * width**-0.5)

    def forward(self, nodes: Tensor, relation: Tensor, edge_weight: Tensor, node_mask: Tensor) -> Tensor:
        """Compute Eq. 1-3 with the edge weight w as a log-prior: e~_ij = w_ij exp(e_ij) / sum_k w_ik exp(e_ik).

        Args:
            nodes: (b, n, D) v.
            relation: (b, n, n) edge type, -1 where j is not a neighbour of i.
            edge_weight: (b, n, n) w >= 0; 0 removes the edge.
            node_mask: (b, n) 1 for nodes.

        Returns:
            (b, n, D), 0 on padding.
        """
        h = self.transform(nodes)
        types = torch.arange(len(ROLES), device=relation.device)
        one_hot = (relation[..., None] == types).to(h.dtype)
        common = (h @ self.common[0])[:, :, None] + (h @ self.common[1])[:, None, :]
        pair = (h @ self.relational[0])[:, :, None, :] + (h @ self.relational[1])[:, None, :, :]
        relational = (one_hot * pair).sum(dim=-1)
        scores = functional.leaky_relu(common, 0.2) + functional.leaky_relu(relational, 0.2)
        neighbour = (relation >= 0) & (edge_weight > 0)
        # The clamp keeps log away from 0; entries of weight 0 are masked below.
        scores = scores + torch.log(edge_weight.clamp(min=1e-38))
        scores = torch.where(neighbour, scores, torch.full_like(scores, PADDING_BIAS))
        attention = torch.softmax(scores, dim=-1)
        return (functional.elu(attention @ h) + nodes) * node_mask[..., None]
