"""Predicate frames by rules: which tokens are actions, which phrases are their arguments, and in which role.

Actions are verbs of the dependency parse. Each collects its subject, its objects and its modifiers as spans of its own
subtree; roles are PropBank's (`kinegraph.graph.ROLES`), chosen by dependency label and word lists. The rules read
spaCy tokens, because they walk the tree.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any

from kinegraph.text import lexicon
from kinegraph.text.dependency import Span, has_word, is_filler, trim_span

Token = Any
"""A spaCy token."""

NOUN_CLAUSES = frozenset(("relcl", "acl"))
"""Clauses that modify a noun; their verbs are actions of their own."""
SUBJECTS = frozenset(("nsubj", "csubj", "expl"))
PASSIVE_SUBJECTS = frozenset(("nsubjpass", "csubjpass"))
ALL_SUBJECTS = SUBJECTS | PASSIVE_SUBJECTS
_PASSIVE_LABELS = PASSIVE_SUBJECTS | {"auxpass"}
SEQUENCE_WORDS = frozenset("then first next finally afterwards".split())
"""Adverbs that tell the place of the verb behind them in a sequence."""
NON_ARGUMENTS = frozenset(
    ("aux", "auxpass", "punct", "mark", "cc", "conj", "preconj", "case", "det", "parataxis", "dep")
)
"""Dependency labels of children that are no arguments."""
CONTENT_POS = frozenset(("NOUN", "PROPN", "ADJ", "ADV", "NUM", "VERB", "ADP", "SYM", "X", "INTJ", "PRON"))


# Actions


def is_action(token: Token) -> bool:
    """Tell whether a token is a full verb, or an auxiliary such as "be" that is the main verb of its clause."""
    if not has_word(token.text) or token.tag_ == "MD":
        return False
    if token.lower_ == "left" and token.i > token.head.i:  # "turns left 90 degrees", taken for "to leave"
        return False
    if token.lower_ in lexicon.NEVER_VERBS or (token.i and token.nbor(-1).text == "-"):  # "mid-walk"
        return False
    if token.dep_ == "auxpass" and token.lower_ in lexicon.GET:  # "gets pushed": PropBank annotates "get"
        return True
    if is_subject_participle(token):
        return True
    if token.pos_ == "VERB":
        return token.dep_ not in ("aux", "auxpass", "amod", "case", "compound", "prep")
    return token.pos_ == "AUX" and token.dep_ in ("ROOT", "ccomp", "advcl", "relcl", "conj", "parataxis", "pcomp")


def is_subject_participle(token: Token) -> bool:
    """Tell whether a token is a participle before the noun of who moves, such as "a kneeling person"."""
    return (
        token.dep_ in ("amod", "compound")
        and token.lower_.endswith("ing")
        and token.head.i > token.i
        and token.head.lower_ in lexicon.SUBJECT_NOUNS
    )


def is_passive(head: Token) -> bool:
    """Tell whether a verb is in the passive voice."""
    return any(child.dep_ in _PASSIVE_LABELS for child in head.children)


# Frames


@dataclass
class PredicateFrame:
    """An action and its arguments as (role, span), while they are collected."""

    head: Token
    """The verb."""
    arguments: list[tuple[str, Span]] = field(default_factory=list)
    ranked: list[tuple[str, Span]] | None = None
    """All candidates of the argument classifier, the likeliest first; None if the rules stand alone."""
    certain: set[Span] = field(default_factory=set)
    """Arguments that the classifier must not change: the rules find them reliably, and annotated captions have too few
    of them to learn from."""
    negated: bool = False
    """True if the action must not happen."""

    def add(self, role: str, span: Span | None, certain: bool = False) -> None:
        """Add an argument, unless there is no span or the same span is an argument already."""
        if span is None:
            return
        if span not in [known for _, known in self.arguments]:
            self.arguments.append((role, span))
        if certain:
            self.certain.add(span)


def build_frame(head: Token) -> PredicateFrame:
    """Collect the arguments of an action: its subject, its objects and its modifiers."""
    frame = PredicateFrame(head)
    if head.dep_ == "auxpass" and head.lower_ in lexicon.GET:
        frame.add("ARG1", subject_span(head.head))
        frame.add("ARG2", trim_in_doc(head.doc, (head.head.i, _verb_phrase_end(head.head))))
        return frame
    if is_subject_participle(head):
        frame.add("ARG0", (head.head.i, head.head.i))
    objects = [child for child in head.children if child.dep_ == "dobj"]
    subject = subject_span(head)
    if subject is not None:
        frame.add(subject_role(head, bool(objects)), subject)
    for index in sequence_words(head):
        frame.add("ARGM-TMP", (index, index), certain=True)
    for posture in posture_spans(head):
        frame.add("ARGM-MNR", posture, certain=True)
    for child in head.children:
        for role, span in _arguments_of_child(child, head):
            certain = child.dep_ in ("neg", "agent") or _excludes_action(child)
            if child in objects:
                role, span = "ARG1" if len(objects) > 1 else role, _object_list_span(objects)
                certain = len(objects) > 1 or _is_moved_part(head, child, span)
            frame.add(role, span, certain)
    if not objects:
        frame.add("ARG1", _shared_object_span(head))
    elif head.lemma_.lower() in ("keep", "hold"):
        frame.add("ARG2", _kept_posture(head, objects[-1]), certain=True)
    return frame


def _kept_posture(head: Token, child: Token) -> Span | None:
    """Find how a part of the body is kept: "keeps the hands | down"."""
    span = phrase_span(child)
    if span is None or child.lower_ not in lexicon.BODY_NOUNS:
        return None
    last = child.i
    while last + 1 < len(head.doc) and head.doc[last + 1].lower_ in lexicon.POSTURES:
        last += 1
    return (child.i + 1, last) if last > child.i else None


def _excludes_action(child: Token) -> bool:
    """Tell whether a dependent says what does not happen ("without turning", "instead of running")."""
    is_exclusion = child.lower_ == "without" or (child.lower_ in ("of", "than") and child.i > 1)
    if not is_exclusion or child.dep_ != "prep" or not any(below.dep_ == "pcomp" for below in child.children):
        return False
    return child.lower_ == "without" or child.nbor(-1).lower_ in ("instead", "rather")


def _is_moved_part(head: Token, child: Token, span: Span | None) -> bool:
    """Tell whether an object is a part of the body that its verb moves, and nothing else."""
    is_part = child.lower_ in lexicon.BODY_NOUNS and span is not None and span[1] == child.i
    return is_part and head.lemma_.lower() in lexicon.TRANSITIVE


def sequence_words(head: Token) -> list[int]:
    """List the words right before a verb that tell its place in a sequence ("and then bows", "second: bow")."""
    found = []
    index = head.i - 1
    while index >= 0:
        word = head.doc[index].lower_
        if word in SEQUENCE_WORDS:
            found.append(index)
        elif not (word.endswith("ly") or word == ":"):
            break
        index -= 1
    return found


def _arguments_of_child(child: Token, head: Token) -> Iterator[tuple[str, Span | None]]:
    """Yield the arguments that one dependent of a verb gives; most give one."""
    label = child.dep_
    if label in ALL_SUBJECTS or is_run_on_clause(child, head):
        return
    if label in NON_ARGUMENTS and not _is_unlabelled_content(child):
        return
    if label in ("dobj", "ccomp", "xcomp", "oprd", "acomp", "attr"):
        role = "ARG2" if label in ("acomp", "attr", "oprd") and head.lemma_.lower() == "be" else "ARG1"
        if child.lower_ in lexicon.DIRECTION_ADVERBS:
            role = "ARGM-DIR"
        elif label == "xcomp" and child.tag_ == "VBG" and head.lemma_.lower() not in _PARTICIPLE_OBJECTS:
            role = "ARGM-ADV"  # "walks | swinging the arms"
        yield role, phrase_span(child)
    elif label == "dative":
        yield "ARG2", phrase_span(child)
    elif label == "agent":
        yield "ARG0", phrase_span(child)
    elif label == "prt":
        yield "ARGM-DIR", phrase_span(child)
    elif label == "prep":
        yield from _prepositional_arguments(child, head)
    elif label == "advmod":
        yield adverb_role(child), phrase_span(child)
    elif label == "advcl":
        yield clause_role(child), phrase_span(child)
    elif label == "npadvmod":
        yield noun_adverb_role(child), phrase_span(child)
    elif label == "neg":
        yield "OTHERS", phrase_span(child)
    elif label not in NOUN_CLAUSES:
        yield "ARGM-ADV", phrase_span(child)


def _is_unlabelled_content(token: Token) -> bool:
    """Tell whether a token is a content word whose relation the parser left open ("dep")."""
    return token.dep_ == "dep" and token.pos_ in CONTENT_POS and not is_action(token)


_PARTICIPLE_OBJECTS = lexicon.CATENATIVE | {"perform", "do", "make", "show", "go"}
"""Verbs that have a participle as their object."""


def _prepositional_arguments(child: Token, head: Token) -> Iterator[tuple[str, Span | None]]:
    """Yield a prepositional phrase, or two where the parse nests them ("from the door to the wall")."""
    role, span = endpoint_role(child, head) or prepositional_role(child), phrase_span(child)
    goals = [token for token in child.subtree if token.dep_ == "prep" and token.lower_ == "to"]
    if child.lower_ == "from" and goals and span is not None:
        yield role, trim_in_doc(child.doc, (span[0], goals[0].left_edge.i - 1))
        yield endpoint_role(goals[0], head) or prepositional_role(goals[0]), phrase_span(goals[0])
    else:
        yield role, span


def posture_spans(head: Token) -> Iterator[Span]:
    """Yield how parts of the body are held meanwhile: "with both arms up", "with crossed legs"."""
    doc = head.doc
    for token in doc[head.i + 1 : head.right_edge.i + 1]:
        if token.lower_ == "with":
            above = token.head
            while not is_action(above) and above.head.i != above.i:
                above = above.head
            end = _posture_end(token) if above.i == head.i else None
            if end is not None:
                yield token.i, end


def _posture_end(preposition: Token) -> int | None:
    """Find the last token of a posture: a part of the body with an adverb or participle before or behind it."""
    doc, index = preposition.doc, preposition.i + 1
    while index < len(doc) and doc[index].lower_ not in lexicon.BODY_NOUNS:
        is_part = doc[index].pos_ in ("DET", "PRON", "ADJ", "NUM", "ADV", "VERB") or doc[index].lower_ == "both"
        if not is_part or index > preposition.i + 4:
            return None
        index += 1
    if index >= len(doc):
        return None
    last = index
    while last + 1 < len(doc) and doc[last + 1].lower_ in lexicon.POSTURES:
        last += 1
    goes_on = last + 1 < len(doc) and doc[last + 1].pos_ in ("ADP", "DET", "PRON")
    is_participle = doc[index - 1].lower_ in lexicon.POSTURES and doc[index - 1].pos_ in ("VERB", "ADJ")
    return last if (last > index or is_participle) and not goes_on else None


def _object_list_span(objects: list[Token]) -> Span | None:
    """Join direct objects with only a comma or "and" between them ("the knees, the hips"), else take the last."""
    spans = [span for span in map(phrase_span, objects) if span is not None]
    for (_, end), (start, _) in pairwise(spans):
        if objects[0].doc[end + 1].text not in (",", "and") or start != end + 2:
            return phrase_span(objects[-1])
    return (spans[0][0], spans[-1][1]) if spans else None


def _shared_object_span(head: Token) -> Span | None:
    """Find the object of the verb coordinated right behind this one ("raises and lowers the hand")."""
    if head.lemma_.lower() not in lexicon.TRANSITIVE:
        return None
    for child in head.rights:
        if child.dep_ == "conj" and child.i == head.i + 2 and head.nbor().dep_ == "cc":
            return next((phrase_span(token) for token in child.children if token.dep_ == "dobj"), None)
    return None


def _verb_phrase_end(head: Token) -> int:
    """Find the last token of a verb's phrase before the verbs coordinated with it."""
    coordinated = [child.i for child in head.rights if child.dep_ in ("cc", "conj")]
    return min(coordinated) - 1 if coordinated else int(head.right_edge.i)


