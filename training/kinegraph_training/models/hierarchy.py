"""Graph encoder and the three denoisers as one module, which the diffusion stage trains."""

from __future__ import annotations

from dataclasses import dataclass

from torch import Tensor, nn

from kinegraph_training.models.concat_denoiser import ConcatDenoiser
from kinegraph_training.models.denoiser import Denoiser, DenoiserConfig, LatentShape
from kinegraph_training.models.frame_denoiser import FrameDenoiser
from kinegraph_training.models.graph_encoder import GraphEncoder


@dataclass(frozen=True)
class GraphBatch:
    """Batch of b graphs, padded to n nodes; see `kinegraph.conditioning.GraphArrays`."""

    nodes: Tensor
    """(b, n, D)."""
    relation: Tensor
    """(b, n, n)."""
    edge_weight: Tensor
    """(b, n, n)."""
    node_mask: Tensor
    """(b, n) 1 for nodes, 0 for padding."""
    kind: Tensor
    """(b, n)."""
    order: Tensor
    """(b, n)."""


class Hierarchy(nn.Module):
    """Denoisers from coarse to fine, each conditioned on the graph and on the latent of the level above."""

    def __init__(self, config: DenoiserConfig, latents: dict[str, LatentShape]) -> None:
        super().__init__()
        self.config, self.latents = config, latents
        self.graph_encoder = GraphEncoder(config.text_width)
        shapes = list(latents.values())
        kind = {"cross": Denoiser, "frames": FrameDenoiser, "concat": ConcatDenoiser}[config.kind]
        self.levels = nn.ModuleDict(
            {
                level: kind(config, shape, shapes[index - 1] if index else None)
                for index, (level, shape) in enumerate(latents.items())
            }
        )

    def encode(self, graph: GraphBatch) -> Tensor:
        """Compute node features (b, n, D), by graph attention unless the configuration does without."""
        if self.config.condition != "graph" or not self.config.reasoning:
            return graph.nodes
        return self.graph_encoder(graph.nodes, graph.relation, graph.edge_weight, graph.node_mask)
