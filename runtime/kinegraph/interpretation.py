"""Interpret a graph for the model: what is asked for when a sentence negates, orders, counts, or uses other words.

    split_sequence(graph)      "walk forward, then bow"       ->  "a person walks forward", "a person bows"
    split_negations(graph)     "a man walks without waving"   ->  "a man walks" and, negated, "a man waves"
    known_wording(graph)       "a person turns clockwise"     ->  "a person turns right"
    without_quantity(graph, q) "a man walks for two seconds"  ->  "a man walks"

The graph of a clip stays what the user wrote. These functions make the graphs that are encoded in its place: captions in
the third person, as training captions are, whose nodes keep their roles, weights and orders. All are pure, and raise
nothing but `InvalidGraphError`.

A caption is taken apart into pieces: words and signs, cut where nodes begin and end. A new caption is a list of pieces
in their new order, some with other words, some inserted; `_write` puts the nodes on it.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Final

from kinegraph.errors import InvalidGraphError
from kinegraph.graph import Action, Argument, SemanticGraph
from kinegraph.text import lexicon
from kinegraph.text.quantities import Quantity

SUBJECT: Final = "a person"
"""Who moves where a caption does not say it."""

Node = Action | Argument


# Captions in pieces


@dataclass(frozen=True)
class _Piece:
    """A word, a sign, or a part of a word that a node of its own covers ("n't")."""

    text: str
    start: int
    end: int
    """Characters of the caption, end exclusive."""
    glued: bool
    """True if no blank stands before it."""

    @property
    def word(self) -> str:
        """The text in lower case."""
        return self.text.lower()

    @property
    def is_word(self) -> bool:
        """Whether it holds a letter or a digit."""
        return any(char.isalnum() for char in self.text)


@dataclass(frozen=True)
class _Item:
    """A piece of a new caption: one of the old caption's, perhaps with other words, or an inserted one."""

    text: str
    piece: int | None = None
    """Index of the old piece; None for an inserted one."""


class _Pieces:
    """The pieces of a graph's caption, and which of them each node covers."""

    def __init__(self, graph: SemanticGraph) -> None:
        self.graph = graph
        cuts = {0, len(graph.caption), *(edge for node in graph.nodes for edge in (node.start, node.end))}
        for match in _WORD.finditer(graph.caption):
            cuts |= {match.start(), match.end()}
        bounds = sorted(cuts)
        self.pieces: list[_Piece] = []
        for start, end in zip(bounds, bounds[1:], strict=False):
            text = graph.caption[start:end]
            if text.strip():
                first = start + len(text) - len(text.lstrip())
                glued = first == start > 0 and not graph.caption[start - 1].isspace()
                self.pieces.append(_Piece(text.strip(), first, first + len(text.strip()), glued))

    def __len__(self) -> int:
        return len(self.pieces)

    def word(self, index: int) -> str:
        """Return a piece in lower case; empty outside of the caption."""
        return self.pieces[index].word if 0 <= index < len(self.pieces) else ""

    def of(self, node: Node) -> range:
        """Return the indices of a node's pieces."""
        return self.within(node.start, node.end)

    def within(self, start: int, end: int) -> range:
        """Return the indices of the pieces in some characters."""
        inside = [index for index, piece in enumerate(self.pieces) if start <= piece.start and piece.end <= end]
        return range(inside[0], inside[-1] + 1) if inside else range(0)

    def items(self, kept: Iterable[int]) -> list[_Item]:
        """Return the items of a caption of unchanged pieces."""
        return [_Item(self.pieces[index].text, index) for index in kept]


_WORD: Final = re.compile(r"\w+(?:['’‑-]\w+)*|[^\w\s]")
_CLOSING: Final = frozenset(", . ; : ! ? )".split())


