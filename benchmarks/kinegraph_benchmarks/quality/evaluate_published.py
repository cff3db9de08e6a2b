"""Measure a bundle on HumanML3D or KIT-ML in the papers' protocol: their columns, by their evaluators.

    python -m kinegraph_benchmarks.quality.evaluate_published --humanml3d HumanML3D --evaluators evaluators \
        --evaluator-stats t2m/Comp_v6_KLD005/meta --glove glove --bundle graphmotion --out published.json

The protocol is that of Guo et al. (2022), as GraphMotion and MLD report it: captions and length crops are drawn anew
in each of 20 repeats; R-precision among 32 candidates, in groups of one random order; 300 pairs for Diversity; for
Multimodality 30 clips of each of 100 captions, 10 pairs each. The figures are mean and 1.96 standard errors. The
finest level alone is scored, whereas GraphMotion's released code scores a blend of its three.

A bundle of the data set's own features is scored on what its decoder returns. Another bundle is scored on the features
of its joints, retargeted to the body of HumanML3D as that data set's own code does. Sentences are not split at "then".

With `--tmr`, TMR (Petrovich et al., 2023) scores the same clips: R-precision in groups of its own order, and how near
motions are to their sentences (M2T) and to the captured clips (M2M), (1 + cos) / 2.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from kinegraph import MotionPipeline
from kinegraph.arrays import FloatArray
from kinegraph.decoding import decode_features, decode_joints
from kinegraph.errors import InvalidInputError, KinegraphError
from kinegraph.motion.humanml3d import humanml3d_from_joints, joints_from_humanml3d, rest_offsets
from kinegraph.options import resolve_options
from kinegraph_benchmarks.common.arguments import add_arguments, benchmark_parser
from kinegraph_benchmarks.common.guo_evaluators import GuoEvaluators, WordVectors
from kinegraph_benchmarks.common.published_test import Caption, PublishedClip, draw_items, read_test_clips
from kinegraph_benchmarks.common.report_io import write_report
from kinegraph_benchmarks.common.scores import average_repeats
from kinegraph_benchmarks.common.tmr_evaluator import COLUMNS as TMR_COLUMNS
from kinegraph_benchmarks.common.tmr_evaluator import TmrEvaluator
from kinegraph_benchmarks.common.tmr_evaluator import score as score_by_tmr
from kinegraph_training.data.humanml3d_reader import SETS, PublishedSet
from kinegraph_training.metrics import diversity, frechet_distance, matching_distance, multimodality, r_precision

GROUP: Final = 32
PAIRS: Final = 300
MANY_CAPTIONS, MANY_CLIPS = 100, 30
LAYOUTS: Final = {263: "humanml3d-263", 251: "kit-251"}
COLUMNS: Final = {
    "r_precision_1": "R@1", "r_precision_2": "R@2", "r_precision_3": "R@3", "fid": "FID", "mm_dist": "MM-Dist",
    "diversity": "Diversity", "multimodality": "Multimodality",
}  # fmt: skip


@dataclass(frozen=True)
class Generator:
    """A bundle that gives features of a data set for a caption and a length."""

    pipe: MotionPipeline
    data: PublishedSet
    offsets: FloatArray
    """(22, 3) metres of the data set's body; not used for a bundle of its own features."""

    def __post_init__(self) -> None:
        own = self.pipe.manifest.features.layout
        if own != LAYOUTS[self.data.features] and self.data.features != 263:
            raise InvalidInputError(
                f"the bundle's features are {own}; on {self.data.name} only a bundle of {LAYOUTS[self.data.features]} "
                "can be measured: import a checkpoint of it"
            )

    def __call__(self, caption: str, frames: int, seed: int) -> FloatArray:
        """Generate features (frames, F), not normalised."""
        pipe, manifest = self.pipe, self.pipe.manifest
        own = manifest.features.layout == LAYOUTS[self.data.features]
        graph = pipe.parse(caption)
        features = pipe.encoder.encode_text([graph], [False])
        # features of joints have a row less than there are frames
        seconds = (frames + (not own)) / self.data.fps
        shortest, longest = manifest.seconds_limits
        options = resolve_options(manifest, seconds=min(max(seconds, shortest), longest), seed=seed, foot_fix=False)
        options = pipe.encoder.with_length(options, features)
        latents = pipe.sampler.sample(pipe.encoder.attend(features), None, [options])
        decoder, count = pipe.decoder.sessions.decoder, [options.frames]
        if own:
            return decode_features(decoder, manifest, latents, count)[0]
        joints = decode_joints(decoder, manifest, pipe.decoder.bones, latents, count)[0]
        return humanml3d_from_joints(joints, target_offsets=self.offsets)


