"""Build `vocabulary.npz`, what a bundle was shown in training, and add it to an existing bundle.

    python -m kinegraph_export.vocabulary --data DATA/bandai --bundle BUNDLE
    python -m kinegraph_export.vocabulary --recognition recognition.json --bundle BUNDLE

It holds the words of the training captions, verbs with what follows them, and the actions and styles with sentence
embeddings by the bundle's own text encoder. Wordings of made compositions count where the labels are those of
`kinegraph_training.synthetic.caption_grammar`. A report of `kinegraph_benchmarks.quality.recognition` adds how often
each action is recognised in what the bundle makes. Only the new file and the manifest of the bundle change.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
from collections import Counter, defaultdict
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Final

import numpy as np

from kinegraph.arrays import FloatArray
from kinegraph.bundle.manifest import decode_manifest
from kinegraph.bundle.reader import MANIFEST, read_bundle, text_files_folder
from kinegraph.bundle.vocabulary import (
    ACTION_SENTENCE,
    FILE,
    STYLE_SENTENCE,
    Facts,
    Phrase,
    pack_vocabulary,
    read_vocabulary,
    sentences_to_embed,
)
from kinegraph.errors import InvalidInputError
from kinegraph.graph import SemanticGraph
from kinegraph.text.words import FUNCTION, LIGHT_VERBS, PERSONS, combinations, split_clauses, split_words, stem
from kinegraph_export.bundle_changes import listed_files, unchanged_if_it_fails, write_files
from kinegraph_training.data.caption_cache import CaptionEncoder
from kinegraph_training.data.shown_captions import ShownCaptions, read_data_captions
from kinegraph_training.synthetic.caption_grammar import (
    COUNTED_STEPS,
    NUMBERS,
    PHRASES,
    STYLE_PHRASES,
    sequence_caption,
    splice_caption,
)

MIN_CLIPS: Final = 3
"""Recorded clips that an action or a style needs to count as known; fewer cannot teach it."""
MAX_WORDINGS: Final = 5
"""Wordings of an action that the grammar does not name, taken from its captions."""
TRUSTED: Final = 0.5
"""Share of the captured clips of an action from which the evaluator's opinion of generated ones counts."""
PARAPHRASE: Final = 0.66
NEAR: Final = 0.3
"""Cosines of `bundle.vocabulary.Facts`; measured by `kinegraph_benchmarks.quality.unknown_words`."""

OTHER_ACTIONS: Final = (
    "jumps", "jumps up", "hops on one leg", "skips", "leaps forward", "limps", "crawls on all fours", "climbs a ladder",
    "climbs the stairs", "sits down", "sits on a chair", "stands up", "stands still", "gets up from the floor",
    "kneels down", "crouches", "squats", "lies down", "falls down", "stumbles", "staggers", "tiptoes", "sneaks",
    "rolls on the floor", "does a somersault", "does a cartwheel", "does a handstand", "spins around", "twirls",
    "dances", "kicks", "kicks a ball", "punches", "fights", "boxes", "claps", "nods", "shakes the head", "shrugs",
    "salutes", "stretches", "stretches the legs", "throws a ball", "catches a ball", "pushes something", "pulls a rope",
    "lifts a box", "carries a box", "picks something up", "puts something down", "swims", "dives", "rides a bicycle",
    "drives a car", "skates", "skis", "slides", "gallops", "rows a boat", "points at something", "stamps the foot",
    "raises a leg", "lifts the knee", "turns the head", "tilts the head", "looks around", "leans back",
    "bends the knees", "shakes hands", "hugs somebody", "prays", "eats", "drinks from a cup", "sleeps", "writes",
    "types on a keyboard", "plays the guitar", "plays the piano", "plays tennis", "swings a bat", "swings a golf club",
    "shoots an arrow", "aims a gun", "dodges", "ducks", "does push-ups", "does lunges", "juggles", "knocks on a door",
    "opens a door", "scratches the head", "rubs the hands", "wipes a table", "sweeps the floor", "digs a hole",
    "chops wood", "yawns", "sneezes", "coughs", "laughs", "cries", "talks", "sings", "whistles", "listens", "stops",
    "waits", "waddles", "curtsies", "trips over something", "steps over something", "hangs from a bar",
    "balances on one leg", "marches",
)  # fmt: skip
"""Everyday actions. Those that training did not show are embedded too: what is nearer to one of them is not known."""


OTHERS_JOINED = 20
"""Actions that each action is worded together with; captions of the run's own compositions come on top."""