def _write(pieces: _Pieces, actions: Sequence[Action], items: Sequence[_Item]) -> SemanticGraph:
    """Write a caption from items and put actions and their arguments on it; nodes without a word are left out."""
    caption = ""
    spans: list[tuple[int, int]] = []
    for position, item in enumerate(items):
        before = items[position - 1].piece if position else None
        is_glued = item.piece is not None and before == item.piece - 1 and pieces.pieces[item.piece].glued
        caption += "" if not caption or is_glued or item.text in _CLOSING else " "
        spans.append((len(caption), len(caption) + len(item.text)))
        caption += item.text
    placed = []
    for action in actions:
        span = _span_of(pieces, action, items, spans)
        if span is not None:
            arguments = [
                replace(argument, start=place[0], end=place[1], text=caption[slice(*place)])
                for argument in action.arguments
                for place in [_span_of(pieces, argument, items, spans)]
                if place is not None
            ]
            placed.append(
                replace(action, start=span[0], end=span[1], text=caption[slice(*span)], arguments=tuple(arguments))
            )
    return SemanticGraph(caption, tuple(placed))


def _span_of(
    pieces: _Pieces, node: Node, items: Sequence[_Item], spans: Sequence[tuple[int, int]]
) -> tuple[int, int] | None:
    """Find the longest run of a node's pieces in a new caption, without signs at its ends; None if there is none."""
    own = set(pieces.of(node))
    runs: list[list[int]] = [[]]
    for position, item in enumerate(items):
        if item.piece in own:
            runs[-1].append(position)
        elif runs[-1]:
            runs.append([])
    run = max(runs, key=len)
    solid = [position for position in run if any(char.isalnum() for char in items[position].text)]
    return (spans[solid[0]][0], spans[solid[-1]][1]) if solid else None


# Negations

