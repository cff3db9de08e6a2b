"""Tokens of a caption that are read: glued words are split, spellings joined, and what tells no motion is left out.

Left out are white space, the numbers and bullets of a list of steps ("1.", "Step 2:", "- "), the wording of a request
("can you make ... jump?", "show me ...", "a video of ...") and politeness ("please"). A step begins a sentence.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from itertools import pairwise
from typing import Any, Final, NamedTuple

from kinegraph.text import lexicon
from kinegraph.text.quantities import is_counted


class CaptionToken(NamedTuple):
    """A token of a caption."""

    text: str
    """The word as it is written, or the common spelling that it stands for ("and" for "&")."""
    start: int
    end: int
    """Characters of the caption, end exclusive."""
    space: bool
    """True if white space follows."""
    begins_line: bool = False
    """True for the first token of a line that is not the first."""
    begins_step: bool = False
    """True for the first token behind the number or bullet of a step: a sentence begins here."""
    is_told: bool = False
    """True for the first token behind "make", "let", "i want" ...: who moves, with a verb in base form."""


def caption_tokens(written: Any, caption: str) -> list[CaptionToken]:
    """Choose the tokens of a caption that are read; all of them if nothing would be left.

    Args:
        written: spaCy document of the caption with its white space replaced by blanks.
        caption: the caption, with its line breaks.
    """
    tokens = join_rotations(_split_tokens(written, caption))
    kept = drop_politeness(drop_requests(mark_steps(tokens)))
    return kept if any(_has_word(token.text) for token in kept) else tokens


def _has_word(text: str) -> bool:
    return any(char.isalnum() for char in text)


# Splitting and joining

_GLUE: Final = re.compile(r"->|=>|[;+&>|→•#]")
_GLUED_NUMBER: Final = re.compile(r"(\d{1,2})([.):])(?=[^\W\d])")
_ROTATION: Final = re.compile(r"(?:counter|anti|contra)[-‐‑–]?clockwise|ccw", re.IGNORECASE)


def _split_tokens(written: Any, caption: str) -> list[CaptionToken]:
    """Copy the spaCy tokens without white space, and split what is glued together ("walk+wave", "1.walk")."""
    tokens: list[CaptionToken] = []
    breaks = (
        [index for index, char in enumerate(caption) if char in "\r\n"] if "\n" in caption or "\r" in caption else []
    )
    last_end = 0
    for token in written:
        text: str = token.text
        if text.isspace():
            continue
        begins_line = bool(tokens) and any(last_end <= index < token.idx for index in breaks)
        pieces = _pieces(text) if len(text) > 2 else [(0, len(text))]
        for start, end in pieces:
            space = bool(token.whitespace_) if end == len(text) else False
            tokens.append(
                CaptionToken(text[start:end], token.idx + start, token.idx + end, space, begins_line and start == 0)
            )
        last_end = token.idx + len(text)
    for index, token in enumerate(tokens):
        text = _spell(tokens, index)
        if text != token.text:
            tokens[index] = token._replace(text=text)
    return tokens


def _pieces(text: str) -> list[tuple[int, int]]:
    """Split a token at signs that separate words; returns characters of the pieces, signs included."""
    cuts = {0, len(text)}
    number = _GLUED_NUMBER.match(text)
    if number:
        cuts |= {number.end(1), number.end(2)}
    for sign in _GLUE.finditer(text):
        cuts |= {sign.start(), sign.end()}
    return list(pairwise(sorted(cuts)))


def _spell(tokens: Sequence[CaptionToken], index: int) -> str:
    """Write signs and abbreviations as the words that they stand for."""
    text = tokens[index].text
    word = text.lower()
    following = tokens[index + 1].text.lower() if index + 1 < len(tokens) else ""
    if word in ("&", "+", "n", "'n", "n'"):
        return "and" if index and following[:1].isalnum() and tokens[index - 1].text[-1].isalnum() else text
    if word in ("w", "w/", "w."):
        return "with" if following[:1].isalpha() and index else text
    if word == "had" and index and tokens[index - 1].text.lower() in _HAND_MARKERS:
        return "hand"
    return lexicon.ABBREVIATIONS.get(word, text)


_HAND_MARKERS: Final = frozenset("his her my your their its left right the".split())
"""Words before "had" that make it a slip for "hand"."""


def join_rotations(tokens: list[CaptionToken]) -> list[CaptionToken]:
    """Join "counter-clockwise" in all its spellings to one token, "counterclockwise"."""
    joined: list[CaptionToken] = []
    for token in tokens:
        if _ROTATION.fullmatch(token.text):
            token = token._replace(text="counterclockwise")
        elif token.text.lower() in ("clockwise", "clock-wise", "cw"):
            while len(joined) > 1 and joined[-1].text in "-‐‑–" and joined[-2].text.lower() in _AGAINST:
                joined.pop()
            if joined and joined[-1].text.lower() in _AGAINST:
                before = joined.pop()
                token = before._replace(text="counterclockwise", end=token.end, space=token.space)
            else:
                token = token._replace(text="clockwise")
        joined.append(token)
    return joined


_AGAINST: Final = frozenset("counter anti contra".split())


# Steps

_STEP_NOUNS: Final = frozenset("step part phase stage task number no nr".split())
_NUMBER_WORDS: Final = {
    word: value for value, word in enumerate("one two three four five six seven eight nine ten".split(), 1)
}
_ROMAN: Final = {word: value for value, word in enumerate("i ii iii iv v vi vii viii ix x".split(), 1)}
_BULLETS: Final = frozenset("- – — • * · ▪ ● ◦ ‣ ► > →".split())
_ARROWS: Final = frozenset("-> => → ➡ ➜ ⇒ > |".split())
_STEP_SIGNS: Final = _BULLETS | _ARROWS | frozenset("( ) [ # :".split())
_MARKS: Final = frozenset(". ) : - – — ]".split())


def mark_steps(tokens: list[CaptionToken]) -> list[CaptionToken]:
    """Leave out the numbers and bullets of steps, and mark the token behind each as the first of a sentence."""
    if not any(token.text in _STEP_SIGNS or token.text[0].isdecimal() or len(token.text) == 2 for token in tokens):
        return tokens  # most captions
    numbers = _numbered_steps(tokens) or _bulleted_steps(tokens)
    kept: list[CaptionToken] = []
    begins = False
    skip_to = 0
    for index, token in enumerate(tokens):
        if index in numbers:
            skip_to = max(skip_to, numbers[index])
        if index < skip_to:
            begins = True
            continue
        if token.text in _ARROWS and kept:
            begins = True
            continue
        kept.append(token._replace(begins_step=True) if begins else token)
        begins = False
    return kept


def _numbered_steps(tokens: Sequence[CaptionToken]) -> dict[int, int]:
    """Find the numbers of steps, one more each; returns the first token of each and one past its last."""
    found: dict[int, int] = {}
    expected, style = 0, ""
    for index in range(len(tokens)):
        if found and index < max(found.values()):
            continue
        marker = _read_marker(tokens, index)
        if marker is None:
            continue
        value, end, this_style = marker
        at_start = index == 0 or tokens[index].begins_line or tokens[index - 1].text in (".", ":", ";")
        fits = at_start if not found else value == expected and this_style == style
        if fits and end < len(tokens):
            found[index], expected, style = end, value + 1, this_style
    is_list = len(found) > 1 or (style in ("digit", "step") and expected == 2)
    return found if is_list else {}


def _read_marker(tokens: Sequence[CaptionToken], index: int) -> tuple[int, int, str] | None:
    """Read the number of a step at an index: its value, one past its last token, and how it is written."""
    words = [token.text.lower() for token in tokens[index : index + 4]] + [""] * 4
    noun = words[0] in _STEP_NOUNS
    opened = words[0] in ("(", "[", "#")
    number = words[1] if noun or opened else words[0]
    end = index + 2 if noun or opened else index + 1
    if noun and number == "#":
        number, end = words[2], index + 3
    closed = end < len(tokens) and tokens[end].text in _MARKS
    if len(number) == 2 and number[1] == "." and number[0].isalpha():  # "B." is one token
        number, closed, end = number[0], True, end - 1
    value, style = _number_value(number, noun)
    if value is None:
        return None
    if noun:
        return value, end + closed, "step" if closed else "bare"
    if closed:
        return value, end + 1, style
    if end < len(tokens) and is_counted(tokens[end].text.lower()):
        return None  # "1 jump, 2 kicks"
    return (value, end, "bare") if number.isdecimal() or opened else None


def _number_value(word: str, is_step: bool) -> tuple[int | None, str]:
    """Read a small number in digits or as a letter, for "Step one" in words too; None for other words."""
    if word.isdecimal() and len(word) <= 2:
        return int(word), "digit"
    if is_step and word in _NUMBER_WORDS:
        return _NUMBER_WORDS[word], "digit"
    if len(word) == 1 and "a" <= word <= "j" and word != "i":
        return ord(word) - ord("a") + 1, "letter"
    return (_ROMAN[word], "roman") if word in _ROMAN else (None, "")


def _bulleted_steps(tokens: Sequence[CaptionToken]) -> dict[int, int]:
    """Find the bullets of steps: signs at the start of the caption or of a line, and the same sign further on."""
    if not tokens or tokens[0].text not in _BULLETS:
        starts = [i for i, token in enumerate(tokens) if token.begins_line and token.text in _BULLETS]
        return {index: index + 1 for index in starts}
    bullet = tokens[0].text
    return {index: index + 1 for index, token in enumerate(tokens) if token.text == bullet}


# Requests: patterns over the lower-case tokens, each with one blank behind it

_GREETING: Final = re.compile(r"(?:(?:hi|hey|hello|ok|okay|please|now|so|well|just|kindly) (?:, )?)*")
_QUESTION: Final = re.compile(
    r"(?:(?:how )?(?:can|could|would|will|should)|how (?:do|does|did)) (?:(?P<reader>you|u|we|i|to) )?"
    r"(?:please |kindly |just |maybe )*|let 's |lets |let us "
)
_WISH: Final = re.compile(
    r"(?:i|we) (?:really )?(?:(?:'d|would) (?:like|love)|want|need|wanna|wish)(?: (?:to )?(?:see|have|watch|get))?"
    r"(?P<reader> you(?: to)?)? "
)
_MAKER: Final = (
    r"(?:make|create|generate|animate|render|produce|draw|show|give|get|simulate|visuali[sz]e|display|depict)"
)
_MEDIA: Final = (
    r"(?:(?:a|an|the|some|one) )?(?:(?:[a-z]+|\d+(?:\.\d+)? ?(?:s|sec|second)?) (?:- )?){0,4}?"
    r"(?:video|clip|animation|movie|gif|scene|sequence|mocap|recording|footage|motion clip|motion capture|motion)"
    r"(?: (?:clip|loop|cycle|file))? (?:of|with|showing|where|in which|that shows|:) "
)
_PERSON: Final = rf"(?:(?:a|an|the|some|two) (?:[a-z]+ ){{0,2}}?(?:{'|'.join(sorted(lexicon.SUBJECT_NOUNS))}) )"
_SHOWN: Final = r"(?:an?|the|some|how|who|what|someone|somebody|him|her|it|them|two|people) "
_SHOW: Final = re.compile(
    rf"(?:{_MAKER} (?:(?:me|us) )?)?{_MEDIA}|{_MAKER} (?:me|us) (?={_SHOWN})"
    rf"|(?:show|depict|imagine|picture|see|watch) (?={_PERSON}|someone |somebody )"
    r"|(?:animate|generate|create|render|produce|simulate|visuali[sz]e) (?=(?:an?|the|some|two|someone|somebody) )"
)
_TELL: Final = re.compile("(?:make|let|have|get|help|imagine|picture) ")


def is_request(leading: str, rest: str) -> bool:
    """Tell whether the words that lead a caption only ask for a motion ("make a clip of | a person walking").

    Both are in lower case, with one blank behind each word.
    """
    words = leading + rest
    greeting = _GREETING.match(words)
    end = greeting.end() if greeting else 0
    for pattern in (_QUESTION, _WISH, _SHOW):
        match = pattern.match(words, end)
        end = match.end() if match is not None else end
    return end == len(leading)


def drop_requests(tokens: list[CaptionToken]) -> list[CaptionToken]:
    """Leave out the wording of a request at the start, and "to" before the verb of who is told to move."""
    text = "".join(token.text.lower() + " " for token in tokens)
    greeting = _GREETING.match(text)
    first = end = greeting.end() if greeting else 0
    is_told = False
    for pattern in (_QUESTION, _WISH):
        match = pattern.match(text, end)
        if match is not None:
            end, is_told = match.end(), match["reader"] is None and not match.group().startswith("let")
    match = _SHOW.match(text, end)
    if match is not None:
        end, is_told = match.end(), False
    match = _TELL.match(text, end)
    if match is not None and _tells_to_move(text[match.end() :].split()[:8]):
        end, is_told = match.end(), True
    rest = tokens[text.count(" ", 0, end) :]
    if end == first == 0 or not rest:
        return tokens
    if is_told:
        rest[0] = rest[0]._replace(is_told=True)
        return _drop_infinitive_mark(rest)
    return rest


def _tells_to_move(words: Sequence[str]) -> bool:
    """Tell whether words begin with somebody and the verb of what they shall do ("the robot | dance")."""
    has_article = words[:1] != [] and words[0] in _ARTICLES
    if words[:1] == [] or not (has_article or words[0] in _PRONOUNS):
        return False
    for index, word in enumerate(words[1:], start=1):
        if word in lexicon.VERBS or word in lexicon.PARTICIPLES or (word in lexicon.FINITE_VERBS and index > 1):
            before = next(w for w in words[index - 1 :: -1] if w not in ("to", "not", "never") and not w.endswith("ly"))
            if before in _PRONOUNS:
                return True
            return has_article and before not in _NO_ACTORS
        if not word.isalpha() and word not in ("'s", "’s"):
            return False
    return False


_ARTICLES: Final = frozenset("a an the my your this that his her our their".split())
_NO_ACTORS: Final = lexicon.EVENT_NOUNS | lexicon.NOUN_ADJECTIVES | lexicon.SIDE_NOUNS | lexicon.BODY_NOUNS | _ARTICLES
_PRONOUNS: Final = frozenset("him her it them me us someone somebody everyone people".split())


def _drop_infinitive_mark(tokens: list[CaptionToken]) -> list[CaptionToken]:
    """Leave out the first "to" among the first words if a verb follows ("i want him | to jump")."""
    for index, token in enumerate(tokens[1:6], start=1):
        if token.text.lower() == "to":
            is_verb = index + 1 < len(tokens) and tokens[index + 1].text.lower() in lexicon.VERBS
            return tokens[:index] + tokens[index + 1 :] if is_verb else tokens
    return tokens


_POLITE: Final = frozenset("please thanks kindly".split())


def drop_politeness(tokens: list[CaptionToken]) -> list[CaptionToken]:
    """Leave out "please" and thanks, and the comma before or behind."""
    if not any(token.text.lower() in _POLITE for token in tokens):
        return tokens
    kept: list[CaptionToken] = []
    for token in tokens:
        if token.text.lower() in _POLITE:
            if kept and kept[-1].text == ",":
                kept.pop()
        elif not (token.text == "," and not kept):
            kept.append(token)
    return kept


_WORDS: Final = "|".join(
    sorted(
        {"w", "n", "had", "clockwise", "ccw", "cw", "counter", "anti", "contra"}
        | _POLITE
        | {word for word in lexicon.ABBREVIATIONS if word.isalpha()}
    )
)
UNUSUAL: Final = re.compile(
    rf"[^A-Za-z ,.']|^ |  |\b(?:{_WORDS}|anticlockwise|counterclockwise|contraclockwise)\b|\b(?:[a-z]|[ivx]{{2,4}})\."
    rf"|\b(?:{'|'.join(_STEP_NOUNS)}) (?:{'|'.join(_NUMBER_WORDS)}|[a-j]|[ivx]{{2,4}})\b"
    r"|\b(?:video|clip|animation|movie|gif|scene|sequence|mocap|recording|footage|motion)\b"
    r"|^(?:hi|hey|hello|ok|okay|now|so|well|just|can|could|would|will|should|how|let|lets|i|we|see|watch|make|create|generate|animate"
    r"|render|produce|draw|show|give|get|simulate|visuali[sz]e|display|depict|imagine|picture|have|help)\b",
    re.IGNORECASE,
)
"""Captions in which `caption_tokens` may change something; the tokens of all others are those of spaCy."""
