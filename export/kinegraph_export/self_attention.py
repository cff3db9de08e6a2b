"""Self-attention under the names of a checkpoint: CLIP's text tower and DistilBERT differ in nothing else."""

from __future__ import annotations

from torch import Tensor, nn

from kinegraph_training.models.transformer import attend, merge_heads, split_heads


class NamedSelfAttention(nn.Module):
    """Multi-head self-attention with four projections (Vaswani et al., 2017, section 3.2.2).

    Args:
        width: d, of states.
        heads: which divide it.
        names: of the projections to queries, keys and values, and of the one behind the heads.
    """

    def __init__(self, width: int, heads: int, names: tuple[str, str, str, str]) -> None:
        super().__init__()
        self.heads, self.names = heads, names
        for name in names:
            self.add_module(name, nn.Linear(width, width))

    def forward(self, x: Tensor, bias: Tensor) -> Tensor:
        """Attend from states (b, t, d) to themselves under a bias (b, 1, 1 or t, t)."""
        *inputs, out = (self.get_submodule(name) for name in self.names)
        query, key, value = (split_heads(part(x), self.heads) for part in inputs)
        attended: Tensor = out(merge_heads(attend(query, key, value, bias)))
        return attended