_NEGATING: Final = frozenset(
    "without not n't nt never no neither nor instead of rather than do does did is are was were am be 's 're ca can wo"
    " will would could should don't doesn't didn't isn't aren't wasn't won't can't cannot couldn't shouldn't wouldn't dont"
    " doesnt didnt cant wont even ever any just really also simply while by being at all".split()
)
"""Words that are left out with a negated verb that they stand before."""
_CONNECTIVES: Final = frozenset("and but or then while nor yet , ; – — / & +".split())
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
        hands", "a person raises the arms" for "keeping the arms down".

    Raises:
        InvalidGraphError: a caption becomes longer than allowed.
    """
    negated = [action for action in graph.actions if action.negated]
    if not negated:
        return graph, []
    pieces = _Pieces(graph)
    return _without_actions(pieces, negated), [_told_alone(pieces, action) for action in negated]


def _without_actions(pieces: _Pieces, removed: Sequence[Action]) -> SemanticGraph | None:
    """Remove actions with their words and what negates them; None if no action is left."""
    kept_actions = [action for action in pieces.graph.actions if not action.negated]
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
    return _write(pieces, pruned, pieces.items(index for index in range(len(pieces)) if index not in lost))


def _lose_negators(pieces: _Pieces, lost: set[int], lost_heads: set[int], protected: set[int]) -> None:
    """Add the words that negate removed verbs to what is lost."""
    for head in lost_heads:
        index = head - 1
        while index >= 0 and (index in lost or (index not in protected and pieces.word(index) in _NEGATING)):
            lost.add(index)
            index -= 1


def _lose_connectives(pieces: _Pieces, lost: set[int], heads: set[int]) -> None:
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


def _connectives(pieces: _Pieces, index: int, step: int, lost: set[int]) -> list[int]:
    """List the connectives from an index on, leftwards or rightwards."""
    found = []
    while 0 <= index < len(pieces) and index not in lost and pieces.word(index) in _CONNECTIVES:
        found.append(index)
        index += step
    return found


def _told_alone(pieces: _Pieces, action: Action) -> SemanticGraph:
    """Tell an action alone in the third person, and not negated."""
    heads = {index for other in pieces.graph.actions if other is not action for index in pieces.of(other)}
    subjects = [_subject_of(pieces.graph, other) for other in (action, *pieces.graph.actions)]
    subject = next((subject for subject in subjects if subject is not None), None)
    is_kept = action.text.lower() in _KEEPING and any(
        pieces.word(index) in _LOW for argument in action.arguments for index in pieces.of(argument)
    )
    items = _subject_items(pieces, subject)
    items += _verb_items(pieces, action, "raises" if is_kept else None)
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
    return _write(pieces, [alone], _unique(items))


def _unique(items: Iterable[_Item]) -> list[_Item]:
    """Leave out items of pieces that came before: nodes may overlap."""
    seen: set[int] = set()
    unique = []
    for item in items:
        if item.piece is None or item.piece not in seen:
            unique.append(item)
        if item.piece is not None:
            seen.add(item.piece)
    return unique


# Subjects and verbs

_READERS: Final = frozenset("i me we us you your".split())
"""Words for who reads or writes a caption, not for who moves."""
_PLURALS: Final = frozenset("they them people men women children both all".split()) | frozenset(
    "two three four five six seven eight nine ten several many".split()
)
_OBJECT_FORMS: Final = {"him": "he", "her": "she", "them": "they"}
_BE: Final = frozenset("is are was were am be been being 's 're gets get got".split())


def _subject_of(graph: SemanticGraph, action: Action) -> Argument | None:
    """Find the argument that tells who moves: ARG0, or ARG1 before the verb or where it is who does something else."""
    candidates = [argument for argument in action.arguments if argument.role in ("ARG0", "ARG1")]
    candidates = [argument for argument in candidates if not _NO_SUBJECT.fullmatch(argument.text)]
    for argument in sorted(candidates, key=lambda argument: argument.role):
        is_shared = any(
            other.start == argument.start and other.end == argument.end and argument.end <= action_of_other.start
            for action_of_other in graph.actions
            for other in action_of_other.arguments
            if other.role in ("ARG0", "ARG1")
        )
        if argument.role == "ARG0" or argument.end <= action.start or is_shared:
            return argument
    return None


_NO_SUBJECT: Final = re.compile(r"who|which|that|by\b.*|to\b.*", re.IGNORECASE | re.DOTALL)


def _subject_items(pieces: _Pieces, subject: Argument | None) -> list[_Item]:
    """Return the items of who moves; "a person" if nobody is named, or the reader."""
    if subject is None:
        return [_Item(SUBJECT)]
    own = list(pieces.of(subject))
    words = {pieces.word(index) for index in own}
    if not own or words & _READERS:
        # the node stays on the words that stand for the reader
        return [_Item(SUBJECT, own[0])] if own else [_Item(SUBJECT)]
    if len(own) == 1:
        return [_Item(_OBJECT_FORMS.get(pieces.word(own[0]), pieces.pieces[own[0]].text), own[0])]
    return pieces.items(own)


def _verb_items(pieces: _Pieces, action: Action, text: str | None = None) -> list[_Item]:
    """Return the items of a verb in the third person singular; in the passive voice, with "is" before it."""
    own = list(pieces.of(action))
    if not own:
        raise InvalidGraphError(f"the action {action.text!r} has no word")
    if text is None and _is_passive(pieces, own[0]):
        return [_Item("is"), *pieces.items(own)]
    return [_Item(text or third_person(pieces.pieces[own[0]].text), own[0]), *pieces.items(own[1:])]


def _is_passive(pieces: _Pieces, verb: int) -> bool:
    """Tell whether a verb is a past participle behind a form of "be", with negators and adverbs between."""
    word = pieces.word(verb)
    if not (word.endswith("ed") or word in lexicon.PAST_PARTICIPLES):
        return False
    before = verb - 1
    while before >= 0 and (pieces.word(before) in _NEGATING - _BE or pieces.word(before).endswith("ly")):
        before -= 1
    return pieces.word(before) in _BE | {"isn't", "aren't", "wasn't"}


_NO_VERBS: Final = (
    lexicon.DIRECTION_ADVERBS | lexicon.PLACE_PREPOSITIONS | lexicon.DIRECTION_PREPOSITIONS | lexicon.MANNER_PREPOSITIONS
)


def third_person(verb: str) -> str:
    """Put a verb in any form into the third person singular of the present; other words stay as they are."""
    word = verb.lower()
    if word in _NO_VERBS or not word.isalpha():
        return verb
    if word in lexicon.IRREGULAR_FORMS:
        return lexicon.third_person(lexicon.IRREGULAR_FORMS[word])
    if word in lexicon.FINITE_VERBS or word in ("is", "has", "does"):
        return word
    if word in lexicon.VERBS:
        return lexicon.third_person(word)
    base = lexicon.PARTICIPLES.get(word) or _regular_base(word)
    return lexicon.third_person(base) if base else (word if word.endswith("s") else lexicon.third_person(word))


def _regular_base(word: str) -> str | None:
    """Guess the base form of a regular participle or past form; a verb of the lexicon if there is one."""
    for ending in ("ing", "ed"):
        stem = word.removesuffix(ending)
        if stem == word or len(stem) < 2:
            continue
        is_doubled = len(stem) > 2 and stem[-1] == stem[-2]
        guesses = [stem, stem + "e", stem[:-1] if is_doubled else stem, stem[:-1] + "y" if stem[-1] == "i" else stem]
        known = next((guess for guess in guesses if guess in lexicon.VERBS), None)
        if known is None:
            needs_e = stem[-1] in "cvzu" or (stem[-1] == "l" and stem[-2] not in "aeioul") or stem.endswith(("at", "dg"))
            known = stem + "e" if needs_e else (stem[:-1] if is_doubled and stem[-1] not in "ls" else stem)
        return known
    return None


# Sequences

_SEQUENCE_WORDS: Final = frozenset(
    "then next afterwards afterward finally lastly first firstly second secondly third thirdly fourth fifth later"
    " subsequently thereafter".split()
)
_STOPS: Final = frozenset(". ; ! ? | → ->".split())
_SIGNS: Final = _STOPS | frozenset(", : ( ) [ ] - – — • * · / &".split())
_AFTER: Final = frozenset("after once having".split())
_BEFORE: Final = frozenset(("before",))
_AT_ONCE: Final = frozenset("while when as with by whilst meanwhile simultaneously to without where who which that".split())
_DESCRIBING: Final = frozenset(
    "is are was looks look looking seems seem appears appear suggests suggest has stands feels feel shows remains".split()
)
"""Verbs of sentences that describe the motion of the sentence before ("they look angry")."""
_BEHAVING: Final = frozenset("move moves moving act acts acting behave behaves".split())
_DESCRIBED: Final = frozenset(
    "movement movements mood style attitude language motion manner expression nothing it pace gait posture action".split()
)
"""Subjects of such sentences."""


def split_sequence(graph: SemanticGraph) -> list[SemanticGraph]:
    """Split a graph into the parts that follow one another, in the order in which they happen.

    "then", "after that", steps, sentences, lists with commas, "before ..." and "after ..." part; "and" alone, "while"
    and "with" do not. Each part has a caption of its own in the third person that names who moves: "a person" if the
    caption is an order or a title.

    Returns:
        One graph for each part; the graph itself if it is one part and already told so.

    Raises:
        InvalidGraphError: a caption becomes longer than allowed.
    """
    pieces = _Pieces(graph)
    groups = _group_actions(pieces)
    if len(groups) == 1 and _is_told(pieces, groups[0][0]):
        return [graph]
    return [_part(pieces, group, groups) for group in groups]


def _is_told(pieces: _Pieces, action: Action) -> bool:
    """Tell whether an action needs no other form: it has a subject, it is a noun of a title, or it is no verb."""
    subject = _subject_of(pieces.graph, action)
    if subject is not None:
        return not {pieces.word(index) for index in pieces.of(subject)} & _READERS
    return _is_noun(pieces, action) or third_person(action.text) == action.text.lower() not in lexicon.FINITE_VERBS


def _is_noun(pieces: _Pieces, action: Action) -> bool:
    """Tell whether an action without a subject is a noun: an article, a number or an adjective stands before it."""
    own = pieces.of(action)
    before = pieces.word(own[0] - 1) if own else ""
    if before in _ARTICLES or before in lexicon.NOUN_ADJECTIVES or before.isdecimal():
        return True
    modifiers = [pieces.of(argument) for argument in action.arguments if argument.end <= action.start]
    if not own or not any(own[0] - 1 in modifier for modifier in modifiers):
        return False
    is_measure = any(own[0] - 1 in modifier and len(modifier) > 1 for modifier in modifiers)
    return is_measure or not (before.endswith("ly") or before in _SEQUENCE_WORDS | _NEGATING)


_ARTICLES: Final = frozenset("a an the another his her their".split())


def _group_actions(pieces: _Pieces) -> list[list[Action]]:
    """Group the actions that happen at once; groups are in the order in which they happen."""
    actions = sorted(pieces.graph.actions, key=lambda action: (action.start, action.end))
    groups: list[list[Action]] = []
    waiting: list[tuple[Action, Action, bool]] = []  # action, the one whose clause it stands in, happens before it
    is_list = False
    for position, action in enumerate(actions):
        owner, marker = _owner_of(pieces, actions, action)
        if owner is not None and owner is not action and marker is not None:
            waiting.append((action, owner, marker))
            continue
        if owner is not None and owner.start > action.start:
            waiting.append((action, owner, False))
            continue
        group = next((group for group in groups if owner in group), None)
        if group is None and groups and position:
            junction = _junction(pieces, actions[position - 1], action)
            parts, is_list = _is_parted(pieces, groups[-1][0], action, junction, is_list)
            group = None if parts else groups[-1]
        if group is None:
            groups.append([action])
        else:
            group.append(action)
    for action, owner, happens_before in waiting:
        index = next((number for number, group in enumerate(groups) if owner in group), len(groups) - 1)
        marked = _owner_of(pieces, actions, action)[1]
        if marked is None and groups:
            groups[index].append(action)
        else:
            groups.insert(max(index, 0) if happens_before else index + 1, [action])
    return [sorted(group, key=lambda action: action.start) for group in groups]


def _owner_of(pieces: _Pieces, actions: Sequence[Action], action: Action) -> tuple[Action | None, bool | None]:
    """Find the action in one of whose arguments another stands, and whether that tells an order.

    Returns:
        The action; True if the other happens before it ("after turning"), False if behind it ("before bowing"), None if
        the two happen at once.
    """
    head = set(pieces.of(action))
    best: tuple[int, Action, bool | None] | None = None
    for other in actions:
        for argument in other.arguments:
            own = pieces.of(argument)
            if other is action or not head <= set(own) or head & set(pieces.of(other)):
                continue
            first = pieces.word(own[0])
            marker = True if first in _AFTER else (False if first in _BEFORE else None)
            if best is None or len(own) < best[0]:
                best = len(own), other, marker
    return (best[1], best[2]) if best else (None, None)


def _junction(pieces: _Pieces, before: Action, action: Action) -> list[str]:
    """List the words between two actions that belong to no argument, and those that tell a sequence."""
    first, last = max(pieces.of(before), default=0) + 1, min(pieces.of(action), default=0)
    covered = {
        index
        for other in pieces.graph.actions
        for argument in other.arguments
        for index in pieces.of(argument)
        if not {pieces.word(index) for index in pieces.of(argument)} <= _SEQUENCE_WORDS
    }
    words = [pieces.word(index) for index in range(first, last) if index not in covered]
    gaps = [pieces.graph.caption[pieces.pieces[i].end : pieces.pieces[i + 1].start] for i in range(first - 1, last)]
    return [*words, *("\n" for gap in gaps if "\n" in gap or "\r" in gap)]


def _is_parted(
    pieces: _Pieces, before: Action, action: Action, junction: Sequence[str], is_list: bool
) -> tuple[bool, bool]:
    """Tell whether an action follows the one before it, and whether the two are items of a list."""
    words = set(junction)
    if words & _AT_ONCE and not words & _STOPS:
        return False, False
    if words & _SEQUENCE_WORDS or any(word.isdecimal() for word in junction) or {"after", "that"} <= words:
        return True, False
    if words & (_STOPS | {"\n", ":"}) or (")" in words and "(" not in words):
        return not _is_description(pieces, action), False
    same_form = _form(before.text) == _form(action.text) != "participle"
    if not words or "," in words or "/" in words:
        return same_form, same_form
    return is_list and "and" in words and same_form, is_list and same_form


def _is_description(pieces: _Pieces, action: Action) -> bool:
    """Tell whether a sentence describes the motion of the one before."""
    subject = _subject_of(pieces.graph, action)
    is_described = subject is not None and not _DESCRIBED.isdisjoint(subject.text.lower().split())
    roles = {argument.role for argument in action.arguments}
    is_look = action.text.lower() in _DESCRIBING and "ARGM-DIR" not in roles
    is_way = action.text.lower() in _BEHAVING and "ARGM-MNR" in roles and "ARGM-DIR" not in roles
    is_they = subject is not None and subject.text.lower() in ("they", "he", "she", "it")
    return is_described or is_look or (is_way and is_they)


def _form(verb: str) -> str:
    word = verb.lower()
    if word in lexicon.PARTICIPLES or word.endswith("ing"):
        return "participle"
    if word in lexicon.VERBS:
        return "base"
    if word.endswith("ed") or word in lexicon.IRREGULAR_FORMS or word in lexicon.PAST_PARTICIPLES:
        return "past"
    return "third" if word in lexicon.FINITE_VERBS or word.endswith("s") else "base"


def _part(pieces: _Pieces, group: Sequence[Action], groups: Sequence[Sequence[Action]]) -> SemanticGraph:
    """Write the graph of one part: its own words, who moves first, and its verbs in the third person."""
    foreign = {index for other in groups if other is not group for action in other for index in pieces.of(action)}
    actions = [_own_action(pieces, action, foreign) for action in group]
    kept = _own_words(pieces, actions, _other_words(pieces, group, groups), foreign)
    items, shown = _leading_subject(pieces, actions, foreign)
    rest = _trim([index for index in kept if index not in shown], pieces)
    told = _verbs_to_tell(pieces, actions)
    has_auxiliary = any(pieces.word(index) in ("do", "don't", "dont") for index in rest)
    for number, index in enumerate(rest):
        text = pieces.pieces[index].text
        if index in told and not has_auxiliary:
            text = third_person(text)
        elif number < 2 and text.lower() in _AUXILIARIES:
            text = _AUXILIARIES[text.lower()]
        elif text.lower() in ("your", "my", "our"):
            text = "the"  # as training captions say it
        items.append(_Item(text, index))
    return _write(pieces, actions, items)


_AUXILIARIES: Final = {"do": "does", "don't": "doesn't", "dont": "doesn't", "being": "is"}


def _own_action(pieces: _Pieces, action: Action, foreign: set[int]) -> Action:
    """Return an action with the arguments that stay in its part: those without a word of other parts' actions."""
    arguments = []
    for argument in action.arguments:
        own = pieces.of(argument)
        if foreign.isdisjoint(own) and not {pieces.word(index) for index in own} <= _SEQUENCE_WORDS:
            arguments.append(argument)
    return replace(action, arguments=tuple(arguments))


