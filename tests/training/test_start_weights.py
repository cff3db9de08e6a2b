"""New layers, kinds and tokens beside trained weights."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

torch = pytest.importorskip("torch")
pytest.importorskip("lightning")

from kinegraph.bundle.contract import KINDS
from kinegraph_training.models.denoiser import DenoiserConfig, LatentShape
from kinegraph_training.models.hierarchy import Hierarchy
from kinegraph_training.trainer import load_start_weights

OLD = DenoiserConfig(width=16, layers=3, heads=2, feed_forward=32, text_width=12)
NEW = replace(OLD, words=True, context_layers=2, nodes_seen="all")
LEVELS = {"motion": LatentShape(2, 4), "action": LatentShape(4, 4), "specific": LatentShape(8, 4)}
FINER = {"motion": LatentShape(4, 4), "action": LatentShape(8, 4), "specific": LatentShape(8, 4)}


@pytest.fixture
def checkpoint(tmp_path: Path) -> tuple[Path, Hierarchy]:
    torch.manual_seed(3)
    old = Hierarchy(OLD, LEVELS)
    state = {f"hierarchy.{name}": value for name, value in old.state_dict().items()}
    for name in state:  # a checkpoint of before words and partial captions
        if name.endswith(".kind.weight"):
            state[name] = state[name][: KINDS["word"]]
    path = tmp_path / "old.ckpt"
    torch.save({"state_dict": state}, path)
    return path, old


def test_new_layers_change_nothing_at_first(checkpoint: tuple[Path, Hierarchy]) -> None:
    path, old = checkpoint
    new = Hierarchy(NEW, LEVELS)
    load_start_weights(new, path, "hierarchy.")
    nodes, kind, order = torch.randn(2, 5, 12), torch.randint(0, 4, (2, 5)), torch.randint(0, 3, (2, 5))
    coarse, bias = torch.randn(2, 2, 4), torch.zeros(2, 7)
    expected = old.levels["action"].eval().context(nodes, kind, order, bias, coarse)
    found = new.levels["action"].eval().context(nodes, kind, order, bias, coarse)
    for (key, value), (other_key, other_value) in zip(expected, found, strict=True):
        torch.testing.assert_close(key, other_key)
        torch.testing.assert_close(value, other_value)


def test_latents_of_twice_the_tokens_start_with_each_of_them_twice(checkpoint: tuple[Path, Hierarchy]) -> None:
    path, old = checkpoint
    new = Hierarchy(NEW, FINER)
    load_start_weights(new, path, "hierarchy.")
    for part in ("context.coarse_position", "step.position"):
        before, after = (dict(each.levels["action"].named_parameters())[part] for each in (old, new))
        torch.testing.assert_close(after, before.repeat_interleave(2, dim=0))
