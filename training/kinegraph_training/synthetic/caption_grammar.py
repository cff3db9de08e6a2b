"""Wording of synthetic captions: verb phrases per action, adverbial phrases per style, and sentence templates.

Templates name `{subject}`; `{a}`, `{b}` and `{c}`, finite verb phrases ("walks"); `{a_ing}` and so on, participles that
follow "while" ("walking"); and `{n}`, a number of steps. The verb phrases are those of the action table.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from kinegraph_training.synthetic.action_table import Action, read_action_table

PHRASES: dict[str, Action] = dict(read_action_table().actions)
"""By action label."""

TRAVEL = ("walk", "run", "dash", "jog", "march", "skip", "shuffle", "hop", "start-walking")
LOCOMOTION = frozenset(name for name, action in PHRASES.items() if action.parts == "legs" and name.startswith(TRAVEL))

SUBJECTS = (
    *("a person",) * 6,
    *("someone", "the person", "a man", "a woman", "a figure", "a human", "somebody", "he", "she", "the man"),
    *("a guy", "a character", "the character", "one", "a player", "an actor"),
)

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


FINAL_STOP = 0.3
"""Share of captions that end with a full stop."""


def without_side(phrases: Sequence[str], side: str) -> Sequence[str]:
    """Keep the phrases that do not name the side ("kicks", "throws a punch"), if there are any."""
    return [phrase for phrase in phrases if side not in phrase] or phrases


def with_side(phrases: Sequence[str], side: str) -> Sequence[str]:
    """Keep the phrases that name the side, if there is one: of two hands it must be said which does what."""
    return [phrase for phrase in phrases if side in phrase] if side else phrases


def _draw(options: Sequence[str], rng: np.random.Generator) -> str:
    return options[int(rng.integers(len(options)))]


def _fill(template: str, actions: Sequence[str], style: str, rng: np.random.Generator) -> str:
    """Fill one template with wordings of actions and a style."""
    words = {"subject": _draw(SUBJECTS, rng)}
    for letter, label in zip("abc", actions, strict=False):
        words[letter] = _draw(with_side(PHRASES[label].finite, PHRASES[label].side), rng)
        words[f"{letter}_ing"] = _draw(with_side(PHRASES[label].participle, PHRASES[label].side), rng)
    text = f"{template.format(**words)} {_draw(STYLE_PHRASES.get(style, ('',)), rng)}".strip()
    return text + "." if rng.random() < FINAL_STOP else text


def step_count_captions(action: str, steps: int | None, style: str, rng: np.random.Generator) -> tuple[str, ...]:
    """Write two captions that name the number of steps; none where it is unknown or not in `NUMBERS`."""
    if action not in COUNTED_STEPS or steps is None or not 2 <= steps < len(NUMBERS) + 2:
        return ()
    captions = []
    for _ in range(2):
        text = _draw(COUNTED_STEPS[action], rng).format(subject=_draw(SUBJECTS, rng), n=NUMBERS[steps - 2])
        captions.append(f"{text} {_draw(STYLE_PHRASES.get(style, ('',)), rng)}".strip() + ".")
    return tuple(captions)


ALONE = ("{subject} {a}",) * 5 + ("{subject} is {a_ing}",) * 2
GOING_ON = "{subject} keeps {a_ing}"
"""One more template for steady actions: a kick is not kept up."""
WITHOUT_SIDE = 0.2
"""Share of captions of an action with a side that do not name it."""


def concept_caption(action: str, style: str, rng: np.random.Generator) -> str:
    """Write a sentence of one action in a style."""
    entry = PHRASES[action]
    style_phrase = _draw(STYLE_PHRASES.get(style, ("",)), rng)
    if entry.noun and rng.random() < 0.1:
        verb = _draw(("does", "performs", "makes"), rng)
        text = f"{_draw(SUBJECTS, rng)} {verb} {_draw(entry.noun, rng)}"
    else:
        finite, participle = entry.finite, entry.participle
        if entry.side and rng.random() < WITHOUT_SIDE:
            finite, participle = without_side(finite, entry.side), without_side(participle, entry.side)
        template = _draw((*ALONE, GOING_ON) if entry.steady else ALONE, rng)
        if template == GOING_ON:
            participle = [phrase for phrase in participle if not phrase.startswith(("keeping ", "staying "))]
        text = template.format(subject=_draw(SUBJECTS, rng), a=_draw(finite, rng), a_ing=_draw(participle, rng))
    text = f"{text} {style_phrase}".strip()
    return text + "." if rng.random() < FINAL_STOP else text


TWO_AT_ONCE = (
    "{subject} {a} while {b_ing}",
    "{subject} {a} and {b}",
    "{subject} {b} while {a_ing}",
    "{subject} is {a_ing} and {b_ing} at the same time",
    "while {a_ing}, {subject} {b}",
    "{subject} {a} and {b} at the same time",
)
THREE_AT_ONCE = (
    "{subject} {a} while {b_ing} and {c_ing}",
    "{subject} {a}, {b} and {c}",
    "while {a_ing}, {subject} {b} and {c}",
    "{subject} is {a_ing} while {b_ing} and {c_ing}",
    "{subject} {b} and {c} while {a_ing}",
)
IN_SEQUENCE = (
    "{subject} {a}, then {b}",
    "{subject} {a} and then {b}",
    "first {subject} {a}, and after that {b}",
    "after {a_ing}, {subject} {b}",
    "{subject} {a}. then {subject} {b}",
    "{subject} {a} before {b_ing}",
)
CAPTIONS = 3
"""Captions written for a clip of several actions."""


def splice_caption(actions: Sequence[str], style: str, rng: np.random.Generator) -> tuple[str, ...]:
    """Write captions of two or three actions at once, the carrier first."""
    templates = TWO_AT_ONCE if len(actions) == 2 else THREE_AT_ONCE
    drawn = rng.choice(len(templates), CAPTIONS, replace=False)
    return tuple(_fill(templates[index], actions, style, rng) for index in drawn)


def partial_captions(actions: Sequence[str], style: str, rng: np.random.Generator) -> tuple[str, ...]:
    """Write captions that name some of several actions at once: each of them, and of three each pair."""
    each = 2 if len(actions) == 2 else 1
    captions = [concept_caption(action, style, rng) for action in actions for _ in range(each)]
    if len(actions) == 3:
        for left_out in range(3):
            pair = [action for index, action in enumerate(actions) if index != left_out]
            captions.append(_fill(_draw(TWO_AT_ONCE, rng), pair, style, rng))
    return tuple(captions)


def draw_concepts(captions: Sequence[str], actions: int, rng: np.random.Generator) -> tuple[str, ...]:
    """Draw of `partial_captions` some that name each action of a clip once; of three, also one and the other two."""
    if actions == 2:
        return captions[int(rng.integers(2))], captions[2 + int(rng.integers(2))]
    alone = int(rng.integers(4))
    return tuple(captions[:3]) if alone == 3 else (captions[alone], captions[3 + alone])


def sequence_caption(first: str, second: str, style: str, rng: np.random.Generator) -> tuple[str, ...]:
    """Write captions of one action after another."""
    drawn = rng.choice(len(IN_SEQUENCE), CAPTIONS, replace=False)
    return tuple(_fill(IN_SEQUENCE[index], (first, second), style, rng) for index in drawn)