def _other_words(pieces: _Pieces, group: Sequence[Action], groups: Sequence[Sequence[Action]]) -> set[int]:
    """Find the words of the other parts."""
    words = set()
    for other in groups:
        if other is not group:
            foreign = {index for part in groups if part is not other for a in part for index in pieces.of(a)}
            for action in other:
                own = _own_action(pieces, action, foreign)
                words |= {index for node in (own, *own.arguments) for index in pieces.of(node)}
    return words


def _leading_subject(
    pieces: _Pieces, actions: Sequence[Action], foreign: set[int]
) -> tuple[list[_Item], set[int | None]]:
    """Choose who a part begins with, and the pieces that this stands for; nothing if the part names it in its place."""
    first = actions[0]
    subject = _subject_of(pieces.graph, first)
    if subject is None:
        if _is_noun(pieces, first) or _is_state(pieces, first):
            return [], set()
        subject = next((s for s in (_subject_of(pieces.graph, other) for other in actions[1:]) if s is not None), None)
        subject = subject or _nearest_subject(pieces.graph, first)
    if subject is not None:
        own = set(pieces.of(subject))
        verbs = [pieces.of(action)[0] for action in actions if len(pieces.of(action)) and subject in action.arguments]
        behind = [verb for verb in verbs if own and verb > max(own)]
        is_read = any(pieces.word(index) in _READERS for index in own)
        if behind and not is_read and foreign.isdisjoint(range(max(own), behind[0])) and len(own) > 1:
            return [], set()
    items = _subject_items(pieces, subject)
    return items, {item.piece for item in items} | (set(pieces.of(subject)) if subject is not None else set())


