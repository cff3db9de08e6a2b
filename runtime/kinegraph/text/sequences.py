"""Sequences: which actions of a graph follow one another, and each part as a graph of its own in the third person."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Final

from kinegraph.graph import Action, Argument, SemanticGraph
from kinegraph.text import lexicon
from kinegraph.text.narration import (
    BE,
    OBJECT_FORMS,
    OWNERS,
    READERS,
    SUBJECT,
    form,
    is_noun,
    is_reader,
    is_singular,
    is_state,
    name_subject,
    repeat_verbs,
    subject_items,
    subject_of,
    third_person,
    word_before,
)
from kinegraph.text.pieces import (
    AFTER_THAT,
    CONNECTIVES,
    NEGATING,
    RELATIVE,
    SEQUENCE_WORDS,
    SIGNS,
    STOPS,
    Item,
    Pieces,
    write,
)

_AFTER: Final = frozenset("after once having".split())
"""Words that open a clause of what happens before."""
_BEFORE: Final = frozenset(("before",))
"""Words that open a clause of what happens behind."""
_AT_ONCE: Final = frozenset(
    "while when as with by whilst meanwhile simultaneously to without where who which that".split()
)
_DESCRIBING: Final = frozenset(
    "is are was looks look looking seems seem appears appear suggests suggest has stands feels feel shows"
    " remains".split()
)
"""Verbs of sentences that describe the motion of the sentence before ("they look angry")."""
_BEHAVING: Final = frozenset("move moves moving act acts acting behave behaves".split())
_DESCRIBED: Final = frozenset(
    "movement movements mood style attitude language motion manner expression nothing it pace gait posture"
    " action".split()
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
    pieces = Pieces(repeat_verbs(graph))
    groups = _group_actions(pieces)
    if len(groups) == 1 and _is_told(pieces, groups[0][0]):
        return [graph]
    return [_part(pieces, group, groups) for group in groups]


def in_third_person(graph: SemanticGraph) -> SemanticGraph:
    """Tell an order, a title or steps as one sentence: "a person walks forward, then bows".

    Returns:
        A graph with a subject, whose parts are joined by "then"; the graph itself if it is told so already.

    Raises:
        InvalidGraphError: the caption becomes longer than allowed.
    """
    pieces = Pieces(graph)
    if all(_is_told(pieces, group[0]) for group in _group_actions(pieces)):
        return graph
    parts = split_sequence(graph)
    sentence = parts[0]
    for part in parts[1:]:
        sentence = _join(sentence, part)
    return sentence


def _join(sentence: SemanticGraph, part: SemanticGraph) -> SemanticGraph:
    """Append a part to a sentence, without who moves if the sentence begins with the same."""
    named = subject_of(sentence, sentence.actions[0])
    subject = SUBJECT if named is None or named.start else named.text
    shares = sentence.caption.startswith(f"{subject} ") and part.caption.startswith(f"{subject} ")
    cut = len(subject) + 1 if shares else 0
    start = f"{sentence.caption.rstrip('.,;! ')}, then "
    shift = len(start) - cut

    def moved(argument: Argument) -> Argument:
        offset = 0 if argument.end < cut else shift  # who moves stands at the start of both
        return replace(argument, start=argument.start + offset, end=argument.end + offset)

    actions = [
        replace(
            action,
            start=action.start + shift,
            end=action.end + shift,
            arguments=tuple(
                moved(argument) for argument in action.arguments if argument.end < cut or argument.start >= cut
            ),
        )
        for action in part.actions
    ]
    return SemanticGraph(start + part.caption[cut:], (*sentence.actions, *actions))


def _is_told(pieces: Pieces, action: Action) -> bool:
    """Tell whether an action needs no other form: it has a subject, it is a noun of a title, or it is no verb."""
    subject = subject_of(pieces.graph, action)
    if subject is not None:
        own = pieces.of(action)
        is_base = action.text.lower() in lexicon.VERBS and is_singular(pieces, subject)
        is_led = bool(own) and word_before(pieces, own[0]) in _NO_FORM_BEHIND
        return (is_led or not is_base or is_state(pieces, action)) and not {
            pieces.word(index) for index in pieces.of(subject)
        } & READERS
    return is_noun(pieces, action) or third_person(action.text) == action.text.lower() not in lexicon.FINITE_VERBS


def _group_actions(pieces: Pieces) -> list[list[Action]]:
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


def _owner_of(pieces: Pieces, actions: Sequence[Action], action: Action) -> tuple[Action | None, bool | None]:
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
            if other is action or not head or not head <= set(own) or head & set(pieces.of(other)):
                continue
            first = pieces.word(own[0])
            marker = True if first in _AFTER else (False if first in _BEFORE else None)
            if best is None or len(own) < best[0]:
                best = len(own), other, marker
    return (best[1], best[2]) if best else (None, None)


def _junction(pieces: Pieces, before: Action, action: Action) -> list[str]:
    """List the words between two actions that belong to no argument, and those that tell a sequence."""
    first, last = max(pieces.of(before), default=0) + 1, min(pieces.of(action), default=0)
    covered = {
        index
        for other in pieces.graph.actions
        for argument in other.arguments
        for index in pieces.of(argument)
        if not _orders(pieces, argument)
    }
    words = [pieces.word(index) for index in range(first, last) if index not in covered]
    gaps = [pieces.graph.caption[pieces.pieces[i].end : pieces.pieces[i + 1].start] for i in range(first - 1, last)]
    return [*words, *("\n" for gap in gaps if "\n" in gap or "\r" in gap)]


def _is_parted(
    pieces: Pieces, before: Action, action: Action, junction: Sequence[str], is_list: bool
) -> tuple[bool, bool]:
    """Tell whether an action follows the one before it, and whether the two are items of a list."""
    words = set(junction)
    is_after_that = any(phrase <= words for phrase in AFTER_THAT)
    if is_after_that or words & SEQUENCE_WORDS or any(word.isdecimal() for word in junction):
        return True, False
    own = pieces.of(action)
    relatives = [word_before(pieces, node[0]) in RELATIVE for node in (own, pieces.of(before)) if len(node)]
    if any(relatives) or (action.negated and not words) or (words & _AT_ONCE and not words & STOPS):
        return False, False
    if words & (STOPS | {"\n", ":"}) or (")" in words and "(" not in words):
        return not _is_description(pieces, action), False
    same_form = form(before.text) == form(action.text) != "participle"
    if not words or "," in words or "/" in words:
        return same_form, same_form
    return is_list and "and" in words and same_form, is_list and same_form


def _is_description(pieces: Pieces, action: Action) -> bool:
    """Tell whether a sentence describes the motion of the one before."""
    subject = subject_of(pieces.graph, action)
    is_described = subject is not None and not _DESCRIBED.isdisjoint(subject.text.lower().split())
    roles = {argument.role for argument in action.arguments}
    is_look = action.text.lower() in _DESCRIBING and "ARGM-DIR" not in roles
    is_way = action.text.lower() in _BEHAVING and "ARGM-MNR" in roles and "ARGM-DIR" not in roles
    is_they = subject is not None and subject.text.lower() in ("they", "he", "she", "it")
    return is_described or is_look or (is_way and is_they)


def _part(pieces: Pieces, group: Sequence[Action], groups: Sequence[Sequence[Action]]) -> SemanticGraph:
    """Write the graph of one part: its own words, who moves first, and its verbs in the third person."""
    foreign = {index for other in groups if other is not group for action in other for index in pieces.of(action)}
    actions = [_own_action(pieces, action, foreign) for action in group]
    kept = _own_words(pieces, actions, _other_words(pieces, group, groups), foreign)
    items, shown = _leading_subject(pieces, actions, foreign)
    rest = _trim([index for index in kept if index not in shown], pieces)
    told = _verbs_to_tell(pieces, actions)
    meant = _antecedents(pieces, group)
    readers = {index for action in actions for index in _reader_words(pieces, action)}
    for index in rest:
        text = pieces.pieces[index].text
        if index in meant:
            text = meant[index]
        elif index in told:
            text = third_person(text)
        elif index in readers:
            text = "they"
        elif index == rest[0] and items[:1] and items[0].text == SUBJECT and text.lower() in _PERSONS_OF_BE:
            items.append(Item(_PERSONS_OF_BE[text.lower()]))
            continue
        elif text.lower() in ("don't", "dont") or pieces.word(index + 1) in ("not", "n't", "nt"):
            text = _AUXILIARIES.get(text.lower(), text)
        else:
            text = _TOLD_WORDS.get(text.lower(), text)
        items.append(Item(text, index))
    part = write(pieces, actions, items)
    return name_subject(part) if items[:1] == [Item(SUBJECT)] else part


def _antecedents(pieces: Pieces, group: Sequence[Action]) -> dict[int, str]:
    """Find what "it" and "them" mean in a part that does not say it: "raise the hand, then lower | it"."""
    meant: dict[int, str] = {}
    for action in group:
        for argument in action.arguments:
            own = pieces.of(argument)
            if argument.role != "ARG1" or len(own) != 1 or pieces.word(own[0]) not in ("it", "them"):
                continue
            objects = [
                node
                for other in pieces.graph.actions
                for node in other.arguments
                if node.role == "ARG1" and other.end <= node.start < argument.start and other not in group
            ]
            if objects:
                words = pieces.of(max(objects, key=lambda node: node.start))
                meant[own[0]] = " ".join(OWNERS.get(pieces.word(index), pieces.pieces[index].text) for index in words)
    return meant


_PERSONS_OF_BE: Final = {
    "are": "is", "am": "is", "'re": "is", "'m": "is", "were": "was", "have": "has", "'ve": "has",
}  # fmt: skip
"""Auxiliaries behind who reads, for a person."""
_AUXILIARIES: Final = {"do": "does", "don't": "doesn't", "dont": "doesn't"}


def _reader_words(pieces: Pieces, action: Action) -> list[int]:
    """Find the words for the reader who is the subject of an action ("until | you | reach the wall")."""
    subject = subject_of(pieces.graph, action)
    own = pieces.of(subject) if subject else []
    return list(own) if is_reader(pieces, own) else []


_TOLD_WORDS: Final = OWNERS | {"yourself": "themselves", "myself": "themselves", "being": "is"}
"""Words for the reader in a sentence about a person."""


def _own_action(pieces: Pieces, action: Action, foreign: set[int]) -> Action:
    """Return an action with the arguments that stay in its part: those without a word of other parts' actions."""
    arguments = []
    for argument in action.arguments:
        own = pieces.of(argument)
        if foreign.isdisjoint(own) and not _orders(pieces, argument):
            arguments.append(argument)
    return replace(action, arguments=tuple(arguments))