def score(
    motions: Sequence[FloatArray],
    captions: Sequence[Caption],
    reference: FloatArray,
    evaluators: GuoEvaluators,
    rng: np.random.Generator,
) -> dict[str, float]:
    """Score motions under their captions.

    Args:
        motions: features (frames, F), not normalised.
        captions: of each motion.
        reference: (clips, e) embeddings of the captured clips.
        evaluators: see `GuoEvaluators`.
        rng: draws groups and pairs.
    """
    moved, told = evaluators.embed_motions(motions), evaluators.embed_texts([caption.tokens for caption in captions])
    groups = draw_groups(len(moved), rng)
    ranks = np.mean([r_precision(told[rows], moved[rows]) for rows in groups], axis=0)
    return {
        **{f"r_precision_{rank + 1}": float(value) for rank, value in enumerate(ranks)},
        "fid": frechet_distance(moved, reference),
        "mm_dist": matching_distance(told, moved),
        "diversity": diversity(moved, rng, PAIRS),
    }


def draw_groups(count: int, rng: np.random.Generator) -> list[NDArray[np.int64]]:
    """Divide rows into groups of 32 in one random order; a partial one is left out, unless it is the only one."""
    order = rng.permutation(count)
    return [order[start : start + GROUP] for start in range(0, count - GROUP + 1, GROUP)] or [order]


def score_many(
    generate: Generator, clips: Sequence[PublishedClip], evaluators: GuoEvaluators, rng: np.random.Generator, many: int
) -> dict[str, float]:
    """Score the multimodality of `many` clips of each of up to 100 captions; nothing where that is too few."""
    if many < 2:
        return {}
    crops, captions = draw_items([clips[row] for row in rng.permutation(len(clips))[:MANY_CAPTIONS]], rng)
    takes = [
        evaluators.embed_motions([generate(caption.text, len(crop), int(rng.integers(2**31))) for _ in range(many)])
        for crop, caption in zip(crops, captions, strict=True)
    ]
    return {"multimodality": multimodality(np.stack(takes), rng)}


def score_both_by_tmr(
    tmr: TmrEvaluator,
    captions: Sequence[Caption],
    crops: Sequence[FloatArray],
    motions: Sequence[FloatArray],
    rng: np.random.Generator,
) -> tuple[dict[str, float], dict[str, float]]:
    """Score captured and generated clips of the same captions by TMR, in the same groups."""
    groups = draw_groups(len(crops), rng)
    told, shown = tmr.embed_sentences([caption.text for caption in captions]), tmr.embed_motions(crops)
    return score_by_tmr(told, shown, shown, groups), score_by_tmr(told, tmr.embed_motions(motions), shown, groups)


def evaluate(
    clips: Sequence[PublishedClip],
    generate: Generator,
    evaluators: GuoEvaluators,
    repeats: int,
    many: int,
    tmr: TmrEvaluator | None = None,
) -> dict[str, Any]:
    """Measure captured and generated clips in every repeat; returns what is written."""
    captured, generated = [], []
    for repeat in range(repeats):
        rng = np.random.Generator(np.random.PCG64(repeat))
        crops, captions = draw_items(clips, rng)
        reference = evaluators.embed_motions(crops)
        captured.append(score(crops, captions, reference, evaluators, rng))
        motions = []
        for row, (crop, caption) in enumerate(zip(crops, captions, strict=True)):
            motions.append(generate(caption.text, len(crop), 100_000 * repeat + row))
            if sys.stderr.isatty():
                print(f"\rrepeat {repeat + 1} of {repeats}: {row + 1} of {len(clips)}", end="", file=sys.stderr)
        scores = score(motions, captions, reference, evaluators, rng)
        generated.append(scores | score_many(generate, clips, evaluators, rng, many))
        if tmr is not None:
            # draws of its own, so that the papers' columns are the same with TMR and without
            own_rng = np.random.Generator(np.random.PCG64(repeat))
            for rows, more in zip(
                (captured, generated), score_both_by_tmr(tmr, captions, crops, motions, own_rng), strict=True
            ):
                rows[-1] |= more
        print(f"repeat {repeat + 1} of {repeats}: FID {generated[-1]['fid']:.3f}", file=sys.stderr)
    return {"captured": average_repeats(captured), "generated": average_repeats(generated)}


