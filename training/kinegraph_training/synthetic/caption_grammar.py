"""Wording of made compositions: verb phrases per content, and manners per style.

`{s}` forms follow a subject ("walks"), `{ing}` forms follow "while" ("walking").
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Phrases:
    """Ways to say one content."""

    finite: tuple[str, ...]
    participle: tuple[str, ...]
    arms_or_legs: bool = True
    """False for actions of the whole body, which cannot be spliced."""


def _say(*pairs: tuple[str, str], spliced: bool = True) -> Phrases:
    return Phrases(tuple(finite for finite, _ in pairs), tuple(participle for _, participle in pairs), spliced)


def _hand(side: str) -> str:
    return "both hands" if side == "both" else f"the {side} hand"


def _raise(side: str) -> Phrases:
    hand = _hand(side)
    arm = "both arms" if side == "both" else f"the {side} arm"
    return _say(
        (f"raises {hand}", f"raising {hand}"),
        (f"lifts {hand} up", f"lifting {hand} up"),
        (f"raises {arm} above the head", f"raising {arm} above the head"),
        (f"puts {hand} up", f"putting {hand} up"),
        (f"holds {arm} up high", f"holding {arm} up high"),
    )


def _wave(side: str) -> Phrases:
    hand = _hand(side)
    arm = "both arms" if side == "both" else f"the {side} arm"
    return _say(
        (f"waves {hand}", f"waving {hand}"),
        (f"waves with {hand}", f"waving with {hand}"),
        (f"waves {arm}", f"waving {arm}"),
        (f"swings {hand} from side to side", f"swinging {hand} from side to side"),
    )


def _turn(side: str) -> Phrases:
    return _say(
        (f"turns {side} while walking", f"turning {side}"),
        (f"walks and turns to the {side}", f"walking around a turn to the {side}"),
        (f"turns to the {side}", f"turning to the {side}"),
        (f"walks forward and then turns {side}", f"walking and turning {side}"),
    )


PHRASES: dict[str, Phrases] = {
    "walk": _say(("walks", "walking"), ("walks forward", "walking forward"), ("walks ahead", "walking ahead"),
                 ("walks straight ahead", "walking straight ahead")),
    "run": _say(("runs", "running"), ("runs forward", "running forward"), ("jogs", "jogging"),
                ("runs ahead", "running ahead")),
    "dash": _say(("dashes forward", "dashing forward"), ("sprints", "sprinting")),
    "walk-back": _say(("walks backward", "walking backward"), ("steps backwards", "stepping backwards")),
    "walk-left": _say(("walks to the left", "walking to the left"), ("walks leftward", "walking leftward")),
    "walk-right": _say(("walks to the right", "walking to the right"), ("walks rightward", "walking rightward")),
    "walk-turn-left": _turn("left"),
    "walk-turn-right": _turn("right"),
    "raise-up-left-hand": _raise("left"),
    "raise-up-right-hand": _raise("right"),
    "raise-up-both-hands": _raise("both"),
    "wave-left-hand": _wave("left"),
    "wave-right-hand": _wave("right"),
    "wave-both-hands": _wave("both"),
    "bye": _say(("waves goodbye", "waving goodbye"), ("says goodbye", "saying goodbye")),
    "byebye": _say(("waves bye-bye", "waving bye-bye"), ("waves goodbye again and again", "waving goodbye")),
    "bow": _say(("bows", "bowing"), ("takes a bow", "taking a bow"), ("bows down", "bowing down"), spliced=False),
    "guide": _say(("shows the way", "showing the way"), ("guides somebody", "guiding somebody"), spliced=False),
}  # fmt: skip

LOCOMOTION = frozenset(name for name in PHRASES if name.startswith(("walk", "run", "dash")))

SUBJECTS = ("a person", "a person", "a person", "someone", "the person", "a man", "a figure", "a human", "somebody")

MANNERS: dict[str, tuple[str, ...]] = {
    "normal": ("", "", "", "in a normal way"),
    "active": ("energetically", "with a lot of energy", "in a lively way"),
    "elderly": ("like an old person", "like an elderly person", "in an elderly way"),
    "exhausted": ("in a tired way", "looking exhausted", "wearily"),
    "feminine": ("in a feminine way", "in a feminine manner"),
    "masculine": ("in a masculine way", "in a manly way"),
    "youthful": ("in a youthful way", "like a young person"),
    "happy": ("happily", "in a happy mood"),
    "sad": ("sadly", "in a sad mood"),
    "angry": ("angrily", "in an angry way"),
    "proud": ("proudly", "with pride"),
    "not-confident": ("timidly", "without confidence"),
    "childish": ("in a childish way", "like a child"),
    "giant": ("like a giant",),
    "chimpira": ("like a thug",),
    "musical": ("in a musical way",),
}

NUMBERS = ("two", "three", "four", "five", "six", "seven", "eight", "nine", "ten", "eleven", "twelve")
"""From 2 on: one step is no walk, and nobody counts further."""

_AHEAD = ("{subject} walks {n} steps", "{subject} takes {n} steps forward", "{subject} walks ahead for {n} steps")
COUNTED_STEPS: dict[str, tuple[str, ...]] = {
    "walk": _AHEAD,
    "run": ("{subject} runs {n} steps", "{subject} takes {n} running steps", "{subject} jogs for {n} steps"),
    "dash": ("{subject} dashes {n} steps", "{subject} sprints for {n} steps"),
    "walk-back": ("{subject} takes {n} steps back", "{subject} walks {n} steps backwards"),
    **{f"walk-{side}": (f"{{subject}} takes {{n}} steps to the {side}", f"{{subject}} walks {side} for {{n}} steps")
       for side in ("left", "right")},
    **{f"walk-turn-{side}": (f"{{subject}} takes {{n}} steps and turns {side}",
                             f"{{subject}} turns to the {side} while walking {{n}} steps",
                             f"{{subject}} walks {{n}} steps, turning to the {side}")
       for side in ("left", "right")},
}  # fmt: skip
"""Ways to say how many steps are taken, per content."""

CAPTIONS_PER_CLIP = 4


def _one(options: tuple[str, ...], rng: np.random.Generator) -> str:
    return options[int(rng.integers(len(options)))]


def _captions(
    templates: tuple[str, ...], first: Phrases, second: Phrases, style: str, rng: np.random.Generator
) -> tuple[str, ...]:
    made = []
    for template in templates:
        text = template.format(
            subject=_one(SUBJECTS, rng),
            a=_one(first.finite, rng),
            b=_one(second.finite, rng),
            a_ing=_one(first.participle, rng),
            b_ing=_one(second.participle, rng),
        )
        manner = _one(MANNERS.get(style, ("",)), rng)
        made.append(f"{text} {manner}".strip() + ".")
    return tuple(made)


def counted_captions(content: str, steps: int | None, style: str, rng: np.random.Generator) -> tuple[str, ...]:
    """Two captions that name the number of steps, where it is known and can be said."""
    if content not in COUNTED_STEPS or steps is None or not 2 <= steps < len(NUMBERS) + 2:
        return ()
    made = []
    for _ in range(2):
        text = _one(COUNTED_STEPS[content], rng).format(subject=_one(SUBJECTS, rng), n=NUMBERS[steps - 2])
        made.append(f"{text} {_one(MANNERS.get(style, ('',)), rng)}".strip() + ".")
    return tuple(made)


def concept_caption(content: str, style: str, rng: np.random.Generator) -> str:
    """A sentence of one action in its manner."""
    parts = (_one(SUBJECTS, rng), _one(PHRASES[content].finite, rng), _one(MANNERS.get(style, ("",)), rng))
    return " ".join(parts).strip() + "."


def splice_caption(carrier: str, gesture: str, style: str, rng: np.random.Generator) -> tuple[str, ...]:
    """Captions of two actions at once."""
    templates = (
        "{subject} {a} while {b_ing}",
        "{subject} {a} and {b}",
        "{subject} {b} while {a_ing}",
        "{subject} is {a_ing} and {b_ing} at the same time",
    )
    return _captions(templates, PHRASES[carrier], PHRASES[gesture], style, rng)


def sequence_caption(first: str, second: str, style: str, rng: np.random.Generator) -> tuple[str, ...]:
    """Captions of one action after another."""
    templates = (
        "{subject} {a}, then {b}",
        "{subject} {a} and then {b}",
        "first {subject} {a}, and after that {b}",
        "after {a_ing}, {subject} {b}",
    )
    return _captions(templates, PHRASES[first], PHRASES[second], style, rng)
