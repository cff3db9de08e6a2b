"""The manifest: a round trip keeps it, and every invalid value is an error that names its key."""

from __future__ import annotations

import copy
import dataclasses
import json
from dataclasses import replace
from typing import Any

import pytest

from kinegraph.bundle.contract import FRAME_FILES
from kinegraph.bundle.manifest import Manifest, decode_manifest, encode_manifest
from kinegraph.errors import BundleFormatError
from support.manifests import ALL_PATHS, GOOD, changed, dotted, value_at
from support.synthetic_bundle import LEVEL_SPECS, bundle_files, manifest_for, sealed

FREE_MAPS = {("provenance",), ("scope",), ("parity",), ("training",), ("quality",)}
OPTIONAL = [("files", name) for name in ("parser.bin", "encoder.onnx")]
WITH_DEFAULT = [("family",), ("text", "max_pieces"), ("frames_part", "beta_end")]
"""Keys that older bundles do not have."""
REQUIRED = [
    path
    for path in ALL_PATHS
    if path[:-1] not in FREE_MAPS and isinstance(path[-1], str) and path[:2] not in (*OPTIONAL, *WITH_DEFAULT)
]


def test_round_trip() -> None:
    manifest = manifest_for(bundle_files())
    assert decode_manifest(encode_manifest(manifest)) == manifest
    assert encode_manifest(decode_manifest(encode_manifest(manifest))) == encode_manifest(manifest)


def test_the_text_is_plain_json_with_its_sha256() -> None:
    value = json.loads(encode_manifest(manifest_for(bundle_files())))
    assert value.pop("sha256")
    assert list(value) == [field.name for field in dataclasses.fields(Manifest)]
    assert value["features"]["mean"][:3] == [0.0, 1.0, 2.0]
    assert value["levels"]["action"]["nodes"] == ["motion", "action"]


def test_nothing_in_a_manifest_can_be_changed() -> None:
    manifest = decode_manifest(encode_manifest(manifest_for(bundle_files())))
    with pytest.raises(dataclasses.FrozenInstanceError):
        manifest.name = "other"  # type: ignore[misc]
    with pytest.raises(TypeError):
        manifest.files["decoder.onnx"] = None  # type: ignore[index]


def test_keys_of_older_bundles_have_their_defaults() -> None:
    value = copy.deepcopy(GOOD)
    del value["family"], value["text"]["max_pieces"], value["frames_part"]["beta_end"]
    assert decode_manifest(sealed(value)) == manifest_for(bundle_files())


@pytest.mark.parametrize("family", ["graphmotion", "mld"])
def test_a_family_has_its_own_graphs_levels_and_guidance(family: str) -> None:
    value = copy.deepcopy(GOOD)
    value["family"] = family
    with pytest.raises(BundleFormatError, match=r"manifest\.json: (levels|defaults)"):
        decode_manifest(sealed(value))


@pytest.mark.parametrize("path", REQUIRED, ids=dotted)
def test_a_missing_key_is_named(path: tuple[Any, ...]) -> None:
    value = copy.deepcopy(GOOD)
    parent: Any = value
    for key in path[:-1]:
        parent = parent[key]
    del parent[path[-1]]
    with pytest.raises(BundleFormatError) as caught:
        decode_manifest(sealed(value))
    message = str(caught.value)
    assert path[-1] in message
    assert all(str(key) in message for key in path[:-1])


def test_the_coarse_decoders_are_optional_each_with_its_operators() -> None:
    value = copy.deepcopy(GOOD)
    for part in ("files", "operators"):  # gradients need their decoders
        value[part] = {key: entry for key, entry in value[part].items() if not key.endswith("_vjp.onnx")}
    del value["files"]["decoder_motion.onnx"]
    with pytest.raises(BundleFormatError, match="operators must have exactly the keys"):
        decode_manifest(sealed(value))
    del value["operators"]["decoder_motion.onnx"]
    manifest = decode_manifest(sealed(value))
    assert "decoder_motion" not in manifest.contracts and "decoder_action" in manifest.contracts


def test_the_graphs_of_adaptive_gradient_descent_are_optional_all_together() -> None:
    value = copy.deepcopy(GOOD)
    names = [name for name in value["files"] if name.endswith("_agd.onnx") and not name.startswith("frames_")]
    assert len(names) == 6
    for name in names:
        with pytest.raises(BundleFormatError, match="all or none"):
            decode_manifest(sealed({**value, "files": {k: v for k, v in value["files"].items() if k != name}}))
    for part in ("files", "operators"):
        value[part] = {key: entry for key, entry in value[part].items() if key not in names}
    contracts = decode_manifest(sealed(value)).contracts
    assert not any(name.endswith("_agd") for name in contracts if not name.startswith("frames_"))