# Subjects


def subject_span(head: Token) -> Span | None:
    """Find the subject of an action: its own, the noun it modifies, or that of the action it depends on."""
    span = own_subject_span(head)
    for child in head.lefts:
        if span is None and is_run_on_clause(child, head):
            # Only its own subject: searching further up from there leads back here.
            span = own_subject_span(child)
    if span is not None:
        return span
    if head.dep_ in NOUN_CLAUSES and head.head.pos_ in ("NOUN", "PROPN", "PRON"):
        return phrase_span(head.head)
    if head.dep_ in ("conj", "xcomp", "advcl", "pcomp", "ccomp", "dep", "prep") and head.head.i != head.i:
        above = head.head
        while not is_action(above) and above.head.i != above.i:
            above = above.head
        if is_action(above):
            return subject_span(above)
    return None


def own_subject_span(head: Token) -> Span | None:
    """Find the subject among an action's own dependents."""
    for child in head.children:
        if child.dep_ in ALL_SUBJECTS:
            is_relative = child.tag_ in ("WP", "WDT") and head.dep_ == "relcl"
            return phrase_span(head.head) if is_relative else phrase_span(child)
    return None


def is_run_on_clause(child: Token, head: Token) -> bool:
    """Tell whether the parse takes "someone runs, then bows" for "bows (that) someone runs"."""
    return child.dep_ == "ccomp" and child.i < head.i and is_action(child)


