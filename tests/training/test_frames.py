"""Skeleton space in training: groups of frames as latents, padding that nobody sees, a run that stops and goes on."""

from __future__ import annotations

import argparse
import shutil
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

torch = pytest.importorskip("torch")
pytest.importorskip("lightning")
pytest.importorskip("spacy")

from kinegraph.bundle.contract import FRAMES, NODE_KINDS, PADDING_BIAS
from kinegraph.bundle.reader import read_bundle
from kinegraph.errors import InvalidInputError
from kinegraph_training import train_frames
from kinegraph_training.checkpoints import read_checkpoint
from kinegraph_training.config import FrameConfig, read_preset
from kinegraph_training.data.caption_cache import CaptionStates
from kinegraph_training.denoiser_batches import SimilarLengths, caption_sizes
from kinegraph_training.frame_batches import FrameBatches
from kinegraph_training.frame_module import FrameModule, squared_error_of_frames, squared_error_of_steps
from kinegraph_training.models.denoiser import DenoiserConfig, LatentShape
from kinegraph_training.models.frame_denoiser import FrameDenoiser, SeamSmoothing, group_frames, hide_padding
from kinegraph_training.trainer import load_start_weights
from support.toy_run import ASSETS, run_stage, steps_of

CONFIG = DenoiserConfig(width=16, layers=4, heads=2, feed_forward=32, text_width=12, dropout=0.0)


def frame_denoiser() -> FrameDenoiser:
    torch.manual_seed(5)
    denoiser = FrameDenoiser(replace(CONFIG, frames_per_token=2), LatentShape(tokens=9, width=6)).eval()
    torch.nn.init.normal_(denoiser.clock.out.weight, std=0.2)
    torch.nn.init.normal_(denoiser.step.seams.features_out.weight, std=0.2)
    return denoiser


@torch.no_grad()
def test_a_network_takes_any_number_of_frames_and_never_sees_padding() -> None:
    denoiser = frame_denoiser()
    nodes, kind = torch.randn(2, 3, 12), torch.randint(0, 3, (2, 3))
    bias = torch.zeros(2, 3)
    context = denoiser.context(nodes, kind, torch.zeros_like(kind), bias)
    modulation = denoiser.clock(torch.tensor([30, 30]), torch.tensor([20, 20]))
    noisy = torch.randn(2, 7, 6)
    given = (modulation, context, bias[:, None, None])
    alone = denoiser.step(noisy[:, :5], *given)
    assert alone.shape == (2, 5, 6)
    mask = torch.tensor([1.0] * 5 + [0.0] * 2).expand(2, -1)
    padded = denoiser.step(noisy, *given, padding=hide_padding(mask, PADDING_BIAS))
    torch.testing.assert_close(padded[:, :5], alone, atol=1e-5, rtol=0)
    assert not torch.allclose(denoiser.step(noisy, *given)[:, :5], alone, atol=1e-3), "padding would be seen"


@torch.no_grad()
def test_seams_are_mended_across_groups_and_not_at_first() -> None:
    torch.manual_seed(6)
    seams, groups = SeamSmoothing(features=3), torch.randn(1, 5, 12)
    torch.testing.assert_close(seams(groups), groups)
    torch.nn.init.normal_(seams.features_out.weight, std=0.5)
    changed = groups.clone()
    changed[0, 2, :3] += 1.0  # the first frame of the third group
    moved = (seams(changed) - seams(groups)).reshape(20, 3).abs().amax(dim=1) > 1e-6
    assert moved[7] and moved[8] and not moved[0] and not moved[19]
    assert FrameDenoiser(CONFIG, LatentShape(tokens=9, width=6)).step.seams is None, "single frames have no seams"


def test_weights_from_before_the_seams_were_mended_still_start_a_run(tmp_path: Path) -> None:
    shape, config = LatentShape(tokens=9, width=6), replace(CONFIG, frames_per_token=2)
    old, new = FrameDenoiser(config, shape), FrameDenoiser(config, shape)
    state = {name: value for name, value in old.state_dict().items() if ".seams." not in name}
    torch.save({"state_dict": state, "hyper_parameters": {}}, tmp_path / "old.ckpt")
    load_start_weights(new, tmp_path / "old.ckpt", "")
    assert torch.equal(new.step.noise_out.weight, old.step.noise_out.weight)


def test_groups_hold_the_features_of_their_frames_in_order() -> None:
    features = torch.arange(2 * 8 * 3).reshape(2, 8, 3)
    groups = group_frames(features, 4)
    assert groups.shape == (2, 2, 12)
    assert groups[1, 1].tolist() == features[1, 4:].flatten().tolist()


