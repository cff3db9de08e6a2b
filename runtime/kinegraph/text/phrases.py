"""Actions and phrases of a dependency parse: which tokens are verbs of their own, and which words belong to one.

A token is a spaCy token; spans are (first, last) token numbers, last included.
"""

from __future__ import annotations

from typing import Any

from kinegraph.text import lexicon as words
from kinegraph.text.spans import Span, has_word

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