# Roles

_UNDERGOING = lexicon.UNACCUSATIVE | lexicon.STATIVE
_LOOKED_AT = lexicon.DIRECTION_ADVERBS | frozenset("at to toward towards over behind".split())
"""Words with which looking is an action, not an appearance."""
_SIDES_AND_WAYS = lexicon.SIDE_NOUNS | lexicon.WAYS
_SIDES = lexicon.SIDE_NOUNS | lexicon.DIRECTION_ADVERBS


def subject_role(head: Token, has_object: bool) -> str:
    """Choose ARG1 for subjects of passives and of verbs such as "fall", which undergo the motion, else ARG0."""
    lemma = head.lemma_.lower()
    undergoes = lemma in _UNDERGOING and not has_object
    if lemma == "look" and any(child.lower_ in _LOOKED_AT for child in head.children):
        return "ARG0"
    return "ARG1" if is_passive(head) or undergoes else "ARG0"


def adverb_role(token: Token) -> str:
    """Choose the role of an adverb by the word lists, then by its ending."""
    word = token.lower_
    for role, adverbs in (
        ("ARGM-DIR", lexicon.DIRECTION_ADVERBS),
        ("ARGM-TMP", lexicon.TIME_ADVERBS),
        ("ARGM-LOC", lexicon.PLACE_ADVERBS),
        ("ARGM-ADV", lexicon.DISCOURSE_ADVERBS),
        ("OTHERS", lexicon.OTHER_ADVERBS),
        ("ARGM-MNR", lexicon.MANNER_ADVERBS),
    ):
        if word in adverbs:
            return role
    return "ARGM-MNR" if word.endswith(("ly", "wise")) else "ARGM-ADV"


