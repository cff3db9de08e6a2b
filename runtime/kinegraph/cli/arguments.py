"""The arguments of every command."""

from __future__ import annotations

import argparse
from functools import partial
from pathlib import Path

from kinegraph.cli.inputs import level_numbers, level_steps, named, part_seconds


def add_bundle(parser: argparse.ArgumentParser) -> None:
    """Which bundle, and how to print."""
    parser.add_argument("--bundle", type=Path, metavar="DIR", help="a bundle's folder; default: the built-in one")
    parser.add_argument("--json", action="store_true", help="print one JSON object on one line")


def add_bench(parser: argparse.ArgumentParser) -> None:
    """Arguments of `bench`."""
    parser.add_argument("--bundle", type=Path, metavar="DIR", help="a bundle's folder; default: the built-in one")
    parser.add_argument("--seconds", type=float, default=4.0, metavar="S", help="length of the clip; default 4")
    parser.add_argument("--repeats", type=int, default=30, metavar="N", help="clips timed; default 30")
    parser.add_argument("--threads", type=int, metavar="N", help="threads a model may use")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write everything measured, every repeat, as JSON")


def add_generate(parser: argparse.ArgumentParser) -> None:
    """Arguments of `generate`."""
    parser.add_argument("text", nargs="?", help="the sentence, e.g. 'a person walks forward and waves'")
    _add_edits(parser)
    _add_sampling(parser)


def _add_edits(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--graph", metavar="FILE", help="a graph in JSON instead of the text; - is stdin")
    for name, what, example in (
        (
            "--weight",
            "NODE=NUMBER",
            "how much a part of the sentence counts, e.g. 'to the left=2'; 1 is as it is, 0 not",
        ),
        ("--drop", "NODE", "a part of the sentence that does not count, e.g. 'slowly'"),
        ("--mask", "NODE", "a part whose words are hidden, e.g. 'walks'"),
        ("--replace", "NODE=TEXT", "other words for a part, e.g. 'walks=runs'"),
    ):
        # one list, so that edits are made in the order in which they were typed
        parser.add_argument(
            name, dest="edits", action="append", type=partial(named, name), default=[], metavar=what, help=example
        )


def add_compose(parser: argparse.ArgumentParser) -> None:
    """Arguments of `compose`."""
    parser.add_argument(
        "--and",
        dest="wanted",
        action="append",
        default=[],
        metavar="TEXT[:WEIGHT]",
        help="a motion that should happen; several times for several",
    )
    parser.add_argument(
        "--not",
        dest="unwanted",
        action="append",
        default=[],
        metavar="TEXT[:WEIGHT]",
        help="a motion that should not; weight 1 unless told",
    )
    parser.add_argument("--method", default="fused", help="latent, semantic or fused (default)")
    parser.add_argument("--text", help="the joint sentence of fused; default: the wanted ones joined with 'while'")
    parser.add_argument(
        "--lambdas", type=level_numbers, metavar="L,S,M", help="shares of latent, semantic and joint text in fused"
    )
    parser.add_argument(
        "--energy", type=Path, metavar="FILE.png", help="also draw the energy of each concept and of the composition"
    )
    parser.add_argument(
        "--agd",
        type=level_numbers,
        metavar="A,R",
        help="step sizes of adaptive gradient descent, e.g. 0.1,0.1; default: off",
    )
    _add_sampling(parser)


def add_sequence(parser: argparse.ArgumentParser) -> None:
    """Arguments of `sequence`."""
    parser.add_argument("texts", nargs="+", metavar="TEXT", help="sentences in order")
    parser.add_argument(
        "--seconds",
        type=part_seconds,
        metavar="S[,S...]",
        help="length of each before the joins, or one for every sentence; without it the sentences decide",
    )
    _add_making(parser)


def _add_sampling(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--seconds", type=float, metavar="S", help="length; without it the sentence decides")
    _add_making(parser)


def _add_making(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "-o",
        "--output",
        type=Path,
        required=True,
        metavar="FILE",
        help="the suffix says the format: .bvh, .gif, .glb, .html, .json, .mp4, .npz, .png",
    )
    parser.add_argument(
        "--names", default="smpl", metavar="CONVENTION", help="joint names in .bvh and .glb: smpl (default) or mixamo"
    )
    parser.add_argument("--fps", type=float, metavar="N", help="frames per second of the file; default: the model's 20")
    parser.add_argument("--in-place", action="store_true", help="without travel over the floor")
    parser.add_argument("--loop", action="store_true", help="cut and blended so that the end leads into the beginning")
    parser.add_argument("--seed", type=int, help="the same seed gives the same clip; default: a new one")
    parser.add_argument(
        "--takes", type=int, default=1, metavar="N", help="clips of following seeds: FILE_1, FILE_2 ..."
    )
    parser.add_argument(
        "--steps", type=level_steps, metavar="N[,N,N]", help="diffusion steps: one number, or one per level"
    )
    parser.add_argument(
        "--guidance", type=level_numbers, metavar="X[,X,X]", help="guidance scale: one, or one per level"
    )
    parser.add_argument("--no-foot-fix", dest="foot_fix", action="store_false", help="leave feet as the model has them")
    parser.add_argument("--threads", type=int, metavar="N", help="threads a model may use")
    parser.add_argument("--force", action="store_true", help="overwrite the file if it is there")
    parser.add_argument("--progress", action="store_true", help="show progress even if stderr is no terminal")
    parser.add_argument("--quiet", action="store_true", help="print nothing but errors")
    add_bundle(parser)


def add_view(parser: argparse.ArgumentParser) -> None:
    """Arguments of `view`."""
    parser.add_argument("clips", nargs="+", type=Path, metavar="CLIP", help="clips saved as .npz, side by side")
    parser.add_argument("-o", "--output", type=Path, metavar="FILE", help="keep the page as this .html")
    parser.add_argument("--force", action="store_true", help="overwrite the file if it is there")
    parser.add_argument("--no-browser", dest="browser", action="store_false", help="only write the page")


def add_play(parser: argparse.ArgumentParser) -> None:
    """Arguments of `play`."""
    parser.add_argument("--port", type=int, default=8420, metavar="N", help="default 8420; 0 takes any that is free")
    parser.add_argument("--no-browser", dest="browser", action="store_false", help="only say the address")
    parser.add_argument("--threads", type=int, metavar="N", help="threads a model may use")
    parser.add_argument("--bundle", type=Path, metavar="DIR", help="a bundle's folder; default: the built-in one")


def add_parse(parser: argparse.ArgumentParser) -> None:
    """Arguments of `parse`."""
    parser.add_argument("text", nargs="?", help="the sentence")
    _add_edits(parser)
    parser.add_argument("--svg", type=Path, metavar="FILE", help="draw the graph instead of printing it")
    parser.add_argument("--force", action="store_true", help="overwrite the file if it is there")
    parser.add_argument(
        "--jsonl",
        type=Path,
        metavar="FILE",
        help='many: a caption or {"caption": "..."} on each line; prints one object on each line',
    )
    add_bundle(parser)