def build_vocabulary(shown: Sequence[ShownCaptions], encoder: CaptionEncoder) -> bytes:
    """Build the content of `vocabulary.npz`.

    Args:
        shown: captions of the training clips.
        encoder: parser and text encoder of the bundle.

    Raises:
        InvalidInputError: there are no captions, or no action has `MIN_CLIPS` clips.
    """
    clips = drop_rare(shown)
    graphs = {text: encoder.parser.parse(text) for text in sorted({*training_captions(clips)})}
    words = {stem(word.text) for text in graphs for word in split_words(text)}
    pairs = {found.key for graph in graphs.values() for found in combinations(split_words(graph.caption), graph)}
    phrases = [*action_phrases(clips, graphs), *style_phrases(clips)]
    if not any(phrase.kind == "action" for phrase in phrases):
        raise InvalidInputError(f"no action is shown by {MIN_CLIPS} recorded clips; a vocabulary needs one")
    others = tuple(text for text in OTHER_ACTIONS if _is_other(text, words, pairs, encoder))
    facts = Facts(tuple(sorted(words)), tuple(sorted(pairs)), tuple(phrases), others, PARAPHRASE, NEAR)
    embeddings = np.stack([sentence_embedding(encoder, sentence) for sentence in sentences_to_embed(facts)])
    return pack_vocabulary(facts, embeddings)


def drop_rare(shown: Sequence[ShownCaptions]) -> list[ShownCaptions]:
    """Leave out clips of an action or a style that fewer than `MIN_CLIPS` recorded clips show."""
    actions = Counter(label for clip in shown if clip.recorded for label in clip.actions)
    styles = Counter(clip.style for clip in shown if clip.recorded)

    def is_common(clip: ShownCaptions) -> bool:
        return all(actions[label] >= MIN_CLIPS for label in clip.actions) and styles[clip.style] >= MIN_CLIPS

    return [clip for clip in shown if is_common(clip)]


def training_captions(clips: Iterable[ShownCaptions]) -> set[str]:
    """Gather all captions of the clips, and the wording of compositions that may be made of them."""
    clips = list(clips)
    captions = {text for clip in clips for text in clip.captions}
    actions = sorted({label for clip in clips for label in clip.actions} & set(PHRASES))
    styles = sorted({clip.style for clip in clips} & set(STYLE_PHRASES))
    rng = np.random.Generator(np.random.PCG64(0))
    for action in actions:
        captions |= {ACTION_SENTENCE.format(text) for text in PHRASES[action].finite}
        captions |= {ACTION_SENTENCE.format(f"is {text}") for text in PHRASES[action].participle}
        for template in COUNTED_STEPS.get(action, ()):
            captions |= {template.format(subject="a person", n=number) for number in NUMBERS}
        for other in rng.choice(actions, min(len(actions), OTHERS_JOINED), replace=False):
            captions |= {*splice_caption((action, str(other)), "", rng), *sequence_caption(action, str(other), "", rng)}
        captions |= {
            ACTION_SENTENCE.format(f"{PHRASES[action].finite[0]} {text}".strip())
            for style in styles
            for text in STYLE_PHRASES[style]
        }
    return captions


def action_phrases(clips: Sequence[ShownCaptions], graphs: dict[str, SemanticGraph]) -> list[Phrase]:
    """List the actions, the best shown first; without labels, clips are grouped by the verb of their captions."""
    counts: Counter[str] = Counter()
    wordings: dict[str, Counter[str]] = defaultdict(Counter)
    everywhere: Counter[str] = Counter()
    for clip in clips:
        labels = clip.actions or tuple({_main_verb(graphs[text]) for text in clip.captions})
        counts.update(labels if clip.recorded else ())
        for label in labels:
            texts = [_first_clause(graphs[text]) for text in clip.captions]
            wordings[label].update(texts)
            everywhere.update(texts)
    labelled = {label for clip in clips for label in clip.actions}
    phrases = []
    for label, count in sorted(counts.items(), key=lambda item: (-item[1], item[0])):
        has_grammar = label in labelled and label in PHRASES
        texts = PHRASES[label].finite if has_grammar else _typical(wordings[label], everywhere)
        if label and count >= MIN_CLIPS and texts:
            name = label if label in labelled else texts[0].split()[0]
            phrases.append(Phrase(name, "action", count, ACTION_SENTENCE.format(texts[0]), texts))
    return phrases


def style_phrases(clips: Sequence[ShownCaptions]) -> list[Phrase]:
    """List the styles that the grammar has words for, the best shown first."""
    counts = Counter(clip.style for clip in clips if clip.recorded)
    phrases = []
    for style, count in sorted(counts.items(), key=lambda item: (-item[1], item[0])):
        texts = tuple(text for text in STYLE_PHRASES.get(style, ()) if text)
        if texts:
            phrases.append(Phrase(style, "style", count, STYLE_SENTENCE.format(texts[0]), texts))
    return phrases


def _typical(wordings: Counter[str], everywhere: Counter[str]) -> tuple[str, ...]:
    """Choose wordings that mean one action: finite before participle, the shortest first.

    Args:
        wordings: of the action, with the number of captions that have them.
        everywhere: of all actions; a wording that is mostly of others ("stands") names none.
    """
    named = [text for text in wordings if text]
    own = [text for text in named if 2 * wordings[text] > everywhere[text]] or named
    ranked = sorted(own, key=lambda text: (not text.split()[0].endswith("s"), len(text), text))
    return tuple(ranked[:MAX_WORDINGS])


