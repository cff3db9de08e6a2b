"""The vocabulary of a bundle: built from training captions, added to a bundle, and found by the runtime."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("torch")
pytest.importorskip("spacy")

from kinegraph.bundle.reader import MANIFEST, read_bundle
from kinegraph.bundle.vocabulary import FILE, read_vocabulary, sentences_to_embed
from kinegraph.errors import InvalidInputError, OutputError
from kinegraph.text.vocabulary import find_unknown
from kinegraph_export import bundle_changes
from kinegraph_export.vocabulary import (
    add_to_bundle,
    build_vocabulary,
    drop_rare,
    main,
    sentence_embedding,
    training_captions,
)
from kinegraph_training.data.caption_cache import CaptionEncoder
from kinegraph_training.data.clips import MotionClip
from kinegraph_training.data.shown_captions import (
    ShownCaptions,
    read_data_captions,
    read_shown_captions,
    write_shown_captions,
)
from kinegraph_training.synthetic.caption_grammar import PHRASES
from support.motions import walk
from support.toy import with_parser
from support.toy_run import ASSETS

CLIPS = [
    *[(f"walk_{n}", "walk", "proud", ["a person walks proudly.", "someone walks ahead."], "train") for n in range(3)],
    *[(f"crawl_{n}", "crawl", "plain", [f"a man crawls along for {n + 2} meters"], "train") for n in range(3)],
    *[(f"left_{n}", "raise-up-left-hand", "plain", ["a person raises the left hand"], "train") for n in range(3)],
    ("kick_0", "kick", "plain", ["a person kicks"], "train"),
    ("swim_0", "swim", "plain", ["a person swims"], "val"),
]


def write_folder(folder: Path, *, labels: bool = True) -> Path:
    """Write index and captions of a data folder; no motion is needed."""
    folder.mkdir()
    captions = [{"id": name, "captions": texts} for name, _, _, texts, _ in CLIPS]
    index = [
        {"id": name, "split": split, **({"content": action, "style_canon": style} if labels else {})}
        for name, action, style, _, split in CLIPS
    ]
    for name, rows in (("captions", captions), ("index", index)):
        (folder / f"{name}.jsonl").write_text("".join(json.dumps(row) + "\n" for row in rows), encoding="utf-8")
    return folder


class Told:
    """The text encoder of a folder of assets, as the search for unknown words asks it."""

    def __init__(self, encoder: CaptionEncoder) -> None:
        import numpy as np

        self.is_word = encoder.tokenizer.is_word
        self.embed = lambda sentences: np.stack([sentence_embedding(encoder, sentence) for sentence in sentences])


@pytest.fixture(scope="module")
def encoder() -> CaptionEncoder:
    return CaptionEncoder(ASSETS)


def test_training_clips_count_with_their_mirror_images(tmp_path: Path) -> None:
    shown = read_data_captions(write_folder(tmp_path / "data"))
    assert len(shown) == 20 and sum(clip.recorded for clip in shown) == 10
    assert ShownCaptions(("a person raises the right hand",), ("raise-up-right-hand",), "plain", False) in shown
    with pytest.raises(InvalidInputError, match=r"captions\.jsonl is missing"):
        read_data_captions(tmp_path)


def test_rare_actions_do_not_count_as_shown(tmp_path: Path) -> None:
    kept = drop_rare(read_data_captions(write_folder(tmp_path / "data")))
    labels = {label for clip in kept for label in clip.actions}
    assert labels == {"walk", "crawl", "raise-up-left-hand"}  # the mirrored hand was never recorded
    captions = training_captions(kept)
    assert "a person is walking forward" in captions and "a person walks proudly" in captions
    assert not any("kicks" in text or "swims" in text for text in captions)
    raises, walks = PHRASES["raise-up-left-hand"], PHRASES["walk"]
    assert any(
        any(words in text for words in (*raises.finite, *raises.participle))
        and any(words in text for words in (*walks.finite, *walks.participle))
        for text in captions
    )  # a composition


def test_what_was_shown_is_known_and_the_rest_is_told(tmp_path: Path, encoder: CaptionEncoder) -> None:
    data = build_vocabulary(read_data_captions(write_folder(tmp_path / "data")), encoder)
    known = read_vocabulary(data, 384)
    actions = {phrase.name: phrase for phrase in known.facts.phrases if phrase.kind == "action"}
    assert {name: phrase.clips for name, phrase in actions.items()} == {"walk": 3, "crawl": 3, "raise-up-left-hand": 3}
    assert actions["crawl"].example.startswith("a person crawls along for")
    assert [phrase.name for phrase in known.facts.phrases if phrase.kind == "style"] == ["proud"]
    assert "kicks" in known.facts.others and "crawls on all fours" in known.facts.others
    assert len(known.embeddings) == len(sentences_to_embed(known.facts))

    def told(text: str) -> list[str]:
        return [span.text for span in find_unknown(encoder.parser.parse(text), known, Told(encoder))]

    assert told("a woman is crawling along and raises the left arm, then walks two steps") == []
    assert told("a person walks and kicks") == ["kicks"]
    assert told("she walks on the ceiling") == ["on the ceiling"]


def test_clips_without_labels_are_grouped_by_their_verb(tmp_path: Path, encoder: CaptionEncoder) -> None:
    known = read_vocabulary(
        build_vocabulary(read_data_captions(write_folder(tmp_path / "d", labels=False)), encoder), 384
    )
    examples = {phrase.example: phrase.clips for phrase in known.facts.phrases}
    assert examples["a person raises the left hand"] == 3 and examples["a person walks ahead"] == 3


def test_too_few_clips_are_refused(encoder: CaptionEncoder) -> None:
    few = [ShownCaptions(("a person walks",), ("walk",), "", True)] * 2
    with pytest.raises(InvalidInputError, match="3 recorded clips"):
        build_vocabulary(few, encoder)


def test_the_command_adds_it_to_a_bundle_and_seals_the_manifest(tmp_path: Path) -> None:
    bundle = with_parser(tmp_path / "bundle")
    before = {path.name: path.read_bytes() for path in bundle.iterdir()}
    assert read_bundle(bundle).vocabulary is None
    for _ in range(2):  # again replaces it by the same bytes
        main(["--data", str(write_folder(tmp_path / "data") if not (tmp_path / "data").exists() else tmp_path / "data"),
              "--bundle", str(bundle)])  # fmt: skip
        found = read_bundle(bundle)
        assert found.vocabulary is not None and found.vocabulary.facts.phrases[0].clips == 3
    after = {path.name: path.read_bytes() for path in bundle.iterdir()}
    assert {name for name in after if after[name] != before.get(name)} == {FILE, "manifest.json"}


def test_a_bundle_stays_what_it_was_if_its_manifest_cannot_be_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    bundle = with_parser(tmp_path / "bundle")
    before = {path.name: path.read_bytes() for path in bundle.iterdir()}
    write = bundle_changes.write_atomically

    def full(path: Path, data: bytes) -> None:
        if path.name == MANIFEST and data != before[MANIFEST]:
            raise OutputError(f"{path}: the disk is full")
        write(path, data)

    monkeypatch.setattr(bundle_changes, "write_atomically", full)
    with pytest.raises(OutputError, match="the disk is full"):
        add_to_bundle(bundle, b"words")
    assert {path.name: path.read_bytes() for path in bundle.iterdir()} == before


def test_the_command_adds_how_often_actions_are_recognised(tmp_path: Path) -> None:
    bundle, report = with_parser(tmp_path / "bundle"), tmp_path / "recognition.json"
    main(["--data", str(write_folder(tmp_path / "data")), "--bundle", str(bundle)])
    plain = read_bundle(bundle)
    name = f"{plain.manifest.name} {plain.manifest.version}"
    rows = {
        "walk": {"caption": 0.667, "captured_caption": 1.0, "generated": 0.0, "captured": 0.9},
        "crawl": {"caption": 0.1, "captured_caption": 0.4, "generated": 1.0, "captured": 1.0},
    }
    report.write_text(json.dumps({"bundles": {name: {"actions": rows}}}))
    main(["--recognition", str(report), "--bundle", str(bundle)])
    found = read_bundle(bundle).vocabulary
    assert found is not None and plain.vocabulary is not None
    assert {phrase.name: phrase.recognised for phrase in found.facts.phrases if phrase.recognised} == {"walk": 0.67}
    assert found.facts.words == plain.vocabulary.facts.words
    np.testing.assert_allclose(found.embeddings, plain.vocabulary.embeddings, atol=1e-3)
    report.write_text(json.dumps({"bundles": {"other 1": {}}}))
    with pytest.raises(InvalidInputError, match=f"other 1, not {name}"):
        main(["--recognition", str(report), "--bundle", str(bundle)])
    with pytest.raises(SystemExit):
        main(["--bundle", str(bundle)])


def test_a_run_remembers_the_captions_it_was_shown(tmp_path: Path) -> None:
    clips = [
        MotionClip("a", walk(3), ("a person walks", "jemand geht"), ("walk",), "proud"),
        MotionClip("a~mirror", walk(3), ("a person walks",), (), ""),
    ]
    assert read_shown_captions(tmp_path / "run") == []
    write_shown_captions(tmp_path / "run", clips, recorded=["a", "b"])
    assert read_shown_captions(tmp_path / "run") == [
        ShownCaptions(("a person walks", "jemand geht"), ("walk",), "proud", True),
        ShownCaptions(("a person walks",), (), "", False),
    ]
    (tmp_path / "run" / "captions.jsonl").write_text('{"captions": 5}\n')
    with pytest.raises(InvalidInputError, match="no captions of a training run"):
        read_shown_captions(tmp_path / "run")