def test_skeleton_space_is_optional_all_together() -> None:
    value = copy.deepcopy(GOOD)
    names = [name for name in value["files"] if name.startswith("frames_")]
    assert len(names) == 5 and set(names) == FRAME_FILES
    for name in names:
        with pytest.raises(BundleFormatError, match=f"lacks .*{name}"):
            decode_manifest(sealed({**value, "files": {k: v for k, v in value["files"].items() if k != name}}))
    part = value.pop("frames_part")
    with pytest.raises(BundleFormatError, match="frames_part would describe"):
        decode_manifest(sealed(value))
    for key in ("files", "operators"):
        value[key] = {name: entry for name, entry in value[key].items() if name not in names}
    without = decode_manifest(sealed(value))
    assert without.frames_part is None and not any(name.startswith("frames_") for name in without.contracts)
    assert b"frames_part" not in encode_manifest(without)
    with pytest.raises(BundleFormatError, match="lacks"):
        decode_manifest(sealed({**value, "frames_part": part}))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"per_token": 0}, "per_token must be 1"),
        ({"per_token": 3}, "latent_width must be 3 x 137"),
        ({"scale": 0.0}, "scale must be above 0"),
        ({"steps": 21}, "steps"),
        ({"guidance": 21.0}, "guidance must be 0 to 20"),
        ({"prediction": "noise"}, "prediction must be one of"),
        ({"beta_end": 1.0}, "beta_end must be above 0 and below 1, found 1.0"),
        ({"beta_end": 1e-4}, "a schedule needs"),
        ({"level": {**GOOD["frames_part"]["level"], "tokens": 5}}, "tokens must be enough for 24 frames"),
        ({"level": {**GOOD["frames_part"]["level"], "heads": 3}}, "heads must divide 8"),
        ({"level": {**GOOD["frames_part"]["level"], "layers": 10**9}}, "layers must be 1 to"),
        ({"level": {**GOOD["frames_part"]["level"], "nodes": []}}, "nodes must not be empty"),
        ({"level": None}, "level"),
    ],
)
def test_what_skeleton_space_cannot_be(change: dict[str, object], message: str) -> None:
    value = copy.deepcopy(GOOD)
    value["frames_part"] |= change
    with pytest.raises(BundleFormatError, match=message):
        decode_manifest(sealed(value))


def test_the_gradients_of_decoders_are_optional_all_together_and_need_their_decoders() -> None:
    value = copy.deepcopy(GOOD)
    names = [name for name in value["files"] if name.endswith("_vjp.onnx")]
    assert len(names) == 3
    for name in names:
        with pytest.raises(BundleFormatError, match="all or none"):
            decode_manifest(sealed({**value, "files": {k: v for k, v in value["files"].items() if k != name}}))
    for name in ("decoder_motion.onnx", "decoder_action.onnx"):
        with pytest.raises(BundleFormatError, match=f"lacks .*{name}"):
            decode_manifest(sealed({**value, "files": {k: v for k, v in value["files"].items() if k != name}}))
    for part in ("files", "operators"):
        value[part] = {key: entry for key, entry in value[part].items() if key not in names}
    assert not any(name.endswith("_vjp") for name in decode_manifest(sealed(value)).contracts)


@pytest.mark.parametrize("version", [2, 3, 4])
def test_a_bundle_of_a_format_before_is_read(version: int) -> None:
    manifest = manifest_for(bundle_files(version), version)
    assert decode_manifest(encode_manifest(manifest)) == manifest
    assert not manifest.attends_to_words and manifest.knows_partial_captions == (version == 4)


def test_file_names_and_words_belong_to_a_format() -> None:
    with pytest.raises(BundleFormatError, match=r"no file of a bundle of format 3"):
        decode_manifest(sealed({**GOOD, "format_version": 3}))
    words = {name: replace(level, nodes=(*level.nodes, "word")) for name, level in LEVEL_SPECS.items()}
    manifest = replace(manifest_for(bundle_files()), levels=words)
    assert manifest.attends_to_words and manifest.knows_partial_captions
    with pytest.raises(BundleFormatError, match=r"levels\.motion\.nodes must be some of"):
        replace(manifest_for(bundle_files(3), 3), levels=words)


def test_the_parser_is_optional() -> None:
    value = copy.deepcopy(GOOD)
    del value["files"]["parser.bin"]
    assert "parser.bin" not in decode_manifest(sealed(value)).files


@pytest.mark.parametrize(
    "path", [p for p in ALL_PATHS if isinstance(value_at(p), dict) and p not in FREE_MAPS], ids=dotted
)
def test_an_unknown_key_is_named(path: tuple[Any, ...]) -> None:
    with pytest.raises(BundleFormatError, match="surprise") as caught:
        decode_manifest(sealed(changed((*path, "surprise"), value_at(path).get("motion", 1))))
    assert str(path[0]) in str(caught.value)


