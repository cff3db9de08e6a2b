"""Types of arguments by their own words, for the rules."""

from __future__ import annotations

from kinegraph.text import lexicon as words
from kinegraph.text.phrases import Token, words_below


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