def _nearest_subject(graph: SemanticGraph, action: Action) -> Argument | None:
    """Find who does something else, nearest before an action without a subject, else behind."""
    others = sorted(graph.actions, key=lambda other: (other.start > action.start, abs(other.start - action.start)))
    return next((s for s in (_subject_of(graph, other) for other in others) if s is not None), None)


def _own_words(pieces: _Pieces, actions: Sequence[Action], others: set[int], foreign: set[int]) -> list[int]:
    """List the words of a part: those of its nodes, those of none between them, auxiliaries and particles."""
    owned = {index for action in actions for node in (action, *action.arguments) for index in pieces.of(node)}
    for action in actions:
        behind = pieces.of(action)[-1] + 1 if len(pieces.of(action)) else 0
        if behind not in others | foreign and pieces.word(behind) in lexicon.DIRECTION_ADVERBS:
            owned.add(behind)  # "stands | up"
    found = set(owned)
    ordered = sorted(owned)
    for first, last in zip([-1, *ordered], ordered, strict=False):
        gap = range(first + 1, last)
        if first >= 0 and (others - owned).isdisjoint(gap) and foreign.isdisjoint(gap):
            found.update(index for index in gap if pieces.word(index) not in _SEQUENCE_WORDS)
            continue
        for index in reversed(gap):
            word = pieces.word(index)
            if index in others or index in foreign or word not in _LEADING | _SEQUENCE_WORDS | {",", "."}:
                break
            if word not in _SEQUENCE_WORDS:
                found.add(index)
    return sorted(found)


