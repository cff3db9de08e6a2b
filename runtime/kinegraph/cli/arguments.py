"""The arguments of every command, for argparse."""

from __future__ import annotations

import argparse
from functools import partial
from pathlib import Path
from typing import Final

from kinegraph.cli.constraints import add_constraints
from kinegraph.errors import InvalidInputError

SHOWN_ACTIONS: Final = 40
KNOWN_PHRASES: Final = (
    "The default bundle knows 173 actions, among them: raises the left hand, raises the right hand, raises "
    "both hands, runs, waves the right arm, waves the left arm, waves both hands, walks forward and turns "
    "right, walks forward and turns left, walks, runs, then stops, walks and stops, dances salsa, plays "
    "basketball, is bowing, walks in a circle to the left, sits down, claps, nods, passes a ball, sits, walks "
    "in a circle to the right, walks forward and makes a u-turn to the right, gives a thumbs up with the "
    "right hand, guards an opponent, sits down and stands up, gives a thumbs up with the left hand, is "
    "standing still, spreads the arms, walks forward and makes a u-turn to the left, is pushed forward, "
    "stands up, stands, picks up a ball, shoots a ball, is pushed backward, is catching a ball, gets up, "
    "walks on a basketball court, hits a forehand with the right hand in tennis; how: in a normal way, "
    "energetically, in a feminine way, in a youthful way, in a masculine way, in a tired way, like an old "
    "person, angrily, in a childish way, like a thug, like a giant, happily, in a musical way, proudly, "
    "sadly, timidly; and what these make together. Other words are told on stderr. `kinegraph info --words` "
    "has all, with a sentence and the number of clips of each."
)
"""End of the help of `generate`; a test compares it with the default bundle, as reading that takes too long."""


