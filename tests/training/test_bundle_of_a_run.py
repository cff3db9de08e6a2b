"""A toy's run as a bundle, and the bundle as a run again: what is exported is what was trained."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

torch = pytest.importorskip("torch")
pytest.importorskip("lightning")
pytest.importorskip("onnxscript")
pytest.importorskip("spacy")

import kinegraph
from kinegraph import Concept, MotionPipeline
from kinegraph.bundle.contract import LEVELS, contracts
from kinegraph.bundle.manifest import Licence
from kinegraph.bundle.reader import read_bundle
from kinegraph.concepts import METHODS
from kinegraph.diffusion.sampling import LevelPlan, initial_noise
from kinegraph.edits import with_weight, without
from kinegraph.errors import BundleError, InvalidInputError
from kinegraph.motion.postprocess import enforce_bone_lengths
from kinegraph_export.apply_card import apply_card
from kinegraph_export.checkpoints import read_run
from kinegraph_export.export_bundle import BundleCard, export_bundle
from kinegraph_export.pipeline_parity import SamplingRequest, torch_joints
from kinegraph_export.recover import coarse_statistics, recover, recover_autoencoder, store_encoder
from kinegraph_training.config import read_preset
from kinegraph_training.latents import read_vae
from kinegraph_training.models.vae import ENCODER_PARTS
from support.toy_run import ASSETS
from support.tracing import Traces

WEIGHTS = Path(__file__).parents[2] / "weights" / "studio"
pytestmark = [pytest.mark.slow, pytest.mark.timeout(1200), pytest.mark.usefixtures("traces")]

CARD = BundleCard(
    name="toy",
    version="0",
    licence=Licence(*["public domain"] * 5),
    training_data="made by the tests",
    scope={"actions": "walk"},
    training={"preset": "tiny"},
    steps={"motion": 2, "action": 2, "specific": 3},
    guidance={"motion": 2.0, "action": 2.0, "specific": 2.0},
    guidance_base="coarse",
    seconds=2.0,
    quality={},
)


@pytest.fixture(scope="module")
def encoders(trained: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of the encoders alone, as `weights/studio` holds them."""
    folder = tmp_path_factory.mktemp("encoders")
    for level in LEVELS:
        store_encoder(trained / "run" / f"vae_{level}" / "last.ckpt", folder / f"vae_{level}.ckpt")
    return folder


