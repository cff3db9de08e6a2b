"""Interpret a graph for the model: what is asked for when a sentence negates, orders, counts, or uses other words.

    split_sequence(graph)      "walk forward, then bow"       ->  "a person walks forward", "a person bows"
    in_third_person(graph)     "walk forward, then bow"       ->  "a person walks forward, then bows"
    split_at_once(graph)       "a man walks while waving"     ->  "a man walks", "a man waves"
    split_negations(graph)     "a man walks without waving"   ->  "a man walks" and, negated, "a man waves"
    known_wording(graph)       "a person turns clockwise"     ->  "a person turns right"
    known_subject(graph, has)  "he waves", "a robot waves"    ->  "a person waves"
    without_quantity(graph, q) "a man walks for two seconds"  ->  "a man walks"

The graph of a clip stays what the user wrote. These functions make the graphs that are encoded in its place: captions
in the third person, as training captions are, whose nodes keep their roles, weights and orders. All are pure, and raise
nothing but `InvalidGraphError`.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import replace
from itertools import pairwise
from typing import Final

from kinegraph.errors import InvalidGraphError
from kinegraph.graph import Action, Argument, SemanticGraph
from kinegraph.text import lexicon
from kinegraph.text.caption_tokens import is_request
from kinegraph.text.narration import SUBJECT, name_subject, subject_items, subject_of, verb_items
from kinegraph.text.pieces import CONNECTIVES, NEGATING, Item, Pieces, unique, write
from kinegraph.text.quantities import Quantity
from kinegraph.text.sequences import in_third_person, split_sequence

__all__ = [
    "in_third_person",
    "known_subject",
    "known_wording",
    "split_at_once",
    "split_negations",
    "split_sequence",
    "with_actions",
    "without_quantity",
]

# Negations

_UNSPOKEN: Final = frozenset(
    "not n't nt never no neither nor then first finally next second third also just even ever really anymore".split()
)
"""Arguments that a negated action loses when it is told as a sentence of its own."""
_KEEPING: Final = frozenset("keep keeps keeping kept hold holds holding leave leaves leaving".split())
_LOW: Final = frozenset("down lowered low".split())


def split_negations(graph: SemanticGraph) -> tuple[SemanticGraph | None, list[SemanticGraph]]:
    """Split a graph into what must happen and what must not.

    Returns:
        The graph without its negated actions and their words, None if nothing is left; and each negated action as a
        graph of its own that is not negated, with a plain caption: "a person waves the hands" for "without waving the
        hands", "a person raises the arms" for "keeping the arms down". The verb of "runs and stops waving" goes with
        the wave, as the run goes on; that of "runs and stops running" stays.

    Raises:
        InvalidGraphError: a caption becomes longer than allowed.
    """
    negated = [action for action in graph.actions if action.negated]
    if not negated:
        return graph, []
    pieces = Pieces(graph)
    removed = [*negated, *_ending_what_else(graph)]
    return _without_actions(pieces, removed), [_told_alone(pieces, action) for action in negated]


def _ending_what_else(graph: SemanticGraph) -> list[Action]:
    """Find the verbs that end something else than what the rest of the sentence does ("runs and | stops | waving")."""
    endings = [
        (action, following)
        for action, following in pairwise(graph.actions)
        if _base(action.text) in lexicon.ENDING and not action.negated and following.negated
    ]
    verbs = [action for action, _ in endings]
    goes_on = {_base(action.text) for action in graph.actions if not action.negated and action not in verbs}
    going = goes_on | lexicon.TRAVEL_ON
    return [action for action, ended in endings if goes_on and _base(ended.text) not in going]


def _base(word: str) -> str:
    """Return the base of a verb: "stop" for "stops" and "stopping"."""
    lower = word.lower()
    return lexicon.FINITE_VERBS.get(lower) or lexicon.PARTICIPLES.get(lower, lower)


def _without_actions(pieces: Pieces, removed: Sequence[Action]) -> SemanticGraph | None:
    """Remove actions with their words and what negates them; None if no action is left."""
    kept_actions = [action for action in pieces.graph.actions if action not in removed]
    heads = {index for action in kept_actions for index in pieces.of(action)}
    lost_heads = {index for action in removed for index in pieces.of(action)} - heads
    pruned = []
    for action in kept_actions:
        arguments = [
            argument
            for argument in action.arguments
            if lost_heads.isdisjoint(pieces.of(argument)) or not heads.isdisjoint(pieces.of(argument))
        ]
        pruned.append(replace(action, arguments=tuple(arguments)))
    around = [argument for action in kept_actions for argument in action.arguments]
    protected = heads | {
        index
        for action in pruned
        for argument in action.arguments
        if lost_heads.isdisjoint(pieces.of(argument))
        for index in pieces.of(argument)
    }
    lost = set(lost_heads)
    for node in [*(argument for action in removed for argument in action.arguments), *around]:
        covered = set(pieces.of(node))
        is_owned = node not in around or (not covered.isdisjoint(lost_heads) and covered.isdisjoint(heads))
        lost |= covered - protected if is_owned else set()
    _lose_negators(pieces, lost, lost_heads, protected)
    _lose_connectives(pieces, lost, heads)
    if not heads - lost:
        return None
    return write(pieces, pruned, pieces.items(index for index in range(len(pieces)) if index not in lost))


def _lose_negators(pieces: Pieces, lost: set[int], lost_heads: set[int], protected: set[int]) -> None:
    """Add the words that negate removed verbs to what is lost."""
    for head in lost_heads:
        index = head - 1
        while index >= 0 and (index in lost or (index not in protected and pieces.word(index) in NEGATING)):
            lost.add(index)
            index -= 1


def _lose_connectives(pieces: Pieces, lost: set[int], heads: set[int]) -> None:
    """Add the connectives that join nothing any more to what is lost."""
    index = 0
    while index < len(pieces):
        if index not in lost:
            index += 1
            continue
        first = index
        while index < len(pieces) and index in lost:
            index += 1
        left, right = _connectives(pieces, first - 1, -1, lost), _connectives(pieces, index, 1, lost)
        behind = index + len(right)
        ends = behind >= len(pieces) or not pieces.pieces[behind].is_word
        has_verb_before = any(head < first and head not in lost for head in heads)
        if left and (right or ends):
            lost.update(left)
        if right and (ends or not has_verb_before):
            lost.update(right)


def _connectives(pieces: Pieces, index: int, step: int, lost: set[int]) -> list[int]:
    """List the connectives from an index on, leftwards or rightwards."""
    found = []
    while 0 <= index < len(pieces) and index not in lost and pieces.word(index) in CONNECTIVES:
        found.append(index)
        index += step
    return found


def _told_alone(pieces: Pieces, action: Action) -> SemanticGraph:
    """Tell an action alone in the third person, and not negated."""
    heads = {index for other in pieces.graph.actions if other is not action for index in pieces.of(other)}
    subjects = [subject_of(pieces.graph, other) for other in (action, *pieces.graph.actions)]
    subject = next((subject for subject in subjects if subject is not None), None)
    is_kept = action.text.lower() in _KEEPING and any(
        pieces.word(index) in _LOW for argument in action.arguments for index in pieces.of(argument)
    )
    items = subject_items(pieces, subject)
    items += verb_items(pieces, action, "raises" if is_kept else None)
    arguments = []
    for argument in sorted(action.arguments, key=lambda argument: argument.start):
        own = [index for index in pieces.of(argument) if pieces.pieces[index].is_word]
        words = {pieces.word(index) for index in own}
        if argument == subject or not own or words <= _UNSPOKEN or (is_kept and words <= _LOW | {"the", "sides"}):
            continue
        if heads.isdisjoint(own) and not set(pieces.of(action)) & set(own):
            arguments.append(argument)
            items += pieces.items(pieces.of(argument))
    if subject is not None:
        arguments.append(subject)
    alone = replace(action, negated=False, arguments=tuple(sorted(arguments, key=lambda argument: argument.start)))
    told = write(pieces, [alone], unique(items))
    return name_subject(told) if subject is None else told


# At once


def split_at_once(graph: SemanticGraph) -> list[SemanticGraph]:
    """Tell each action of a graph as a sentence of its own: "walks while waving" -> "a person walks", "a person waves".

    Raises:
        InvalidGraphError: a caption becomes longer than allowed.
    """
    pieces = Pieces(graph)
    return [_ordered(_told_alone(pieces, action)) for action in graph.actions]


def with_actions(graph: SemanticGraph, kept: Collection[int]) -> SemanticGraph | None:
    """Leave out all actions but some, by their index in `graph.actions`, with their words; None if nothing is left."""
    removed = [action for index, action in enumerate(graph.actions) if index not in kept]
    left = _without_actions(Pieces(graph), removed)
    return None if left is None else _ordered(left)


def _ordered(graph: SemanticGraph) -> SemanticGraph:
    """Number the actions of a graph from 0 on, as those of a sentence of its own."""
    places = {order: place for place, order in enumerate(sorted({action.order for action in graph.actions}))}
    return replace(graph, actions=tuple(replace(action, order=places[action.order]) for action in graph.actions))


# Other words


def with_words(graph: SemanticGraph, words: Mapping[tuple[int, int], str]) -> SemanticGraph:
    """Put other words in the place of some, by their spans: (start, end) -> word.

    Raises:
        InvalidGraphError: the caption becomes longer than allowed.
    """
    pieces = Pieces(graph)
    replaced = {pieces.within(*span)[0]: word for span, word in words.items() if len(pieces.within(*span)) == 1}
    items = [Item(replaced.get(index, piece.text), index) for index, piece in enumerate(pieces.pieces)]
    return write(pieces, graph.actions, items)


def known_wording(graph: SemanticGraph) -> SemanticGraph:
    """Replace wording that no training caption has by what means exactly the same.

    Clockwise, seen from above, is a turn to the right: "turns clockwise" becomes "turns right", "walks in a clockwise
    circle" becomes "walks in a circle to the right". The words of `lexicon.WORDINGS` are written out.

    Raises:
        InvalidGraphError: the caption becomes longer than allowed.
    """
    pieces = Pieces(graph)
    replaced: dict[int, str] = {}
    for pattern, text in _WORDINGS:
        for match in pattern.finditer(graph.caption):
            covered = pieces.within(*match.span())
            if replaced.keys().isdisjoint(covered):
                replaced.update(dict.fromkeys(covered, ""))
                replaced.update(dict.fromkeys(covered[:1], text))
    items: list[Item] = []
    directions: list[int] = []  # positions of the items that are directions
    pending = ""
    for index, piece in enumerate(pieces.pieces):
        side = _SIDES.get(replaced.get(index, ""))
        if side is None:
            if replaced.get(index) != "":
                items.append(Item(replaced.get(index, piece.text), index))
            if pending and replaced.get(index, piece.text):
                directions.append(len(items))
                items.append(Item(f"to the {pending}"))
                pending = ""
            continue
        following = next((i for i in range(index + 1, len(pieces)) if replaced.get(i) != ""), len(pieces))
        if pieces.word(following) in _TURN_NOUNS:
            items.append(Item(side, index))
        elif pieces.word(following) in lexicon.CIRCLE_NOUNS | lexicon.EVENT_NOUNS - {"step"}:
            pending = side
            if items and items[-1].text.lower() == "an":
                items[-1] = replace(items[-1], text=items[-1].text[0])
        else:
            directions.append(len(items))
            items.append(Item(side if _is_turn(pieces.word(index - 1)) else f"to the {side}", index))
    return _write_directions(pieces, items, directions) if replaced else graph


_WORDINGS: Final = tuple((re.compile(pattern, re.IGNORECASE), text) for pattern, text in lexicon.WORDINGS)
_SIDES: Final = {lexicon.CLOCKWISE: "right", lexicon.COUNTERCLOCKWISE: "left"}
_TURN_NOUNS: Final = frozenset("turn turns rotation rotations spin spins pirouette pivot quarter half".split())
_TURN_VERBS: Final = frozenset("turn rotate spin pivot twirl swivel revolve whirl".split())


def _is_turn(word: str) -> bool:
    return _base(word) in _TURN_VERBS


def _write_directions(pieces: Pieces, items: Sequence[Item], directions: Sequence[int]) -> SemanticGraph:
    """Write a caption from items; those that are directions become arguments of direction."""
    graph = pieces.graph
    actions = []
    for action in graph.actions:
        arguments = []
        for argument in action.arguments:
            own = set(pieces.of(argument))
            is_direction = any(items[position].piece in own and len(own) <= 3 for position in directions)
            arguments.append(replace(argument, role="ARGM-DIR") if is_direction else argument)
        actions.append(replace(action, arguments=tuple(arguments)))
    written = write(pieces, actions, items)
    inserted = [position for position in directions if items[position].piece is None]
    for position in inserted:
        start = len(write(pieces, actions, items[:position]).caption) + 1
        written = _add_direction(written, start, start + len(items[position].text))
    return written


def _add_direction(graph: SemanticGraph, start: int, end: int) -> SemanticGraph:
    """Make words an argument of direction of the last action before them."""
    before = [index for index, action in enumerate(graph.actions) if action.end <= start]
    owner = max(before, key=lambda index: graph.actions[index].end, default=0)
    direction = Argument("ARGM-DIR", graph.caption[start:end], start, end)
    actions = list(graph.actions)
    actions[owner] = replace(actions[owner], arguments=(*actions[owner].arguments, direction))
    return SemanticGraph(graph.caption, tuple(actions))


def with_straight_quotes(graph: SemanticGraph) -> SemanticGraph:
    """Write the curly quotes of a graph as captions of training have them, straight; offsets hold."""
    if _CURLY.isdisjoint(graph.caption):
        return graph

    def straight(text: str) -> str:
        return text.translate(_STRAIGHTENED)

    actions = tuple(
        replace(
            action,
            text=straight(action.text),
            arguments=tuple(replace(node, text=straight(node.text)) for node in action.arguments),
        )
        for action in graph.actions
    )
    return SemanticGraph(straight(graph.caption), actions)


_CURLY: Final = frozenset(lexicon.STRAIGHT)
_STRAIGHTENED: Final = str.maketrans(dict(lexicon.STRAIGHT))


def without_request(graph: SemanticGraph) -> SemanticGraph:
    """Leave out words before all nodes that only ask for a motion: "make a clip of | a person walking".

    Raises:
        InvalidGraphError: see `pieces.write`.
    """
    starts = [node.start for action in graph.actions for node in action.arguments]
    first = min([*(action.start for action in graph.actions), *starts])
    if not first:
        return graph
    pieces = Pieces(graph)
    count = len(pieces.within(0, first))
    words = [f"{pieces.word(index)} " for index in range(len(pieces.pieces))]
    if not count or not is_request("".join(words[:count]), "".join(words[count:])):
        return graph
    return write(pieces, graph.actions, pieces.items(range(count, len(pieces.pieces))))


def known_subject(graph: SemanticGraph, is_shown: Callable[[str], bool]) -> SemanticGraph:
    """Call who moves a person where the caption has a pronoun for them, or a noun that training never had.

    What they do is met more often then: few captions of training have a pronoun, and a noun that none has sways the
    text encoder ("the gardener lifts a stone"). Adjectives stay: "a tired robot" becomes "a tired person". Only who is
    named first is renamed: "he walks where he stood" becomes "a person walks where he stood".

    Args:
        graph: in the third person.
        is_shown: tells whether a caption of training has a word, in lower case.

    Raises:
        InvalidGraphError: the caption becomes longer than allowed.
    """
    subjects = [subject for action in graph.actions if (subject := subject_of(graph, action)) is not None]
    if not subjects:
        return graph
    pieces = Pieces(graph)
    first = min(subjects, key=lambda subject: subject.start)
    own = [index for index in pieces.of(first) if pieces.pieces[index].is_word]
    words = [pieces.word(index) for index in own]
    replaced: dict[int, str] = {}
    if words in (["he"], ["she"], ["it"]):
        replaced = {own[0]: SUBJECT}
    elif len(words) > 1 and words[0] in _ARTICLES:
        for head in _heads(words):
            if not (is_shown(words[head]) or words[head].endswith("s")):  # "the guards" are no person
                replaced[own[head]] = _PERSON
                replaced |= {own[head - 1]: "a"} if words[head - 1] == "an" else {}
    if not replaced:
        return graph
    items = [Item(replaced.get(index, piece.text), index) for index, piece in enumerate(pieces.pieces)]
    return write(pieces, graph.actions, items)


def _heads(words: Sequence[str]) -> list[int]:
    """Find the nouns of who moves: "girl" of "a girl in a red dress", "orc" and "goblin" of "an orc and a goblin"."""
    heads = []
    begins = True  # a noun phrase, and what belongs to it has not begun
    for index, word in enumerate(words):
        following = words[index + 1] if index + 1 < len(words) else "and"
        if begins and (following == "and" or following in _BELONGING):
            heads.append(index)
            begins = False
        begins = begins or word == "and"
    return heads


_BELONGING: Final = (lexicon.DIRECTION_PREPOSITIONS | lexicon.PLACE_PREPOSITIONS | lexicon.MANNER_PREPOSITIONS) - {
    "front"
} | frozenset("for who which that whose wearing holding carrying named called".split())
"""Words that open what belongs to a noun before them."""
_ARTICLES: Final = frozenset("a an the".split())
_PERSON: Final = SUBJECT.split()[-1]


def without_quantity(graph: SemanticGraph, quantity: Quantity) -> SemanticGraph:
    """Remove the words of a length or a count.

    Raises:
        InvalidGraphError: the quantity is of another caption, or the words are those of an action ("three jumps").
    """
    if graph.caption[quantity.start : quantity.end] != quantity.text:
        raise InvalidGraphError(f"{quantity.text!r} is not at {quantity.start} in {graph.caption!r}")
    pieces = Pieces(graph)
    lost = set(pieces.within(quantity.start, quantity.end))
    for action in graph.actions:
        if not lost.isdisjoint(pieces.of(action)):
            raise InvalidGraphError(f"the action {action.text!r} is a part of {quantity.text!r}")
    while lost and pieces.word(max(lost) + 1) in ("-", "long"):  # "a five-second-long walk"
        lost.add(max(lost) + 1)
    _lose_connectives(pieces, lost, {index for action in graph.actions for index in pieces.of(action)})
    return write(pieces, graph.actions, pieces.items(i for i in range(len(pieces)) if i not in lost))