_LEADING: Final = _NEGATING | frozenset("to as if because so like been being having while when".split())
"""Words of no node that belong to the words behind them."""


def _trim(kept: list[int], pieces: _Pieces) -> list[int]:
    """Leave out connectives and signs at the ends, and signs that meet another."""
    dropped = _CONNECTIVES | _SIGNS | _SEQUENCE_WORDS | _AFTER | _BEFORE | {"that"}
    while kept and pieces.word(kept[0]) in dropped:
        kept = kept[1:]
    while kept and pieces.word(kept[-1]) in _CONNECTIVES | _SIGNS:
        kept = kept[:-1]
    return [
        index
        for number, index in enumerate(kept)
        if pieces.word(index) not in _SIGNS or (number and pieces.word(kept[number - 1]) not in _SIGNS)
    ]


def _verbs_to_tell(pieces: _Pieces, actions: Sequence[Action]) -> set[int]:
    """Find the verbs of a part that are to be put into the third person: the first, and those coordinated with it."""
    told: set[int] = set()
    previous: int | None = None
    for number, action in enumerate(actions):
        own = pieces.of(action)
        if not own:
            continue
        before = _word_before(pieces, own[0])
        is_finite = _form(action.text) in ("third", "past") or _is_state(pieces, action)
        if not (is_finite or before in _BE or before in _NEGATING - {"never"} or before in ("to", "of", "than", "as")):
            if previous is None and number == 0:
                is_told = _is_main(pieces, actions)
            else:
                connective = before in ("and", "or", "&", "+", "then", "but")
                is_listed = _form(action.text) == "base" and (before in (",", "/", ";") or own[0] - 1 == previous)
                same_form = number > 0 and _form(action.text) == _form(actions[number - 1].text)
                is_told = previous in told and (connective or is_listed) and same_form
            if is_told:
                told.add(own[0])
        previous = own[-1]
    return told