def _main_verb(graph: SemanticGraph) -> str:
    """Return the stem of the first verb that names a motion, or "" if there is none ("takes a break")."""
    verbs = (stem(action.text.lower()) for action in graph.actions)
    return next((verb for verb in verbs if verb not in LIGHT_VERBS), "")


def _first_clause(graph: SemanticGraph) -> str:
    """Return the first action of a caption with what follows it in its clause: "walks to the left"."""
    words = split_words(graph.caption)
    start = graph.actions[0].start
    clause = next((part for part in split_clauses(words, graph) if any(words[i].start == start for i in part)), None)
    return "" if clause is None else graph.caption[start : words[clause[-1]].end]


def _is_other(text: str, words: set[str], pairs: set[str], encoder: CaptionEncoder) -> bool:
    """Tell whether training did not show an action: a word or a combination of it is new."""
    graph = encoder.parser.parse(ACTION_SENTENCE.format(text))
    parts = split_words(graph.caption)
    unseen = any(stem(word.text) not in words for word in parts if word.text not in FUNCTION | PERSONS)
    return unseen or any(found.key not in pairs for found in combinations(parts, graph))


def sentence_embedding(encoder: CaptionEncoder, sentence: str) -> FloatArray:
    """Encode a sentence to the mean (D,) of its hidden states, of length 1."""
    states = encoder.hidden_states(sentence)
    mean: FloatArray = states.mean(axis=0)
    return mean / np.linalg.norm(mean)


def add_to_bundle(folder: Path, data: bytes) -> None:
    """Write `vocabulary.npz` into a bundle, or replace it, and seal the manifest anew.

    Raises:
        BundleFormatError, BundleIntegrityError: the manifest is broken.
        OutputError: the folder cannot be written; the bundle stays as it was.
    """
    manifest = decode_manifest((folder / MANIFEST).read_bytes())
    sealed = dataclasses.replace(manifest, files=listed_files(manifest, {FILE: data}))
    with unchanged_if_it_fails(folder, [FILE]):
        write_files(folder, sealed, {FILE: data})


def with_recognition(data: bytes, report: Path, bundle: Path) -> bytes:
    """Add to each action how often it is recognised; returns the content of `vocabulary.npz`.

    Actions that the evaluator does not know in captured clips either (`TRUSTED`) get no share.

    Args:
        data: content of `vocabulary.npz` of the bundle.
        report: JSON that `kinegraph_benchmarks.quality.recognition` wrote.
        bundle: folder of the bundle, which the report must have measured.

    Raises:
        InvalidInputError: the report is of other bundles.
    """
    manifest = decode_manifest((bundle / MANIFEST).read_bytes())
    name = f"{manifest.name} {manifest.version}"
    measured = json.loads(report.read_text(encoding="utf-8"))["bundles"]
    if name not in measured:
        raise InvalidInputError(f"{report} has measured {', '.join(measured) or 'nothing'}, not {name}")
    vocabulary = read_vocabulary(data, manifest.text.width)
    shares = {
        action: round(float(row["caption"]), 2)
        for action, row in measured[name]["actions"].items()
        if row["captured_caption"] >= TRUSTED
    }
    phrases = tuple(
        dataclasses.replace(phrase, recognised=shares.get(phrase.name) if phrase.kind == "action" else None)
        for phrase in vocabulary.facts.phrases
    )
    return pack_vocabulary(dataclasses.replace(vocabulary.facts, phrases=phrases), vocabulary.embeddings)


def text_files_of(bundle: Path) -> Path:
    """Return the folder of the files that read text for a bundle: its own, or that of installed bundles."""
    return bundle if (bundle / "text_encoder.onnx").is_file() else text_files_folder()


def main(argv: list[str] | None = None) -> None:
    """Run the command line."""
    parser = argparse.ArgumentParser(prog="kinegraph_export.vocabulary", description=__doc__.split("\n")[0])
    parser.add_argument("--data", type=Path, nargs="+", help="folders with the training clips")
    parser.add_argument("--recognition", type=Path, help="report of how often each action is recognised (JSON)")
    parser.add_argument("--bundle", type=Path, required=True, help="folder of the bundle, which is changed")
    options = parser.parse_args(argv)
    if not options.data and not options.recognition:
        parser.error("--data, --recognition or both are needed")
    read_bundle(options.bundle)
    if options.data:
        shown = [clip for folder in options.data for clip in read_data_captions(folder)]
        data = build_vocabulary(shown, CaptionEncoder(text_files_of(options.bundle)))
    else:
        data = (options.bundle / FILE).read_bytes()
    if options.recognition:
        data = with_recognition(data, options.recognition, options.bundle)
    add_to_bundle(options.bundle, data)
    print(f"{FILE}: {len(data) / 1e3:.0f} kB in {options.bundle}")


if __name__ == "__main__":
    main()