def test_an_unknown_key_at_the_top_is_named() -> None:
    with pytest.raises(BundleFormatError, match="unknown key 'surprise'"):
        decode_manifest(sealed({**GOOD, "surprise": 1}))


def wrong_values(path: tuple[Any, ...]) -> list[object]:
    """List JSON values of every type that is wrong at a path."""
    if path[0] == "training" and len(path) == 2:
        return [None, True, [], {}]
    by_type: dict[type, list[object]] = {
        str: [None, True, 1, 1.5, [], {}, "a tab\t", "half a pair \ud800"],
        int: [None, True, "1", 1.5, [], {}],
        float: [None, False, "1.5", [], {}],
        list: [None, 1, "text", {}],
        dict: [None, 1, "text", []],
    }
    return by_type[type(value_at(path))]


@pytest.mark.parametrize("path", ALL_PATHS, ids=dotted)
def test_a_wrong_type_is_named(path: tuple[Any, ...]) -> None:
    for wrong in wrong_values(path):
        with pytest.raises(BundleFormatError) as caught:
            decode_manifest(sealed(changed(path, wrong)))
        assert dotted(path) in str(caught.value), wrong


BREAKS: list[tuple[tuple[Any, ...], object]] = [
    (("format_version",), 1),
    (("format_version",), 6),
    (("format_version",), 0),
    (("skeleton", "joint_names"), GOOD["skeleton"]["joint_names"][:-1]),
    (("skeleton", "parents", 3), 1),
    (("fps",), 0),
    (("fps",), -20.0),
    (("frames", "min"), 1),
    (("frames", "min"), 25),
    (("frames", "max"), 197),
    (("frames", "per_token"), 0),
    (("features", "layout"), "joints-138"),
    (("features", "layout"), "humanml3d-263"),
    (("features", "heading"), "sideways"),
    (("features", "mean"), [0.0] * 136),
    (("features", "std"), [1.0] * 138),
    (("features", "std", 5), 0.0),
    (("text", "width"), 0),
    (("levels", "motion", "layers"), 10**9),
    (("levels", "motion", "tokens"), 0),
    (("levels", "motion", "heads"), 3),
    (("levels", "action", "latent_width"), 4),
    (("levels", "specific", "tokens"), 1),
    (("levels", "action", "nodes"), ["action", "motion"]),
    (("levels", "action", "nodes"), []),
    (("schedule", "train_steps"), 0),
    (("schedule", "beta_end"), 1e-9),
    (("schedule", "beta_start"), 0.0),
    (("schedule", "steps_offset"), 20),
    (("schedule", "spacing"), "linspace"),
    (("schedule", "prediction"), "sample"),
    (("defaults", "steps", "action"), 21),
    (("defaults", "guidance", "action"), -0.5),
    (("defaults", "seconds"), 60.0),
    (("roles",), GOOD["roles"][::-1]),
    (("precision",), "fp16"),
    (("files", "decoder.onnx", "sha256"), "0" * 63),
    (("files", "decoder.onnx", "sha256"), "G" * 64),
    (("files", "decoder.onnx", "bytes"), -1),
    (("operators", "decoder.onnx"), ["ai.onnx::Mul", "ai.onnx::Add"]),
]


@pytest.mark.parametrize(("path", "value"), BREAKS, ids=lambda item: dotted(item) if isinstance(item, tuple) else None)
def test_fields_that_make_no_sense_are_named(path: tuple[Any, ...], value: object) -> None:
    with pytest.raises(BundleFormatError) as caught:
        decode_manifest(sealed(changed(path, value)))
    assert path[0] in str(caught.value)


@pytest.mark.parametrize(
    "name",
    [
        "../decoder.onnx",
        "/etc/passwd",
        "C:\\x",
        "C:decoder.onnx",
        "a/b",
        "a\\b",
        "Decoder.onnx",
        "decoder.onnx ",
        "",
        ".",
    ],
)
def test_only_known_file_names_may_be_listed(name: str) -> None:
    with pytest.raises(BundleFormatError, match="no file of a bundle"):
        decode_manifest(sealed(changed(("files", name), GOOD["files"]["decoder.onnx"])))


def test_a_name_with_nul_is_refused() -> None:
    with pytest.raises(BundleFormatError, match="cannot be printed"):
        decode_manifest(sealed(changed(("files", "decoder.onnx\0"), GOOD["files"]["decoder.onnx"])))


def test_a_newer_format_says_so_before_its_new_keys_do() -> None:
    with pytest.raises(BundleFormatError, match="format_version is 6"):
        decode_manifest(sealed({**GOOD, "format_version": 6, "new_key": 1}))