def test_the_loss_weighs_the_root_and_leaves_out_padding() -> None:
    generator = torch.Generator().manual_seed(0)
    predicted, clean = (torch.randn(2, 3, 2 * 6, generator=generator) for _ in range(2))
    mask = torch.tensor([[1.0, 1.0, 1.0], [1.0, 0.0, 0.0]])
    expected = []
    for row in range(2):
        total, weights = 0.0, 0.0
        for token in range(3):
            for number in range(12):
                weight = float(mask[row, token]) * (4.0 if number % 6 < 4 else 1.0)
                total += weight * float(predicted[row, token, number] - clean[row, token, number]) ** 2
                weights += weight
        expected.append(total / weights)
    np.testing.assert_allclose(squared_error_of_frames(predicted, clean, mask, 6).numpy(), expected, rtol=1e-5)


def test_steps_from_frame_to_frame_count_where_both_frames_do() -> None:
    torch.manual_seed(4)
    predicted, clean = torch.randn(2, 3, 10), torch.randn(2, 3, 10)  # groups of two frames of five features
    mask = torch.tensor([[1.0, 1.0, 1.0], [1.0, 1.0, 0.0]])
    expected = []
    for row, frames in ((0, 6), (1, 4)):
        right, wrong = (x[row].reshape(6, 5).numpy() for x in (clean, predicted))
        steps = [(wrong[k + 1] - wrong[k]) - (right[k + 1] - right[k]) for k in range(frames - 1)]
        expected.append(np.mean(np.square(steps)))
    np.testing.assert_allclose(squared_error_of_steps(predicted, clean, mask, 5).numpy(), expected, rtol=1e-5)
    assert float(squared_error_of_steps(clean + 1, clean, mask, 5).max()) < 1e-10  # no trembling, no error


def test_batches_are_of_clips_of_similar_length() -> None:
    torch.manual_seed(0)
    lengths = np.random.default_rng(0).integers(16, 197, 300)
    weights = np.where(np.arange(300) < 100, 0.0, 1.0)
    batches = list(SimilarLengths(lengths, weights, batch=8, batches=20))
    assert [len(batch) for batch in batches] == [8] * 20
    drawn = np.array(batches)
    assert drawn.min() >= 100, "a clip of weight 0 was drawn"
    spread = np.ptp(lengths[drawn], axis=1).mean()
    assert spread < 0.4 * np.ptp(lengths[100:]), f"{spread:.0f} frames of padding"
    order = [lengths[batch].mean() for batch in batches]
    assert order != sorted(order)


def test_captions_are_as_long_as_their_tokens() -> None:
    graphs = CaptionStates(["one", "two", "three"], np.array([0, 4, 10, 12]), np.zeros((12, 3), dtype=np.float16))
    clips = [SimpleNamespace(captions=["one", "two"]), SimpleNamespace(captions=["three"])]
    np.testing.assert_array_equal(caption_sizes(clips, graphs), [5.0, 2.0])


def test_the_paper_preset_is_the_papers_network() -> None:
    preset = read_preset("paper")
    config = preset.frames.denoiser(preset.denoiser)
    assert (config.layers, config.width, preset.frames.frames_per_token) == (8, 512, 1)
    assert config.kinds_seen(FRAMES) == NODE_KINDS[:3]
    edge = read_preset("edge")
    assert edge.frames.denoiser(edge.denoiser).width == edge.denoiser.width
    shape = LatentShape(196, 137)
    module = FrameModule(replace(config, width=32, heads=2), preset.frames_training, {FRAMES: shape}, preset.frames)
    assert len(module.hierarchy.levels[FRAMES].step.joins) == 4