def load_tmr(folder: Path | None, data: PublishedSet) -> TmrEvaluator | None:
    """Load TMR if its folder is given.

    Raises:
        InvalidInputError: files are missing, or it does not read the features of this data set.
    """
    if folder is None:
        return None
    tmr = TmrEvaluator(folder)
    if tmr.features != data.features:
        raise InvalidInputError(
            f"TMR reads the {tmr.features} features of HumanML3D, {data.name} has {data.features}: leave out --tmr"
        )
    return tmr


def markdown_table(result: dict[str, Any]) -> str:
    """Format a result as the papers do, captured clips first."""
    columns = COLUMNS | (TMR_COLUMNS if "tmr" in result else {})
    lines = [
        f"{result['model']} on {result['data']}: {result['clips']} clips, {result['repeats']} repeats, evaluators "
        f"{result['evaluators']} (mean ± 1.96 s.e.)",
        "",
        "| | " + " | ".join(columns.values()) + " |",
        "|---|" + "---|" * len(columns),
    ]
    for name in ("captured", "generated"):
        cells = [
            f"{row['mean']:.3f} ± {row['plus_minus']:.3f}" if (row := result[name].get(column)) else "-"
            for column in columns
        ]
        lines.append(f"| {name} | " + " | ".join(cells) + " |")
    return "\n".join(lines) + "\n"


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line: 0 if everything was measured, 2 for wrong input."""
    parser = benchmark_parser(__doc__)
    source = parser.add_mutually_exclusive_group(required=True)
    for option, data in SETS.items():
        source.add_argument(option, type=Path, help=f"folder of {data.name}, as published")
    parser.add_argument("--evaluators", type=Path, required=True, help="folder that import_evaluators wrote")
    parser.add_argument(
        "--evaluator-stats", type=Path, required=True, help="folder of the evaluators' mean.npy, std.npy"
    )
    parser.add_argument("--glove", type=Path, required=True, help="folder of our_vab_data.npy and its lists")
    parser.add_argument("--tmr", type=Path, help="folder that import_tmr wrote: further columns, of HumanML3D")
    add_arguments(parser, "bundle", "out", optional=("out",), repeats=20)
    parser.add_argument("--clips", type=int, help="test clips at most, to try it; the papers take all")
    parser.add_argument(
        "--many", type=int, default=MANY_CLIPS, help="clips a caption for Multimodality (30; 0 skips it)"
    )
    options = parser.parse_args(arguments)
    option = next(name for name in SETS if getattr(options, name.strip("-")) is not None)
    folder, data = getattr(options, option.strip("-")), SETS[option]
    try:
        evaluators = GuoEvaluators(options.evaluators, options.evaluator_stats, WordVectors.read(options.glove))
        if evaluators.features != data.features:
            raise InvalidInputError(
                f"the evaluators have {evaluators.features} features, {data.name} has {data.features}"
            )
        tmr = load_tmr(options.tmr, data)
        clips, problems = read_test_clips(folder, data, options.clips)
        for problem in problems:
            print(f"left out: {problem}", file=sys.stderr)
        pipe = MotionPipeline.load(options.bundle)
        offsets = (
            rest_offsets(joints_from_humanml3d(clips[0].features)[0]) if data.features == 263 else np.zeros((22, 3))
        )
        generate = Generator(pipe, data, offsets)
        scores = evaluate(clips, generate, evaluators, options.repeats, options.many, tmr)
    except KinegraphError as error:
        print(f"evaluate_published: error: {error}", file=sys.stderr)
        return 2
    result = {
        "model": f"{pipe.manifest.name} {pipe.manifest.version}",
        "data": data.name,
        "clips": len(clips),
        "repeats": options.repeats,
        "evaluators": evaluators.version,
        **({"tmr": tmr.version} if tmr else {}),
        **scores,
    }
    write_report(options.out, result, markdown_table(result))
    return 0


if __name__ == "__main__":
    sys.exit(main())