def endpoint_role(token: Token, head: Token) -> str | None:
    """Choose the numbered role of a preposition after a verb of travel or transfer; None if it bears none.

    After travel, ARG3 is the start and ARG4 the goal. After transfer, ARG2 is the recipient or the place.
    """
    lemmas = {below.lemma_.lower() for below in phrase_tokens(token)}
    if not lemmas.isdisjoint(_SIDES_AND_WAYS):
        return None
    verb, preposition = head.lemma_.lower(), token.lower_
    if verb in lexicon.TRAVEL and preposition in ("from", "to"):
        return "ARG3" if preposition == "from" else "ARG4"
    is_transfer = verb in lexicon.TRANSFER and preposition in ("to", "on", "onto", "in", "into", "from", "at", "with")
    return "ARG2" if is_transfer else None


def prepositional_role(token: Token) -> str:
    """Choose the role of a prepositional phrase by its preposition and its object."""
    preposition = token.lower_
    lemmas = {below.lemma_.lower() for below in phrase_tokens(token)} - {preposition}
    if preposition in ("in", "at", "with", "without") and lemmas & lexicon.CIRCLE_NOUNS:
        return "ARGM-MNR"
    if preposition in ("in", "at", "on", "by") and lemmas & lexicon.WAYS:
        return "ARGM-MNR"
    if preposition in ("to", "on", "at", "from") and lemmas & lexicon.SIDE_NOUNS:
        return "ARGM-DIR" if preposition != "on" else "ARGM-LOC"
    if lemmas & lexicon.TIME_NOUNS and preposition in ("for", "at", "in", "after", "before", "of"):
        return "ARGM-TMP"
    if preposition in lexicon.DIRECTION_PREPOSITIONS:
        return "ARGM-DIR"
    if preposition in lexicon.MANNER_PREPOSITIONS:
        return "ARGM-MNR"
    if preposition in lexicon.TIME_PREPOSITIONS:
        return "ARGM-TMP" if preposition != "for" else "ARGM-ADV"
    return "ARGM-LOC" if preposition in lexicon.PLACE_PREPOSITIONS else "ARGM-ADV"