@pytest.fixture(scope="module")
def run(trained: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A copy of the toy's run, with skeleton space trained for twenty steps in two starts."""
    folder = tmp_path_factory.mktemp("frames")
    (folder / "data").symlink_to(trained / "data")
    shutil.copytree(trained / "run", folder / "run")
    preset = folder / "short.toml"
    preset.write_text('base = "tiny"\n[frames_training]\nsteps = 20\nlearning_rate = 3e-3\n')
    words = ["--assets", str(ASSETS), "--preset", str(preset), "--val_check_interval", "10"]
    run_stage(train_frames, folder, *words, "--max_steps", "10")
    assert steps_of(folder / "run" / "frames" / "last.ckpt") == 10
    run_stage(train_frames, folder, *words)
    return folder


def test_a_run_goes_on_and_learns(run: Path) -> None:
    assert steps_of(run / "run" / "frames" / "last.ckpt") == 20
    lines = (run / "run" / "frames" / "curves" / "metrics.csv").read_text().splitlines()
    rows = [dict(zip(lines[0].split(","), line.split(","), strict=True)) for line in lines[1:]]
    values = [float(row["val/frames"]) for row in rows if row.get("val/frames")]
    assert len(values) == 2 and values[1] < 0.9 * values[0]


def test_the_graph_encoder_stays_that_of_the_bundle(run: Path) -> None:
    latent, frames = (read_checkpoint(run / "run" / name / "last.ckpt")["state_dict"] for name in ("denoisers", FRAMES))
    names = [name for name in latent if name.startswith("hierarchy.graph_encoder.")]
    assert names and all(torch.equal(latent[name], frames[name]) for name in names)
    moved = f"hierarchy.levels.{FRAMES}.context.node_in.weight"
    lent = latent["hierarchy.levels.specific.context.node_in.weight"]
    assert not torch.equal(frames[moved], lent) and torch.allclose(frames[moved], lent, atol=0.1), "not borrowed"


def test_a_run_without_latent_denoisers_is_refused(trained: Path, tmp_path: Path) -> None:
    (tmp_path / "data").symlink_to(trained / "data")
    (tmp_path / "run").mkdir()
    with pytest.raises(InvalidInputError, match="latent denoisers"):
        run_stage(train_frames, tmp_path, "--assets", str(ASSETS))


def test_mdms_network_trains_its_own_graph_encoder_and_is_sampled_in_torch(trained: Path, tmp_path: Path) -> None:
    pytest.importorskip("onnxscript")
    from kinegraph_benchmarks.common.torch_model import FramesRun, TorchModel
    from kinegraph_export.add_frames import check_fits, read_frames

    (tmp_path / "data").symlink_to(trained / "data")
    (tmp_path / "run").mkdir()
    for name in ("vae_specific", "tables.npz"):
        (tmp_path / "run" / name).symlink_to(trained / "run" / name)
    preset = tmp_path / "mdm.toml"
    own = 'kind = "concat"\nframes_per_token = 1\nfrom_latent = false\n'
    preset.write_text(f'base = "tiny"\n[frames]\n{own}[frames_training]\nsteps = 4\nema = 0.5\n')
    run_stage(train_frames, tmp_path, "--assets", str(ASSETS), preset=str(preset))
    found = read_frames(tmp_path / "run" / FRAMES / "last.ckpt")
    assert found.denoiser.step.position.shape[0] == found.latent.tokens == 196
    state = read_checkpoint(tmp_path / "run" / FRAMES / "last.ckpt")
    learnt = set(state["optimizer_states"][0]["state"])
    assert len(learnt) == len(list(found.hierarchy.parameters())), "the graph encoder is not trained"
    model = TorchModel(tmp_path / "run")
    assert isinstance(model.run, FramesRun)
    clips = [model.generate("a person walks", seconds=seconds, seed=1).joints for seconds in (1.0, 2.05)]
    assert [len(joints) for joints in clips] == [20, 41] and all(np.isfinite(joints).all() for joints in clips)
    with pytest.raises(InvalidInputError, match="trained over its graph encoder"):
        check_fits(found, read_bundle(None).manifest)


def test_batches_hold_whole_groups_and_null_captions_keep_their_frames(run: Path) -> None:
    preset = read_preset("tiny")
    arguments = argparse.Namespace(data=run / "data", held_out=None, more=[])
    config = replace(preset.data, splices=0, sequences=0)
    clips = train_frames.load_clips(arguments, config, train_frames.layout_of(137))
    captions = train_frames.encode_captions(clips, "graph", ASSETS, run / "run", verb_masking=False)
    frames = FrameConfig(frames_per_token=4, scale=0.25)
    batches = FrameBatches(clips.train, frames, captions.graphs, seed=0, augment=False)
    batch = batches([0, 3])
    lengths = clips.train.lengths[[0, 3]] // 4
    assert batch.frames.tolist() == (4 * lengths).tolist()
    assert batch.token_mask.sum(dim=1).tolist() == lengths.tolist()
    rows = clips.train.features[3][: 4 * lengths[1]]
    found = batch.latents[FRAMES][1, : lengths[1]].reshape(-1, 137)
    np.testing.assert_allclose(found.numpy(), 0.25 * rows, atol=1e-6)
    assert batch.without_text().token_mask is batch.token_mask
    assert batch.to(torch.device("cpu")).latents[FRAMES].shape == batch.latents[FRAMES].shape