@pytest.fixture(scope="module")
def bundle(trained: Path, traces: Traces, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("exported") / "bundle"
    export_bundle(trained / "run", ASSETS, CARD, folder, "fp32")
    return folder


def test_the_bundle_makes_a_clip_and_states_its_parity(bundle: Path) -> None:
    pipe = MotionPipeline.load(bundle, threads=1)
    clip = pipe.generate("a person walks to the left", seed=1)
    assert clip.joints.shape[1:] == (22, 3) and np.isfinite(clip.joints).all()
    # The sentence decides the length: the toy's clips have 40 to 100 frames.
    assert 35 <= clip.frames <= 110
    assert pipe.generate("a person walks to the left", seconds=2, seed=1).frames == 40
    parity = pipe.manifest.parity
    assert parity["pipeline_mm"] <= 1.0
    graphs = {name.removesuffix(".onnx") for name in pipe.manifest.files if name.endswith(".onnx")} - {"text_encoder"}
    assert graphs <= set(parity) and max(parity[name] for name in graphs) <= 1e-4


def test_the_runtime_moves_conditions_as_torch_does(trained: Path, bundle: Path) -> None:
    pipe = MotionPipeline.load(bundle, threads=1)
    graph, agd, sampling = pipe.parse("a person walks to the left"), (0.6, 0.4), pipe.manifest.defaults
    how: dict[str, Any] = {"seconds": 2, "seed": 3, "foot_fix": False}
    moved = pipe.compose([graph], method="latent", agd=agd, **how).joints
    run, own = read_run(trained / "run")
    plans = [LevelPlan(name, spec.tokens, spec.latent_width, 1) for name, spec in pipe.manifest.levels.items()]
    noise = initial_noise(3, plans)
    request = SamplingRequest(len(moved), noise, sampling.steps, sampling.guidance, sampling.guidance_base, agd)
    expected = torch_joints(run, pipe.encoder.encode_text([graph])[0], request, own.mean, own.std)
    np.testing.assert_allclose(moved, enforce_bone_lengths(expected, pipe.decoder.bones), atol=1e-4)
    assert np.abs(moved - pipe.generate(graph, **how).joints).max() > 1e-3
    # One concept of weight 1 is itself by every method, and two in either order are the same motion.
    np.testing.assert_allclose(pipe.compose([graph], agd=agd, **how).joints, moved, atol=1e-4)
    concepts = [Concept("a person walks to the left"), Concept("a person turns right", 0.7)]
    one, other = (pipe.compose(each, text="a person walks", agd=agd, **how) for each in (concepts, concepts[::-1]))
    np.testing.assert_allclose(one.joints, other.joints, atol=1e-4)


def test_the_coarse_decoders_are_those_of_their_autoencoders(trained: Path, bundle: Path) -> None:
    pipe = MotionPipeline.load(bundle, threads=1)
    weights = torch.load(trained / "run" / "denoisers" / "last.ckpt", weights_only=True)["state_dict"]
    rng = np.random.default_rng(0)
    mask = np.ones((2, 48), dtype=np.float32)
    for level in ("motion", "action"):
        own = read_vae(trained / "run" / f"vae_{level}" / "last.ckpt")
        spec = pipe.manifest.levels[level]
        latent = rng.standard_normal((2, spec.tokens, spec.latent_width)).astype(np.float32)
        decoder = pipe.decoder.sessions.coarse_decoders[level]()
        (found,) = decoder.run(["features"], {"latent": latent, "frame_mask": mask})
        plain = torch.from_numpy(latent) * weights[f"{level}_scale"] + weights[f"{level}_centre"]
        with torch.no_grad():
            features = own.vae.decode(plain, torch.from_numpy(mask)).numpy()
        # in metres and radians, each under its own normalisation
        mean, std = (np.array(part) for part in (pipe.manifest.features.mean, pipe.manifest.features.std))
        np.testing.assert_allclose(found * std + mean, features * own.std + own.mean, atol=5e-3)
    shown: list[str] = []
    clip = pipe.generate("a person walks", seconds=2, seed=1, on_level=lambda name, coarse: shown.append(name))
    assert shown == ["motion", "action"] and clip.frames == 40


def test_identities_hold_to_rounding_in_float32(bundle: Path) -> None:
    pipe = MotionPipeline.load(bundle, threads=1)
    walk, turn = "a person walks to the left", "someone turns to the right"
    few: dict[str, Any] = {"seconds": 2, "foot_fix": False}
    plain = pipe.generate(walk, seed=1, **few).joints
    clips = pipe.batch([walk, turn], takes=2, seconds=[2, 3], seed=1, foot_fix=False, shared_run=True)
    alone = [pipe.generate(clip.text, seed=clip.seed, seconds=clip.duration, foot_fix=False) for clip in clips]
    for clip, own in zip(clips, alone, strict=True):
        # Padding changes roundings in the text encoder, whose int8 blocks can then fall on the other side.
        np.testing.assert_allclose(clip.joints, own.joints, atol=1e-3)
    pairs = [(pipe.compose([walk], method=how, seed=1, **few).joints, plain) for how in METHODS]
    both = [Concept(walk), Concept(turn, 0.7)]
    latent, semantic = (pipe.compose(both, method=how, seed=1, **few).joints for how in METHODS[:2])
    pairs.append((pipe.compose(both[::-1], method="latent", seed=1, **few).joints, latent))
    pairs.append((pipe.compose(both, lambdas=(1.0, 0.0, 0.0), seed=1, **few).joints, latent))
    pairs.append((pipe.compose(both, lambdas=(0.0, 1.0, 0.0), seed=1, **few).joints, semantic))
    graph = pipe.parse(walk)
    gone = pipe.generate(without(graph, "to the left"), seed=1, **few).joints
    pairs.append((pipe.generate(with_weight(graph, "to the left", 0.0), seed=1, **few).joints, gone))
    for one, other in pairs:
        np.testing.assert_allclose(one, other, atol=1e-4)
    assert np.abs(latent - semantic).max() > 1e-3


def test_an_int8_bundle_is_smaller_and_near(trained: Path, bundle: Path, encoders: Path, tmp_path: Path) -> None:
    manifest = export_bundle(trained / "run", ASSETS, CARD, tmp_path / "int8", "int8")
    assert manifest.precision == "int8" and "int8" in manifest.provenance["numbers"]
    assert {f"int8_denoiser_{level}" for level in LEVELS} <= manifest.parity.keys()
    sizes = [sum(path.stat().st_size for path in folder.glob("denoiser_*")) for folder in (tmp_path / "int8", bundle)]
    assert sizes[0] < sizes[1]
    clips = [
        MotionPipeline.load(folder, threads=1).generate("a person walks to the left", seconds=2, seed=1).joints
        for folder in (tmp_path / "int8", bundle)
    ]
    assert 1e-6 < np.linalg.norm(clips[0] - clips[1], axis=-1).mean() < 0.1
    recover(tmp_path / "int8", "tiny", encoders, tmp_path / "recovered")
    for level in LEVELS:
        first, again = (
            read_vae(run / f"vae_{level}" / "last.ckpt").vae.state_dict()
            for run in (trained / "run", tmp_path / "recovered")
        )
        for name, value in first.items():
            # Encoders and the finest decoder come back as float16, coarse decoders as int8 with a scale per column.
            exact = level == LEVELS[-1] or name.split(".")[0] in ENCODER_PARTS
            assert (value - again[name]).abs().max() <= value.abs().max() / (2000 if exact else 220) + 1e-7, name
    own, back = (
        torch.load(run / "denoisers" / "last.ckpt", weights_only=True)["state_dict"]
        for run in (trained / "run", tmp_path / "recovered")
    )
    for name in [name for name in own if name.startswith("hierarchy.")]:
        # an int8 number is off by half a step of the largest weight's 64
        assert (own[name] - back[name]).abs().max() <= own[name].abs().max() / 120, name


ONE_OF_A_KIND = ("GraphEncoder", "ContextGraph", "AgdDenoiserGraph", "CoarseDecoderGraph")


def test_a_run_recovered_from_a_bundle_gives_the_same_bundle(
    bundle: Path, encoders: Path, traces: Traces, tmp_path: Path
) -> None:
    recover(bundle, "tiny", encoders, tmp_path / "run")
    # The exporter itself must give the same bytes twice; and with the other base of guidance and the other spacing of
    # steps, so that the whole pipeline is held against torch for both.
    pending = traces.anew(*ONE_OF_A_KIND)
    export_bundle(
        tmp_path / "run", ASSETS, replace(CARD, guidance_base="empty", spacing="trailing"), tmp_path / "again", "fp32"
    )
    assert pending == set()
    first, again = (json.loads((folder / "manifest.json").read_bytes()) for folder in (bundle, tmp_path / "again"))
    assert [made["schedule"]["spacing"] for made in (first, again)] == ["leading", "trailing"]
    # Encoders are kept in float16, so the one of the recovered run is rounded.
    encoders_of = [made["files"].pop("encoder.onnx")["bytes"] for made in (first, again)]
    assert encoders_of[0] == encoders_of[1] and first["files"] == again["files"]


def test_a_bundle_takes_the_words_and_the_sampling_of_another_card(trained: Path, bundle: Path, tmp_path: Path) -> None:
    folder = shutil.copytree(bundle, tmp_path / "bundle")
    before = MotionPipeline.load(folder, threads=1).generate("a person walks", seconds=2, seed=1).joints
    steps = {"motion": 3, "action": 3, "specific": 2}
    card = replace(CARD, version="2", scope={"actions": "none"}, steps=steps, spacing="trailing")
    parity = apply_card(folder, trained / "run", card)
    made, was = (json.loads((at / "manifest.json").read_bytes()) for at in (folder, bundle))
    assert (made["version"], made["scope"], made["defaults"]["steps"]) == ("2", {"actions": "none"}, steps)
    assert made["schedule"] == {**was["schedule"], "spacing": "trailing"} and made["files"] == was["files"]
    assert parity["pipeline_mm"] <= 1.0 and made["parity"] == {**was["parity"], **parity}
    pipe = MotionPipeline.load(folder, threads=1)
    after = pipe.generate("a person walks", seconds=2, seed=1).joints
    assert np.abs(after - before).max() > 1e-3
    sealed = (folder / "manifest.json").read_bytes()
    with pytest.raises(BundleError, match="steps"):
        apply_card(folder, trained / "run", replace(card, steps={**steps, "motion": 0}))
    assert (folder / "manifest.json").read_bytes() == sealed


def test_of_a_bundle_without_coarse_decoders_the_data_tell_how_latents_were_standardised(
    trained: Path,
) -> None:
    weights = torch.load(trained / "run" / "denoisers" / "last.ckpt", weights_only=True)["state_dict"]
    measured = coarse_statistics(trained / "run", trained / "data", None, read_preset("tiny"))
    assert set(measured) == {f"{level}_{name}" for level in LEVELS[:-1] for name in ("centre", "scale")}
    for name, value in measured.items():
        np.testing.assert_allclose(value, weights[name], atol=1e-5)


def test_a_bundle_of_another_preset_is_not_recovered(bundle: Path, encoders: Path, tmp_path: Path) -> None:
    with pytest.raises(InvalidInputError, match="is not what this preset"):
        recover(bundle, "edge", encoders, tmp_path / "wrong")
    with pytest.raises(InvalidInputError, match="are not of one model"):
        recover(bundle, "edge", WEIGHTS, tmp_path / "wrong")


def test_an_encoder_is_not_completed_by_a_bundle_that_lacks_its_decoder(
    trained: Path, bundle: Path, encoders: Path, tmp_path: Path
) -> None:
    known = read_bundle(bundle)
    manifest, gone = known.manifest, "decoder_motion.onnx"
    without = {gone, *(name for name in manifest.files if name.endswith("_vjp.onnx"))}  # which take its weights
    files = {name: entry for name, entry in manifest.files.items() if name not in without}
    operators = {name: names for name, names in manifest.operators.items() if name not in without}
    bare = replace(known, manifest=replace(manifest, files=files, operators=operators))
    decoder = contracts(manifest.levels, manifest.text.width, 137)["decoder_motion"]
    with pytest.raises(InvalidInputError, match=r"no decoder_motion\.onnx"):
        recover_autoencoder(bare, "motion", encoders / "vae_motion.ckpt", decoder)
    # A whole autoencoder needs none.
    whole = trained / "run" / "vae_motion" / "last.ckpt"
    state = recover_autoencoder(bare, "motion", whole, decoder)
    assert state["state_dict"].keys() == torch.load(whole, weights_only=True)["state_dict"].keys()
    torch.save({**state, "state_dict": {"mean": state["state_dict"]["mean"]}}, tmp_path / "no_encoder.ckpt")
    with pytest.raises(InvalidInputError, match="lacks encoder"):
        recover_autoencoder(bare, "motion", tmp_path / "no_encoder.ckpt", decoder)


def test_other_folders_are_not_overwritten_and_no_run_is_even_read(tmp_path: Path) -> None:
    mine = tmp_path / "mine"
    mine.mkdir()
    (mine / "thesis.txt").write_text("four years")
    with pytest.raises(kinegraph.KinegraphError, match="not a bundle"):
        export_bundle(tmp_path / "no run", ASSETS, CARD, mine)
    assert (mine / "thesis.txt").read_text() == "four years"


def test_a_missing_stage_is_named(tmp_path: Path) -> None:
    with pytest.raises((InvalidInputError, BundleError), match="train that stage first"):
        export_bundle(tmp_path, ASSETS, CARD, tmp_path / "bundle")