def clause_role(token: Token) -> str:
    """Choose the role of an adverbial clause by the word that opens it, then by its verb."""
    markers = {child.lower_ for child in token.children if child.dep_ in ("mark", "advmod")}
    if markers & {"if", "though"} and "as" in markers | {child.lower_ for child in token.lefts}:
        return "ARGM-MNR"
    if markers & lexicon.TIME_MARKERS:
        return "ARGM-TMP"
    if any(child.tag_ == "TO" for child in token.children):
        return "OTHERS"
    return "ARGM-MNR" if token.lemma_.lower() in lexicon.STATIVE | {"show", "lack", "act", "use"} else "ARGM-ADV"


def noun_adverb_role(token: Token) -> str:
    """Choose the role of a bare noun phrase used as an adverb: how often, which way, how far."""
    lemma = token.lemma_.lower()
    if lemma in lexicon.TIME_NOUNS:
        return "ARGM-TMP"
    if lemma in _SIDES:
        return "ARGM-DIR"
    return "ARGM-MNR" if lemma in lexicon.MANNER_NOUNS and lemma != "step" else "OTHERS"


# Phrases


def phrase_span(token: Token) -> Span | None:
    """Find the contiguous part of a token's phrase around it, without fillers at the ends."""
    indices = {below.i for below in phrase_tokens(token)}
    first = last = token.i
    while first - 1 in indices:
        first -= 1
    while last + 1 in indices:
        last += 1
    return trim_in_doc(token.doc, (first, last))


def phrase_tokens(token: Token) -> list[Token]:
    """List the subtree of a token without clauses that are actions of their own and without coordinated verbs."""
    tokens = [token]
    for child in token.children:
        if child.dep_ in NOUN_CLAUSES or (child.dep_ == "punct" and child.i == token.right_edge.i):
            continue
        if child.dep_ in ("conj", "cc") and (token.pos_ in ("VERB", "AUX") or _coordinates_action(child, token)):
            continue
        tokens += phrase_tokens(child)
    return tokens


def _coordinates_action(child: Token, parent: Token) -> bool:
    """Tell whether a conjunct, or the first conjunct behind a conjunction, is an action."""
    if child.dep_ == "conj":
        return is_action(child)
    later = [sibling for sibling in parent.children if sibling.dep_ == "conj" and sibling.i > child.i]
    return bool(later) and is_action(later[0])


def trim_in_doc(doc: Any, span: Span) -> Span | None:
    """Drop fillers at the ends of a span of a spaCy document; None if nothing is left."""
    return trim_span(span, lambda index: is_filler(doc[index].text, doc[index].dep_))