def _word_before(pieces: _Pieces, index: int) -> str:
    """Return the word before a verb, adverbs and "then" left out."""
    before = index - 1
    while pieces.word(before).endswith("ly") or pieces.word(before) in _SEQUENCE_WORDS:
        before -= 1
    return pieces.word(before)


def _is_main(pieces: _Pieces, actions: Sequence[Action]) -> bool:
    """Tell whether the first verb of a part is its main verb, and needs another form."""
    first = actions[0]
    subject = _subject_of(pieces.graph, first)
    if subject is None:
        return not _is_noun(pieces, first)
    if _form(first.text) == "participle":
        # "moving slowly, a man walks": the main verb comes behind who moves
        return not any(
            first.start < subject.start < other.start and subject in other.arguments for other in actions[1:]
        )
    return _is_singular(pieces, subject)


def _is_state(pieces: _Pieces, action: Action) -> bool:
    """Tell whether an action is the word that would follow "is" ("left hand up", "mouth open")."""
    subject, word = _subject_of(pieces.graph, action), action.text.lower()
    is_held = subject is not None and subject.role == "ARG1" and word in lexicon.POSTURES
    return is_held or (word in _NO_VERBS and word not in lexicon.VERBS)


def _is_singular(pieces: _Pieces, subject: Argument) -> bool:
    """Tell whether who moves is one person or part of the body."""
    words = [pieces.word(index) for index in pieces.of(subject)]
    return not (_PLURALS & set(words) or "and" in words or (words and words[-1] in lexicon.BODY_PLURALS))