def add_bundle(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of `verify`, which many commands share."""
    _add_bundle_path(parser)
    parser.add_argument("--json", action="store_true", help="print one JSON object on one line")


def add_info(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of `info`."""
    parser.add_argument(
        "--words", action="store_true", help="list the actions and styles that the bundle was shown, with an example"
    )
    add_bundle(parser)


def add_bench(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of `bench`."""
    _add_bundle_path(parser)
    parser.add_argument("--seconds", type=float, default=4.0, metavar="S", help="length of the clip; default 4")
    parser.add_argument("--repeats", type=int, default=30, metavar="N", help="number of timed clips; default 30")
    _add_threads(parser)
    parser.add_argument("--json", type=Path, metavar="FILE", help="write all measurements, every repeat, as JSON")


def add_generate(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of `generate`."""
    parser.epilog = KNOWN_PHRASES
    parser.add_argument("text", nargs="?", help="the sentence, e.g. 'a person walks forward and waves'")
    _add_edits(parser)
    add_constraints(parser)
    _add_seconds(parser)
    _add_space(parser)
    _add_sampling_and_output(parser)


def add_compose(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of `compose`."""
    parser.add_argument(
        "--and",
        dest="positive",
        action="append",
        default=[],
        metavar="TEXT[:WEIGHT]",
        help="a motion that should happen; repeat it for each motion",
    )
    parser.add_argument(
        "--not",
        dest="negated",
        action="append",
        default=[],
        metavar="TEXT[:WEIGHT]",
        help="a motion that should not happen; default weight 1",
    )
    parser.add_argument(
        "--method",
        default="auto",
        help="latent, semantic, fused, parts or auto (default): parts where nothing is weighed and all --and but one "
        "are for hands and arms, each for its own; else fused",
    )
    parser.add_argument("--text", help="the joint sentence of fused; default: all --and joined with 'while'")
    parser.add_argument(
        "--lambdas", type=_floats, metavar="L,S,M", help="shares of latent, semantic and joint text in fused"
    )
    parser.add_argument(
        "--energy", type=Path, metavar="FILE.png", help="also draw the energy of each concept and of the composition"
    )
    parser.add_argument(
        "--agd",
        type=_floats,
        metavar="A,R",
        help="step sizes of adaptive gradient descent, e.g. 0.001,0.002; default: off",
    )
    add_constraints(parser)
    _add_seconds(parser)
    _add_space(parser)
    _add_sampling_and_output(parser)


def add_sequence(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of `sequence`."""
    parser.add_argument("texts", nargs="+", metavar="TEXT", help="sentences in order")
    parser.add_argument(
        "--seconds",
        type=_floats,
        metavar="S[,S...]",
        help="length of each part before joining, or one for all; default: the sentences decide",
    )
    parser.add_argument(
        "--method",
        default="blend",
        help="blend parts where poses are alike (default); continue: each begins in the last pose of the one before; "
        "energy: all in one run of skeleton space, where the bundle has it",
    )
    parser.add_argument(
        "--seed-offsets",
        type=_row_of_integers,
        metavar="K[,K...]",
        help="what each part adds to the seed; default: 0,1,2 ...",
    )
    _add_sampling_and_output(parser)


def add_timeline(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of `timeline`."""
    parser.add_argument(
        "file",
        type=Path,
        metavar="FILE",
        help="text with a line for each interval: text # start # end # parts of the body",
    )
    parser.add_argument(
        "--overlap", type=float, metavar="S", help="seconds that neighbours share in skeleton space; default 0.8"
    )
    add_constraints(parser)
    _add_space(parser)
    _add_sampling_and_output(parser)


def add_edit(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of `edit`."""
    parser.add_argument("clip", type=Path, metavar="CLIP", help="saved as .npz, .json, .glb or .bvh")
    parser.add_argument("text", help="what happens in the rest")
    parser.add_argument(
        "--keep",
        action="append",
        required=True,
        metavar="PART|SPAN",
        help="legs, left leg, right leg, arms, left arm, right arm, head, torso, or a span like 0-1s; repeatable",
    )
    parser.add_argument(
        "--strength", type=float, default=1.0, metavar="X", help="below 1 more of the clip stays; default 1"
    )
    add_constraints(parser)
    _add_space(parser)
    _add_sampling_and_output(parser)


def add_inbetween(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of `inbetween`."""
    parser.add_argument("first", type=Path, metavar="CLIP", help="a saved clip, whose end is the beginning")
    parser.add_argument("last", type=Path, metavar="CLIP", help="a saved clip, whose beginning is the end")
    parser.add_argument("text", help="what happens between")
    parser.add_argument("--seconds", type=float, default=2.0, metavar="S", help="length; default 2")
    add_constraints(parser)
    _add_space(parser)
    _add_sampling_and_output(parser)


def add_retarget(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of `retarget`."""
    parser.add_argument("clip", type=Path, metavar="CLIP", help="saved as .npz, .json, .glb or .bvh")
    parser.add_argument(
        "character", type=Path, metavar="CHARACTER", help="a skinned human, .glb, .gltf or .vrm, or a .bvh skeleton"
    )
    parser.add_argument("-o", "--output", type=Path, required=True, metavar="FILE", help=".glb to write, or .bvh")
    _add_map(parser)
    parser.add_argument("--fps", type=float, metavar="N", help="frames per second of the animation; default 30")
    parser.add_argument("--in-place", action="store_true", help="remove travel over the floor")
    parser.add_argument("--root", action="store_true", help="let the joint above the pelvis carry travel and heading")
    _add_force(parser)
    parser.add_argument("--json", action="store_true", help="print one JSON object on one line")


def add_batch(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of `batch`."""
    parser.add_argument(
        "table",
        type=Path,
        metavar="PROMPTS.csv",
        help="columns: text, and seconds, seed, name, constraints (a file) if wanted",
    )
    parser.add_argument("-o", "--output", type=Path, required=True, metavar="FOLDER", help="for the files and manifest")
    parser.add_argument("--format", default=".npz", metavar="SUFFIX", help="of the files; default .npz")
    parser.add_argument("--character", "--skeleton", type=Path, metavar="FILE", help="put every clip on this character")
    parser.add_argument("--names", default="smpl", metavar="CONVENTION", help="joint names: smpl (default) or mixamo")
    parser.add_argument("--root", action="store_true", help="add a joint that carries travel and heading")
    parser.add_argument("--fps", type=float, metavar="N", help="frames per second of the files")
    parser.add_argument("--in-place", action="store_true", help="remove travel over the floor")
    parser.add_argument("--loop", action="store_true", help="cut and blend so that the end leads into the beginning")
    parser.add_argument("--seed", type=int, default=0, help="of the first row without one; row k has this and k - 1")
    parser.add_argument("--strict", action="store_true", help="rows with words that the bundle was never shown fail")
    parser.add_argument("--workers", type=int, metavar="N", help="processes; default: one for each core")
    parser.add_argument("--progress", action="store_true", help="show progress even if stderr is no terminal")
    parser.add_argument("--quiet", action="store_true", help="print nothing but errors")
    add_bundle(parser)


def add_view(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of `view`."""
    parser.add_argument("clips", nargs="+", type=Path, metavar="CLIP", help="saved as .npz, .json, .glb or .bvh")
    parser.add_argument("-o", "--output", type=Path, metavar="FILE", help="keep the page as this .html")
    _add_force(parser)
    parser.add_argument("--no-browser", dest="browser", action="store_false", help="only write the page")


def add_play(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of `play`."""
    parser.add_argument("--port", type=int, default=8420, metavar="N", help="default 8420; 0 takes any free port")
    parser.add_argument(
        "--host",
        metavar="ADDRESS",
        help="let other devices in, too, e.g. 0.0.0.0: prints a link with a token as a QR code",
    )
    parser.add_argument("--token", help="of that link, or the variable KINEGRAPH_TOKEN; default: drawn")
    parser.add_argument("--no-browser", dest="browser", action="store_false", help="only print the address")
    _add_threads(parser)
    _add_bundle_path(parser)


def add_serve(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of `serve`."""
    parser.add_argument("--port", type=int, default=8421, metavar="N", help="default 8421; 0 takes any free port")
    parser.add_argument("--host", metavar="ADDRESS", help="answer other machines, too, e.g. 0.0.0.0; needs a token")
    parser.add_argument(
        "--token", help="what requests must send as Authorization: Bearer; better in the variable KINEGRAPH_TOKEN"
    )
    parser.add_argument("--characters", type=Path, metavar="FOLDER", help="characters that requests may name")
    _add_threads(parser)
    _add_bundle_path(parser)


def add_parse(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of `parse`."""
    parser.add_argument("text", nargs="?", help="the sentence")
    _add_edits(parser)
    parser.add_argument("--svg", type=Path, metavar="FILE", help="draw the graph instead of printing it")
    _add_force(parser)
    parser.add_argument(
        "--jsonl",
        type=Path,
        metavar="FILE",
        help='parse many: a caption or {"caption": "..."} on each line; prints one object on each line',
    )
    add_bundle(parser)


def _add_edits(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--graph", metavar="FILE", help="a graph in JSON instead of the text; - is stdin")
    for flag, metavar, description in (
        ("--weight", "NODE=NUMBER", "weight of a part of the sentence, e.g. 'to the left=2'; 1 keeps it, 0 ignores it"),
        ("--drop", "NODE", "a part of the sentence to leave out, e.g. 'slowly'"),
        ("--mask", "NODE", "a part whose words are hidden, e.g. 'walks'"),
        ("--replace", "NODE=TEXT", "other words for a part, e.g. 'walks=runs'"),
    ):
        # All edits share one list, so that they are applied in the order in which they were typed.
        parser.add_argument(
            flag,
            dest="edits",
            action="append",
            type=partial(_flag_and_value, flag),
            default=[],
            metavar=metavar,
            help=description,
        )


def _add_map(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--map",
        type=Path,
        metavar="FILE.json",
        help='joints of the character that are not found: {"left_hip": "name of the joint", ...}',
    )


def _add_seconds(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--seconds", type=float, metavar="S", help="length; default: the sentence decides")


def _add_space(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--space",
        default="latent",
        metavar="NAME",
        help="where clips are sampled: latent (default), or frames, skeleton space, where the bundle has it",
    )


def _add_sampling_and_output(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "-o",
        "--output",
        type=Path,
        required=True,
        metavar="FILE",
        help="the suffix chooses the format: .bvh, .gif, .glb, .html, .json, .mp4, .npz, .png, .vrma",
    )
    parser.add_argument(
        "--names", default="smpl", metavar="CONVENTION", help="joint names in .bvh and .glb: smpl (default) or mixamo"
    )
    parser.add_argument(
        "--root", action="store_true", help="add a joint 'root' that carries travel and heading in .bvh and .glb"
    )
    parser.add_argument(
        "--character",
        "--skeleton",
        type=Path,
        metavar="FILE",
        help="a skinned human, .glb, .gltf or .vrm: the .glb to write is this file with the clip as an animation; or a "
        ".bvh skeleton for the .bvh to write",
    )
    _add_map(parser)
    parser.add_argument(
        "--fps",
        type=float,
        metavar="N",
        help="frames per second of the file; default: the model's 20, or 30 with --character",
    )
    parser.add_argument("--in-place", action="store_true", help="remove travel over the floor")
    parser.add_argument("--loop", action="store_true", help="cut and blend so that the end leads into the beginning")
    parser.add_argument("--seed", type=int, help="the same seed gives the same clip; default: a new one")
    parser.add_argument(
        "--takes", type=int, default=1, metavar="N", help="clips of consecutive seeds: FILE_1, FILE_2 ..."
    )
    parser.add_argument(
        "--steps", type=_integers, metavar="N[,N,N]", help="diffusion steps: one number, or one per level"
    )
    parser.add_argument("--guidance", type=_floats, metavar="X[,X,X]", help="guidance scale: one, or one per level")
    parser.add_argument("--no-foot-fix", dest="foot_fix", action="store_false", help="do not lock standing feet")
    parser.add_argument(
        "--strict", action="store_true", help="refuse words that the bundle was never shown; nothing is written"
    )
    _add_threads(parser)
    _add_force(parser)
    parser.add_argument("--progress", action="store_true", help="show progress even if stderr is no terminal")
    parser.add_argument("--quiet", action="store_true", help="print nothing but errors")
    add_bundle(parser)


def _add_bundle_path(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--bundle",
        metavar="NAME|DIR",
        help="an installed bundle (`kinegraph info` lists them) or the folder of another; default: the built-in one",
    )


def _add_threads(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--threads", type=int, metavar="N", help="threads a model may use")


def _add_force(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--force", action="store_true", help="overwrite an existing file")


def _flag_and_value(flag: str, value: str) -> tuple[str, str]:
    return flag, value


def _integers(text: str) -> int | tuple[int, ...]:
    from kinegraph.options import parse_numbers  # loads numpy

    try:
        return parse_numbers(text, int)
    except InvalidInputError as error:
        raise argparse.ArgumentTypeError(str(error)) from None


def _row_of_integers(text: str) -> tuple[int, ...]:
    numbers = _integers(text)
    return numbers if isinstance(numbers, tuple) else (numbers,)


def _floats(text: str) -> float | tuple[float, ...]:
    from kinegraph.options import parse_numbers  # loads numpy

    try:
        return parse_numbers(text, float)
    except InvalidInputError as error:
        raise argparse.ArgumentTypeError(str(error)) from None