def _orders(pieces: Pieces, argument: Argument) -> bool:
    """Tell whether an argument does nothing but tell the place of its action in a sequence ("then", "after that")."""
    words = {pieces.word(index) for index in pieces.of(argument)}
    return words <= SEQUENCE_WORDS or words in AFTER_THAT


def _other_words(pieces: Pieces, group: Sequence[Action], groups: Sequence[Sequence[Action]]) -> set[int]:
    """Find the words of the other parts."""
    words: set[int] = set()
    for other in groups:
        if other is not group:
            foreign = {index for part in groups if part is not other for a in part for index in pieces.of(a)}
            for action in other:
                words |= pieces.of_action(_own_action(pieces, action, foreign))
    return words


def _leading_subject(
    pieces: Pieces, actions: Sequence[Action], foreign: set[int]
) -> tuple[list[Item], set[int | None]]:
    """Choose who a part begins with, and the pieces that this stands for; nothing if the part names it in its place."""
    first = actions[0]
    subject = subject_of(pieces.graph, first)
    if subject is None:
        if is_noun(pieces, first) or is_state(pieces, first):
            return [], set()
        subject = _nearest_subject(pieces, actions[1:], first) or _nearest_subject(pieces, pieces.graph.actions, first)
    if subject is not None:
        own = set(pieces.of(subject))
        heads = [pieces.of(action)[0] for action in actions if len(pieces.of(action)) and _has(action, subject)]
        behind = [head for head in heads if own and head > max(own)]
        keeps_form = not any(pieces.word(index) in READERS or pieces.word(index) in OBJECT_FORMS for index in own)
        if behind and keeps_form and foreign.isdisjoint(range(max(own), behind[0])):
            return [], set()
    items = subject_items(pieces, subject)
    return items, {item.piece for item in items} | (set(pieces.of(subject)) if subject is not None else set())


