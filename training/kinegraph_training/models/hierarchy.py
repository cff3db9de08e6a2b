"""Graph encoder and the three denoisers as one module: what the diffusion stage trains."""

from __future__ import annotations

from dataclasses import dataclass

from torch import Tensor, nn

from kinegraph_training.models.concat_denoiser import ConcatDenoiser
from kinegraph_training.models.denoiser import Denoiser, DenoiserConfig, LatentShape
from kinegraph_training.models.graph_encoder import GraphEncoder


@dataclass(frozen=True)
class GraphBatch:
    """b graphs of n nodes as tensors; see kinegraph.conditioning.GraphArrays."""

    nodes: Tensor
    relation: Tensor
    edge_weight: Tensor
    node_mask: Tensor
    kind: Tensor
    order: Tensor


class Hierarchy(nn.Module):
    """Levels coarse to fine, each conditioned on the graph and on the latent of the level above."""

    def __init__(self, config: DenoiserConfig, latents: dict[str, LatentShape]) -> None:
        super().__init__()
        self.config, self.latents = config, latents
        self.graph_encoder = GraphEncoder(config.text_width)
        shapes = list(latents.values())
        kind = Denoiser if config.kind == "cross" else ConcatDenoiser
        self.levels = nn.ModuleDict(
            {
                level: kind(config, shape, shapes[index - 1] if index else None)
                for index, (level, shape) in enumerate(latents.items())
            }
        )

    def encode(self, graph: GraphBatch) -> Tensor:
        """Node features (b, n, D), after graph attention where there is a graph to reason over."""
        if self.config.condition != "graph" or not self.config.reasoning:
            return graph.nodes
        return self.graph_encoder(graph.nodes, graph.relation, graph.edge_weight, graph.node_mask)
