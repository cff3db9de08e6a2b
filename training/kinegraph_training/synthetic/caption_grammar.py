"""Wording of synthetic captions: verb phrases per action, adverbial phrases per style, and sentence templates.

Templates name `{subject}`; `{a}` and `{b}`, finite verb phrases ("walks"); `{a_ing}` and `{b_ing}`, participles that
follow "while" ("walking"); and `{n}`, a number of steps.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class ActionPhrases:
    """Verb phrases for one action."""

    finite: tuple[str, ...]
    """As in "a person walks"."""
    participle: tuple[str, ...]
    """As in "while walking"; participle i belongs to finite phrase i."""
    arms_or_legs: bool = True
    """Whether it moves arms or legs alone; actions of the whole body cannot be spliced."""


def _verbs(*pairs: tuple[str, str], arms_or_legs: bool = True) -> ActionPhrases:
    return ActionPhrases(
        tuple(finite for finite, _ in pairs), tuple(participle for _, participle in pairs), arms_or_legs
    )


def _hand(side: str) -> str:
    return "both hands" if side == "both" else f"the {side} hand"


def _raise(side: str) -> ActionPhrases:
    hand = _hand(side)
    arm = "both arms" if side == "both" else f"the {side} arm"
    return _verbs(
        (f"raises {hand}", f"raising {hand}"),
        (f"lifts {hand} up", f"lifting {hand} up"),
        (f"raises {arm} above the head", f"raising {arm} above the head"),
        (f"puts {hand} up", f"putting {hand} up"),
        (f"holds {arm} up high", f"holding {arm} up high"),
    )


def _wave(side: str) -> ActionPhrases:
    hand = _hand(side)
    arm = "both arms" if side == "both" else f"the {side} arm"
    return _verbs(
        (f"waves {hand}", f"waving {hand}"),
        (f"waves with {hand}", f"waving with {hand}"),
        (f"waves {arm}", f"waving {arm}"),
        (f"swings {hand} from side to side", f"swinging {hand} from side to side"),
    )


def _turn(side: str) -> ActionPhrases:
    return _verbs(
        (f"turns {side} while walking", f"turning {side}"),
        (f"walks and turns to the {side}", f"walking around a turn to the {side}"),
        (f"turns to the {side}", f"turning to the {side}"),
        (f"walks forward and then turns {side}", f"walking and turning {side}"),
    )


PHRASES: dict[str, ActionPhrases] = {
    "walk": _verbs(("walks", "walking"), ("walks forward", "walking forward"), ("walks ahead", "walking ahead"),
                   ("walks straight ahead", "walking straight ahead")),
    "run": _verbs(("runs", "running"), ("runs forward", "running forward"), ("jogs", "jogging"),
                  ("runs ahead", "running ahead")),
    "dash": _verbs(("dashes forward", "dashing forward"), ("sprints", "sprinting")),
    "walk-back": _verbs(("walks backward", "walking backward"), ("steps backwards", "stepping backwards")),
    "walk-left": _verbs(("walks to the left", "walking to the left"), ("walks leftward", "walking leftward")),
    "walk-right": _verbs(("walks to the right", "walking to the right"), ("walks rightward", "walking rightward")),
    "walk-turn-left": _turn("left"),
    "walk-turn-right": _turn("right"),
    "raise-up-left-hand": _raise("left"),
    "raise-up-right-hand": _raise("right"),
    "raise-up-both-hands": _raise("both"),
    "wave-left-hand": _wave("left"),
    "wave-right-hand": _wave("right"),
    "wave-both-hands": _wave("both"),
    "bye": _verbs(("waves goodbye", "waving goodbye"), ("says goodbye", "saying goodbye")),
    "byebye": _verbs(("waves bye-bye", "waving bye-bye"), ("waves goodbye again and again", "waving goodbye")),
    "bow": _verbs(("bows", "bowing"), ("takes a bow", "taking a bow"), ("bows down", "bowing down"),
                  arms_or_legs=False),
    "guide": _verbs(("shows the way", "showing the way"), ("guides somebody", "guiding somebody"), arms_or_legs=False),
}  # fmt: skip
"""By action label."""

LOCOMOTION = frozenset(name for name in PHRASES if name.startswith(("walk", "run", "dash")))

SUBJECTS = ("a person", "a person", "a person", "someone", "the person", "a man", "a figure", "a human", "somebody")

STYLE_PHRASES: dict[str, tuple[str, ...]] = {
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
"""By style; an empty phrase leaves the style unsaid."""

NUMBERS = ("two", "three", "four", "five", "six", "seven", "eight", "nine", "ten", "eleven", "twelve")
"""From 2 on, as one step is no walk, up to what people count."""

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
"""Templates that say how many steps are taken, by action label."""


def is_turn(action: str) -> bool:
    """Tell whether an action label names a turn."""
    return "turn" in action


def _draw(options: tuple[str, ...], rng: np.random.Generator) -> str:
    return options[int(rng.integers(len(options)))]


def _captions(
    templates: tuple[str, ...], first: ActionPhrases, second: ActionPhrases, style: str, rng: np.random.Generator
) -> tuple[str, ...]:
    captions = []
    for template in templates:
        text = template.format(
            subject=_draw(SUBJECTS, rng),
            a=_draw(first.finite, rng),
            b=_draw(second.finite, rng),
            a_ing=_draw(first.participle, rng),
            b_ing=_draw(second.participle, rng),
        )
        style_phrase = _draw(STYLE_PHRASES.get(style, ("",)), rng)
        captions.append(f"{text} {style_phrase}".strip() + ".")
    return tuple(captions)


def step_count_captions(action: str, steps: int | None, style: str, rng: np.random.Generator) -> tuple[str, ...]:
    """Write two captions that name the number of steps; none where it is unknown or not in `NUMBERS`."""
    if action not in COUNTED_STEPS or steps is None or not 2 <= steps < len(NUMBERS) + 2:
        return ()
    captions = []
    for _ in range(2):
        text = _draw(COUNTED_STEPS[action], rng).format(subject=_draw(SUBJECTS, rng), n=NUMBERS[steps - 2])
        captions.append(f"{text} {_draw(STYLE_PHRASES.get(style, ('',)), rng)}".strip() + ".")
    return tuple(captions)


def concept_caption(action: str, style: str, rng: np.random.Generator) -> str:
    """Write a sentence of one action in a style."""
    parts = (_draw(SUBJECTS, rng), _draw(PHRASES[action].finite, rng), _draw(STYLE_PHRASES.get(style, ("",)), rng))
    return " ".join(parts).strip() + "."


def splice_caption(carrier: str, gesture: str, style: str, rng: np.random.Generator) -> tuple[str, ...]:
    """Write captions of two actions at once, in four templates."""
    templates = (
        "{subject} {a} while {b_ing}",
        "{subject} {a} and {b}",
        "{subject} {b} while {a_ing}",
        "{subject} is {a_ing} and {b_ing} at the same time",
    )
    return _captions(templates, PHRASES[carrier], PHRASES[gesture], style, rng)


def sequence_caption(first: str, second: str, style: str, rng: np.random.Generator) -> tuple[str, ...]:
    """Write captions of one action after another, in four templates."""
    templates = (
        "{subject} {a}, then {b}",
        "{subject} {a} and then {b}",
        "first {subject} {a}, and after that {b}",
        "after {a_ing}, {subject} {b}",
    )
    return _captions(templates, PHRASES[first], PHRASES[second], style, rng)