# Other words


def known_wording(graph: SemanticGraph) -> SemanticGraph:
    """Replace wording that no training caption has by what means exactly the same.

    Clockwise, seen from above, is a turn to the right: "turns clockwise" becomes "turns right", "walks in a clockwise
    circle" becomes "walks in a circle to the right". The words of `lexicon.WORDINGS` are written out.

    Raises:
        InvalidGraphError: the caption becomes longer than allowed.
    """
    pieces = _Pieces(graph)
    replaced: dict[int, str] = {}
    for pattern, text in _WORDINGS:
        for match in pattern.finditer(graph.caption):
            covered = pieces.within(*match.span())
            if replaced.keys().isdisjoint(covered):
                replaced.update(dict.fromkeys(covered, ""))
                replaced.update({index: text for index in covered[:1]})
    items: list[_Item] = []
    directions: list[int] = []  # positions of the items that are directions
    pending = ""
    for index, piece in enumerate(pieces.pieces):
        side = _SIDES.get(replaced.get(index, ""))
        if side is None:
            if replaced.get(index) != "":
                items.append(_Item(replaced.get(index, piece.text), index))
            if pending and replaced.get(index, piece.text):
                directions.append(len(items))
                items.append(_Item(f"to the {pending}"))
                pending = ""
            continue
        following = next((i for i in range(index + 1, len(pieces)) if replaced.get(i) != ""), len(pieces))
        if pieces.word(following) in _TURN_NOUNS:
            items.append(_Item(side, index))
        elif pieces.word(following) in lexicon.CIRCLE_NOUNS | lexicon.EVENT_NOUNS - {"step"}:
            pending = side
            if items and items[-1].text.lower() == "an":
                items[-1] = replace(items[-1], text=items[-1].text[0])
        else:
            directions.append(len(items))
            items.append(_Item(side if _is_turn(pieces.word(index - 1)) else f"to the {side}", index))
    return _write_directions(pieces, items, directions) if replaced else graph


_WORDINGS: Final = tuple((re.compile(pattern, re.IGNORECASE), text) for pattern, text in lexicon.WORDINGS)
_SIDES: Final = {lexicon.CLOCKWISE: "right", lexicon.COUNTERCLOCKWISE: "left"}
_TURN_NOUNS: Final = frozenset("turn turns rotation rotations spin spins pirouette pivot quarter half".split())
_TURN_VERBS: Final = frozenset("turn rotate spin pivot twirl swivel revolve whirl".split())


def _is_turn(word: str) -> bool:
    return (lexicon.FINITE_VERBS.get(word) or lexicon.PARTICIPLES.get(word, word)) in _TURN_VERBS


def _write_directions(pieces: _Pieces, items: Sequence[_Item], directions: Sequence[int]) -> SemanticGraph:
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
    written = _write(pieces, actions, items)
    inserted = [position for position in directions if items[position].piece is None]
    for position in inserted:
        start = len(_write(pieces, actions, items[:position]).caption) + 1
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


def without_quantity(graph: SemanticGraph, quantity: Quantity) -> SemanticGraph:
    """Remove the words of a length or a count.

    Raises:
        InvalidGraphError: the quantity is of another caption, or the words are those of an action ("three jumps").
    """
    if graph.caption[quantity.start : quantity.end] != quantity.text:
        raise InvalidGraphError(f"{quantity.text!r} is not at {quantity.start} in {graph.caption!r}")
    pieces = _Pieces(graph)
    lost = set(pieces.within(quantity.start, quantity.end))
    for action in graph.actions:
        if not lost.isdisjoint(pieces.of(action)):
            raise InvalidGraphError(f"the action {action.text!r} is a part of {quantity.text!r}")
    while lost and pieces.word(max(lost) + 1) in ("-", "long"):  # "a five-second-long walk"
        lost.add(max(lost) + 1)
    _lose_connectives(pieces, lost, {index for action in graph.actions for index in pieces.of(action)})
    return _write(pieces, graph.actions, pieces.items(i for i in range(len(pieces)) if i not in lost))

