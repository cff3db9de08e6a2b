"""Semantic roles from a dependency parse, by rules.

A token is a spaCy token; spans are (first, last) token numbers, last included.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import pairwise

from kinegraph.text import lexicon as words
from kinegraph.text.phrases import CLAUSES, Token, describes_mover, is_action, phrase, trimmed
from kinegraph.text.role_rules import adverb_role, clause_role, endpoint_role, noun_adverb_role, prepositional_role
from kinegraph.text.spans import Span

SUBJECTS = frozenset(("nsubj", "csubj", "expl"))
PASSIVE_SUBJECTS = frozenset(("nsubjpass", "csubjpass"))
SILENT = frozenset(("aux", "auxpass", "punct", "mark", "cc", "conj", "preconj", "case", "det", "parataxis", "dep"))
CONTENT = frozenset(("NOUN", "PROPN", "ADJ", "ADV", "NUM", "VERB", "ADP", "SYM", "X", "INTJ", "PRON"))


@dataclass
class Frame:
    """One action with its arguments while they are collected."""

    head: Token
    arguments: list[tuple[str, Span]] = field(default_factory=list)
    others: list[tuple[str, Span]] | None = None
    """What else could be one, the likeliest first; None without a model that could tell."""

    def add(self, role: str, span: Span | None) -> None:
        """Take an argument unless the same words are there already."""
        if span is not None and span not in [known for _, known in self.arguments]:
            self.arguments.append((role, span))


def frame(head: Token) -> Frame:
    """An action with all arguments its own subtree gives."""
    found = Frame(head)
    if head.dep_ == "auxpass":
        found.add("ARG1", subject_span(head.head))
        found.add("ARG2", trimmed(head.doc, (head.head.i, _own_end(head.head))))
        return found
    if describes_mover(head):
        found.add("ARG0", (head.head.i, head.head.i))
    subject = subject_span(head)
    has_object = any(child.dep_ == "dobj" for child in head.children)
    if subject is not None:
        found.add(subject_role(head, has_object), subject)
    objects = [child for child in head.children if child.dep_ == "dobj"]
    for child in head.children:
        for role, span in _argument(child, head):
            found.add(role, _listed(objects) if child in objects else span)
    if not has_object:
        found.add("ARG1", _shared_object(head))
    return found


def _listed(objects: list[Token]) -> Span | None:
    """The object, or several as one where nothing but commas parts them ("the knees, the hips and the elbows")."""
    spans = [span for span in map(phrase, objects) if span is not None]
    for (_, end), (start, _) in pairwise(spans):
        if objects[0].doc[end + 1].text not in (",", "and") or start != end + 2:
            return phrase(objects[-1])
    return (spans[0][0], spans[-1][1]) if spans else None


def _shared_object(head: Token) -> Span | None:
    """ "raises and lowers the hand": the object of the verb that follows at once."""
    if head.lemma_.lower() not in words.TRANSITIVE:
        return None
    for child in head.rights:
        if child.dep_ == "conj" and child.i == head.i + 2 and head.nbor().dep_ == "cc":
            return next((phrase(below) for below in child.children if below.dep_ == "dobj"), None)
    return None


def _own_end(head: Token) -> int:
    """Last word of a verb's phrase, before other verbs that are coordinated with it."""
    joined = [child.i for child in head.rights if child.dep_ in ("cc", "conj")]
    return min(joined) - 1 if joined else int(head.right_edge.i)


def subject_role(head: Token, has_object: bool) -> str:
    """ARG1 for passives and for motion that happens by itself, else ARG0."""
    undergoes = head.lemma_.lower() in words.UNACCUSATIVE | words.STATIVE and not has_object
    return "ARG1" if is_passive(head) or undergoes else "ARG0"


def is_passive(head: Token) -> bool:
    """Whether the verb's subject is what it is done to."""
    return any(child.dep_ in PASSIVE_SUBJECTS | {"auxpass"} for child in head.children)


def is_certain(head: Token, span: Span) -> bool:
    """Negations, and agents behind "by": no annotated captions have enough of them to learn from."""
    return any(child.dep_ in ("neg", "agent") and span[0] <= child.i <= span[1] for child in head.children)


def subject_span(head: Token) -> Span | None:
    """The subject of an action: its own, the noun it modifies, or that of the action it depends on."""
    span = own_subject_span(head)
    for child in head.lefts:
        if span is None and run_on(child, head):
            # only its own: looking further up from there leads back here
            span = own_subject_span(child)
    if span is not None:
        return span
    if head.dep_ in CLAUSES and head.head.pos_ in ("NOUN", "PROPN", "PRON"):
        return phrase(head.head)
    if head.dep_ in ("conj", "xcomp", "advcl", "pcomp", "ccomp", "dep", "prep") and head.head.i != head.i:
        above = head.head
        while not is_action(above) and above.head.i != above.i:
            above = above.head
        if is_action(above):
            return subject_span(above)
    return None


def own_subject_span(head: Token) -> Span | None:
    """The subject among an action's own dependents."""
    for child in head.children:
        if child.dep_ in SUBJECTS | PASSIVE_SUBJECTS:
            relative = child.tag_ in ("WP", "WDT") and head.dep_ == "relcl"
            return phrase(head.head) if relative else phrase(child)
    return None


def run_on(child: Token, head: Token) -> bool:
    """ "someone runs, then bows" is taken for "bows (that) someone runs"."""
    return child.dep_ == "ccomp" and child.i < head.i and is_action(child)


def _argument(child: Token, head: Token) -> Iterator[tuple[str, Span | None]]:
    relation = child.dep_
    if relation in SUBJECTS | PASSIVE_SUBJECTS or (relation in SILENT and not _stray(child)) or run_on(child, head):
        return
    if relation in ("dobj", "ccomp", "xcomp", "oprd", "acomp", "attr"):
        role = "ARG2" if relation in ("acomp", "attr", "oprd") and head.lemma_.lower() == "be" else "ARG1"
        if child.lower_ in words.DIRECTION_ADVERBS:
            role = "ARGM-DIR"
        yield role, phrase(child)
    elif relation == "dative":
        yield "ARG2", phrase(child)
    elif relation == "agent":
        yield "ARG0", phrase(child)
    elif relation == "prt":
        yield "ARGM-DIR", phrase(child)
    elif relation == "prep":
        yield from _prepositional(child, head)
    elif relation == "advmod":
        yield adverb_role(child), phrase(child)
    elif relation == "advcl":
        yield clause_role(child), phrase(child)
    elif relation == "npadvmod":
        yield noun_adverb_role(child), phrase(child)
    elif relation == "neg":
        yield "OTHERS", phrase(child)
    elif relation not in CLAUSES:
        yield "ARGM-ADV", phrase(child)


def _stray(token: Token) -> bool:
    """A word with content under a relation that normally carries none."""
    return token.dep_ == "dep" and token.pos_ in CONTENT and not is_action(token)


def _prepositional(child: Token, head: Token) -> Iterator[tuple[str, Span | None]]:
    """ "from the door to the wall" is taken for one phrase; it is two."""
    role, span = endpoint_role(child, head) or prepositional_role(child), phrase(child)
    ends = [below for below in child.subtree if below.dep_ == "prep" and below.lower_ == "to"]
    if child.lower_ == "from" and ends and span is not None:
        yield role, trimmed(child.doc, (span[0], ends[0].left_edge.i - 1))
        yield endpoint_role(ends[0], head) or prepositional_role(ends[0]), phrase(ends[0])
    else:
        yield role, span