def _has(action: Action, subject: Argument) -> bool:
    return any((argument.start, argument.end) == (subject.start, subject.end) for argument in action.arguments)


def _nearest_subject(pieces: Pieces, actions: Sequence[Action], action: Action) -> Argument | None:
    """Find who does something else, nearest before an action without a subject, else behind; never the reader.

    Who is named behind an order does something of their own ("run | while they cheer").
    """
    is_order = form(action.text) == "base"
    for other in sorted(actions, key=lambda other: (other.start > action.start, abs(other.start - action.start))):
        subject = subject_of(pieces.graph, other)
        if subject is None or (is_order and subject.start > action.start):
            continue
        if not any(pieces.word(index) in READERS for index in pieces.of(subject)):
            return subject
    return None


def _own_words(pieces: Pieces, actions: Sequence[Action], others: set[int], foreign: set[int]) -> list[int]:
    """List the words of a part: those of its nodes, those of none between them, auxiliaries and particles."""
    owned = {index for action in actions for index in pieces.of_action(action)}
    owned.update(_particles_behind(pieces, max(owned, default=0) + 1, others | foreign))
    heads = {index for action in actions for index in pieces.of(action)}
    found = set(owned)
    ordered = sorted(owned)
    for first, last in zip([-1, *ordered], ordered, strict=False):
        gap = range(first + 1, last)
        if first >= 0 and (others - owned).isdisjoint(gap) and foreign.isdisjoint(gap):
            found.update(index for index in gap if pieces.word(index) not in SEQUENCE_WORDS)
            continue
        for index in reversed(gap):
            word = pieces.word(index)
            if index in others or index in foreign or word not in _LEADING | SEQUENCE_WORDS | {",", "."}:
                break
            if word in _QUESTIONING and last not in heads and pieces.word(last) not in ("not", "n't", "nt"):
                break  # "could | the man turn"
            if word not in SEQUENCE_WORDS:
                found.add(index)
    return sorted(found)


