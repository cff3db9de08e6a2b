"""Actions and phrases of a dependency parse: which tokens are verbs of their own, and which words belong to one.

A token is a spaCy token; spans are (first, last) token numbers, last included.

Types of arguments by their own words, for the rules.

Semantic roles from a dependency parse, by rules.

A token is a spaCy token; spans are (first, last) token numbers, last included.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any

from kinegraph.text import lexicon as words
from kinegraph.text.candidates import Span, has_word

Token = Any

CLAUSES = frozenset(("relcl", "acl"))


def is_action(token: Token) -> bool:
    """A full verb, or "be" and the like where they are the clause's main verb."""
    if not has_word(token.text):
        return False
    if token.lower_ == "left" and token.i > token.head.i:  # "turns left 90 degrees", taken for "to leave"
        return False
    if token.lower_ in words.NEVER_VERBS or (token.i and token.nbor(-1).text == "-"):  # "mid-walk"
        return False
    if token.dep_ == "auxpass" and token.lower_ in words.GET:  # "gets pushed": PropBank's own verb
        return True
    if describes_mover(token):
        return True
    if token.pos_ == "VERB":
        return token.dep_ not in ("aux", "auxpass", "amod", "case", "compound", "prep")
    return token.pos_ == "AUX" and token.dep_ in ("ROOT", "ccomp", "advcl", "relcl", "conj", "parataxis", "pcomp")


def describes_mover(token: Token) -> bool:
    """ "a kneeling person": an action of its own, whatever its tag."""
    return (
        token.dep_ in ("amod", "compound")
        and token.lower_.endswith("ing")
        and token.head.i > token.i
        and token.head.lower_ in words.SUBJECT_NOUNS
    )


def words_below(token: Token) -> list[Token]:
    """The subtree of a token without clauses that are actions of their own and without coordinated verbs."""
    found = [token]
    for child in token.children:
        if child.dep_ in CLAUSES or (child.dep_ == "punct" and child.i == token.right_edge.i):
            continue
        if child.dep_ in ("conj", "cc") and (token.pos_ in ("VERB", "AUX") or _leads_to_action(child, token)):
            continue
        found += words_below(child)
    return found


def _leads_to_action(child: Token, parent: Token) -> bool:
    if child.dep_ == "conj":
        return is_action(child)
    later = [other for other in parent.children if other.dep_ == "conj" and other.i > child.i]
    return bool(later) and is_action(later[0])


def phrase(token: Token) -> Span | None:
    """The run of neighbouring words around a token that belong to it, without punctuation at its ends."""
    numbers = {word.i for word in words_below(token)}
    first = last = token.i
    while first - 1 in numbers:
        first -= 1
    while last + 1 in numbers:
        last += 1
    return trimmed(token.doc, (first, last))


def trimmed(doc: Any, span: Span) -> Span | None:
    """Without punctuation and conjunctions at the ends; None if nothing is left."""
    first, last = span
    while first <= last and (not has_word(doc[first].text) or doc[first].dep_ == "cc"):
        first += 1
    while first <= last and (not has_word(doc[last].text) or doc[last].dep_ == "cc"):
        last -= 1
    return (first, last) if first <= last else None


def adverb_role(token: Token) -> str:
    """Of an adverb, by its own word, then by its ending."""
    word = token.lower_
    for role, known in (
        ("ARGM-DIR", words.DIRECTION_ADVERBS),
        ("ARGM-TMP", words.TIME_ADVERBS),
        ("ARGM-LOC", words.PLACE_ADVERBS),
        ("ARGM-ADV", words.DISCOURSE_ADVERBS),
        ("OTHERS", words.OTHER_ADVERBS),
        ("ARGM-MNR", words.MANNER_ADVERBS),
    ):
        if word in known:
            return role
    return "ARGM-MNR" if word.endswith(("ly", "wise")) else "ARGM-ADV"


def endpoint_role(token: Token, head: Token) -> str | None:
    """Numbered roles of verbs of travel and transfer: ARG3 where from, ARG4 where to, ARG2 onto what."""
    below = {word.lemma_.lower() for word in words_below(token)}
    if below & (words.SIDE_NOUNS | words.WAYS):
        return None
    verb, word = head.lemma_.lower(), token.lower_
    if verb in words.TRAVEL and word in ("from", "to"):
        return "ARG3" if word == "from" else "ARG4"
    return (
        "ARG2" if verb in words.TRANSFER and word in ("to", "on", "onto", "in", "into", "from", "at", "with") else None
    )


def prepositional_role(token: Token) -> str:
    """Of a prepositional phrase, by its preposition and its object."""
    word = token.lower_
    below = {word.lemma_.lower() for word in words_below(token)} - {word}
    if word in ("in", "at", "with", "without", "on") and below & words.CIRCLE_NOUNS and word != "on":
        return "ARGM-MNR"
    if word in ("in", "at", "on", "by") and below & words.WAYS:
        return "ARGM-MNR"
    if word in ("to", "on", "at", "from") and below & words.SIDE_NOUNS:
        return "ARGM-DIR" if word != "on" else "ARGM-LOC"
    if below & words.TIME_NOUNS and word in ("for", "at", "in", "after", "before", "of"):
        return "ARGM-TMP"
    if word in words.DIRECTION_PREPOSITIONS:
        return "ARGM-DIR"
    if word in words.MANNER_PREPOSITIONS:
        return "ARGM-MNR"
    if word in words.TIME_PREPOSITIONS:
        return "ARGM-TMP" if word != "for" else "ARGM-ADV"
    return "ARGM-LOC" if word in words.PLACE_PREPOSITIONS else "ARGM-ADV"


def clause_role(token: Token) -> str:
    """Of an adverbial clause, by its marker."""
    markers = {child.lower_ for child in token.children if child.dep_ in ("mark", "advmod")}
    if markers & {"if", "though"} and "as" in markers | {child.lower_ for child in token.lefts}:
        return "ARGM-MNR"
    if markers & words.TIME_MARKERS:
        return "ARGM-TMP"
    if any(child.tag_ == "TO" for child in token.children):
        return "OTHERS"
    return "ARGM-MNR" if token.lemma_.lower() in words.STATIVE | {"show", "lack", "act", "use"} else "ARGM-ADV"


def noun_adverb_role(token: Token) -> str:
    """Of a bare noun phrase used as an adverb: how often, which way, how far."""
    word = token.lemma_.lower()
    if word in words.TIME_NOUNS:
        return "ARGM-TMP"
    if word in words.SIDE_NOUNS | words.DIRECTION_ADVERBS:
        return "ARGM-DIR"
    return "ARGM-MNR" if word in words.MANNER_NOUNS and word != "step" else "OTHERS"


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