def _particles_behind(pieces: Pieces, index: int, others: set[int]) -> range:
    """Find the particles of no node behind a part ("stands | up")."""
    first = index
    while index not in others and pieces.word(index) in lexicon.DIRECTION_ADVERBS:
        index += 1
    return range(first, index)


_LEADING: Final = NEGATING | frozenset("to as if because so like been being having while when".split())
"""Words of no node that belong to the words behind them."""


_QUESTIONING: Final = frozenset("can could will would should do does did is are".split())
"""Auxiliaries that open a question."""


def _trim(kept: list[int], pieces: Pieces) -> list[int]:
    """Leave out connectives and signs at the ends, and signs that meet another."""
    dropped = CONNECTIVES | SIGNS | SEQUENCE_WORDS | _AFTER | _BEFORE | {"that"}
    while kept and pieces.word(kept[0]) in dropped:
        kept = kept[1:]
    while kept and pieces.word(kept[-1]) in CONNECTIVES | SIGNS:
        kept = kept[:-1]
    return [
        index
        for number, index in enumerate(kept)
        if pieces.word(index) not in SIGNS or (number and pieces.word(kept[number - 1]) not in SIGNS)
    ]


def _verbs_to_tell(pieces: Pieces, actions: Sequence[Action]) -> set[int]:
    """Find the verbs of a part that are to be put into the third person: the first, and those coordinated with it."""
    told: set[int] = set()
    previous: int | None = None
    for number, action in enumerate(actions):
        own = pieces.of(action)
        if not own:
            continue
        before = word_before(pieces, own[0])
        is_finite = form(action.text) in ("third", "past") or is_state(pieces, action)
        if not is_finite and before not in _NO_FORM_BEHIND:
            if number == 0:
                is_told = _is_main(pieces, actions)
            else:
                connective = before in ("and", "or", "&", "+", "then", "but")
                is_listed = form(action.text) == "base" and (before in (",", "/", ";") or own[0] - 1 == previous)
                same_form = form(action.text) == form(actions[number - 1].text)
                is_told = previous in told and (connective or is_listed) and same_form
            if is_told:
                told.add(own[0])
        previous = own[-1]
    return told


_MODALS: Final = frozenset("can ca could will wo would should may might must shall 'll 'd".split())
_NO_FORM_BEHIND: Final = RELATIVE | BE | _MODALS | (NEGATING - {"never", "while"}) | {"to", "of", "than", "as"}
"""Words behind which a verb keeps its form."""


def _is_main(pieces: Pieces, actions: Sequence[Action]) -> bool:
    """Tell whether the first verb of a part is its main verb, and needs another form."""
    first = actions[0]
    subject = subject_of(pieces.graph, first)
    if subject is None:
        return not is_noun(pieces, first)
    if form(first.text) == "participle":
        # "moving slowly, a man walks": the main verb comes behind who moves
        return not any(first.start < subject.start < other.start and _has(other, subject) for other in actions[1:])
    return first.text.lower() in lexicon.VERBS and is_singular(pieces, subject)
