"""Read what a sentence asks of the model off its graph: what must happen, what must not, and for how long.

    graph --interpret--> Request(wanted, negated, seconds, notes)

The graph of a clip stays what the user wrote. What is encoded in its place says the same in words that the model knows,
without negations (they are concepts of negative weight, EnergyMoGen Eq. 8) and without lengths (they are options).
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Final

from kinegraph.bundle.manifest import Manifest
from kinegraph.bundle.vocabulary import Vocabulary
from kinegraph.concepts import SPOKEN_NEGATION_WEIGHT, CompositionSpec, Concept, SamplingPlan
from kinegraph.errors import InvalidGraphError
from kinegraph.graph import Action, Argument, SemanticGraph
from kinegraph.interpretation import (
    in_third_person,
    known_subject,
    known_wording,
    split_negations,
    split_sequence,
    with_straight_quotes,
    without_quantity,
    without_request,
)
from kinegraph.limits import MAX_NODES
from kinegraph.options import GenerateOptions
from kinegraph.text.lexicon import WORDINGS
from kinegraph.text.narration import THEN
from kinegraph.text.quantities import Quantity, Unit, read_quantities
from kinegraph.text.turns import Turn, read_turn
from kinegraph.text.vocabulary import is_shown

STANDING: Final = SemanticGraph(
    "a person stands still",
    (Action("stands", 9, 15, 0, arguments=(Argument("ARGM-MNR", "still", 16, 21),)),),
)
"""What is wanted where a sentence only says what must not happen."""
NEVER_STOOD: Final = "this bundle was never shown anybody who stands still; what comes nearest is made"
"""Note for such a sentence, where the bundle does not know how to stand."""
AT_ONCE: Final = (
    "the actions follow one another but are made at once here, as something is held: one of them may not happen; "
    "`generate_timeline` makes them one by one, under constraints too"
)
"""Note for such a sentence with constraints, or in an edit."""
TOO_SHORT_IN_ORDER: Final = (
    "the actions follow one another but are made at once, for the clip is too short for them one by one: one of them "
    "may not happen; ask for a longer one"
)
"""Note for such a sentence, where the call gives the length."""
IN_ONE_INTERVAL: Final = (
    "the actions of one interval follow one another but are made at once: one of them may not happen; give each an "
    "interval of its own"
)
"""Note for such a sentence in a timeline of several intervals."""
TURNS_ARE_FREE: Final = (
    "how far a turn goes is not held where several texts are sampled in one run of skeleton space; it may go further"
)
"""Note for sentences that say it, in a timeline or a sequence by energy."""
MANY: Final = 3
"""Concepts at once that one run seldom makes."""
MANY_AT_ONCE: Final = (
    "so much at once seldom all happens in one run; `compose` with the method 'parts' makes each with its part of the "
    "body"
)
"""Note for compositions of so many, and for sentences of both hands that are not made of each action alone."""
_THEN: Final = re.compile(rf"\b(?:{'|'.join(sorted(THEN))})\b", re.IGNORECASE)
"""Words of `narration.THEN`: a quick look, too."""
_WORD: Final = re.compile(r"[^\W_]+")
_JOINING: Final = frozenset(
    ["a", "an", "and", "as", "before", "he", "it", "person", "she", "the", "then", "they", "while"]
)
"""Words that need no node of their own."""
_DISTANCE: Final = re.compile(
    r"\b(?:\d+(?:[.,]\d+)? ?(?:m|ft|feet|foot|km)"
    r"|(?:\d+(?:[.,]\d+)?|an?|one|two|three|four|five|six|seven|eight|nine|ten)"
    r" (?:(?:kilo)?met(?:er|re)s?|yards?|miles?))\b"
    r"(?! ?(?:long|wide|high|tall|away|apart|behind|/|per\b|an? (?:sec|hou)))",
    re.IGNORECASE,
)
"""How far somebody goes."""
_SPEED: Final = re.compile(
    r"\b\d+(?:[.,]\d+)? ?(?:(?:k?m|met(?:er|re)s?|miles?|feet) ?(?:/|per |an? )(?:s|h|second|hour)|km/?h|mph)\b",
    re.IGNORECASE,
)
_PLACE: Final = re.compile(r"\(\s*-?\d+(?:\.\d+)?\s*,\s*-?\d+(?:\.\d+)?\s*(?:,\s*-?\d+(?:\.\d+)?\s*)?\)")
_FACE: Final = re.compile(r"\b(?:smil|frown|grin|wink|blink)(?:s|e|es|ing|ning|ed)?\b", re.IGNORECASE)
_STAIRS: Final = re.compile(
    r"\b(?:up|down|climb\w*)(?: up| down)? (?:a |the |some )?(?:stairs?|staircase|ladder|steps)\b", re.IGNORECASE
)
_WIDE_TURN: Final = re.compile(r"\b(?:7[2-9][1-9]|7[3-9]\d|[89]\d\d|\d{4,}) ?(?:degrees?\b|°)", re.IGNORECASE)
_NOT_HELD: Final = (
    (_DISTANCE, "how far somebody goes is not held; give a `Path`, or the seconds that it takes"),
    (_SPEED, "how fast somebody goes is not held; say slowly or fast"),
    (_PLACE, "places in words are not held; give a `Waypoint`"),
    (_FACE, "a clip has no face"),
    (_STAIRS, "a clip has no stairs: the feet go as if there were some, and leave the floor"),
    (_WIDE_TURN, "turns of more than 720 degrees are not held"),
)
"""What of a sentence the body does not show, and what to do instead."""
_HAND: Final = re.compile(r"\b(left|right) (?:hand|arm|fist|wrist|elbow|forearm)\b", re.IGNORECASE)
_GESTURE: Final = re.compile(r"(?:wav|clap|point|salut|beckon|applaud)\w*", re.IGNORECASE)
"""Verbs of hands and arms."""
_MOVING: Final = re.compile(r"(?:rais|lift|hold|put|stretch|extend|spread|swing)\w*", re.IGNORECASE)
"""Verbs that are of hands and arms where they name them."""
_ARMS: Final = re.compile(r"\b(?:(left|right) )?(hand|arm)(s?)\b", re.IGNORECASE)
SECONDS_PER_STEP: Final = 0.55
"""Length that one step of a walk takes."""
_TOLD: Final = re.compile(r"(?:an?|the|one|some(?:one|body)|he|she|it|they)\b", re.IGNORECASE)
"""Beginnings of sentences in the third person, which most captions have: a quick look before words are read."""
_KNOWN_SUBJECT: Final = re.compile(
    r"(?:(?:an?|the) (?:person|man|woman|figure|human|guy|character|actor|player)|some(?:one|body))\b", re.IGNORECASE
)
"""Beginnings of sentences about somebody whom training captions name: a quick look, too."""
_TURNING: Final = re.compile(
    r"turn|rotat|pivot|swivel|veer|swerve|spin|twirl|whirl|revolv|about[ -]?face|bend|curve|circle|\bring\b"
    r"|\b(?:180|270|360)\b",
    re.IGNORECASE,
)
"""Words of turns: a quick look, too."""
_WORDINGS: Final = re.compile("|".join(pattern for pattern, _ in WORDINGS), re.IGNORECASE)


@dataclass(frozen=True)
class Request:
    """What one sentence asks of the model."""

    graph: SemanticGraph
    """As the user wrote it."""
    wanted: SemanticGraph
    """What must happen, in words that the model was shown."""
    negated: tuple[SemanticGraph, ...] = ()
    """What must not happen."""
    seconds: float | None = None
    """Length that the sentence asks for, within what the bundle can do; None if the caller gave one."""
    turn: Turn | None = None
    """How far the body is to turn."""
    is_timed: bool = False
    """Whether the sentence says how long it takes, or an action of it."""
    notes: tuple[str, ...] = ()
    """What the sentence asks for and does not get."""

    @property
    def plan(self) -> SamplingPlan:
        """Graphs and weights to sample from."""
        return SamplingPlan.for_graph(self.wanted, self.negated)


def interpret(
    graph: SemanticGraph, manifest: Manifest, vocabulary: Vocabulary | None = None, seconds: float | None = None
) -> Request:
    """Read a graph.

    Args:
        graph: of a sentence.
        manifest: of the bundle, whose limits hold.
        vocabulary: of the bundle; without one all words count as known.
        seconds: length that the caller gave, which goes before that of the sentence.

    Raises:
        InvalidGraphError: what is left of the graph cannot be put in words.
    """
    notes: list[str] = []
    lengths: dict[int, tuple[Unit, float]] = {}  # by action
    wanted = graph
    quantities = read_quantities(graph)
    for quantity in quantities:
        length, note = _spoken_seconds(quantity, manifest)
        notes += [] if note is None or (seconds is not None and quantity.unit != "times") else [note]
        if length is not None:
            _note_length(lengths, quantity, length)
    notes += [f"{found.group()!r}: {told}" for pattern, told in _NOT_HELD for found in pattern.finditer(graph.caption)]
    notes += _parts_left_out(graph)
    for quantity in reversed(quantities):
        if quantity.unit != "steps":  # captions of training name steps
            wanted = _without(wanted, quantity)
    positive: SemanticGraph | None = wanted
    negated: list[SemanticGraph] = []
    if any(action.negated for action in graph.actions):
        positive, negated = split_negations(wanted)
    if positive is None:
        notes.append("the sentence only says what must not happen; the person is asked to stand still")
        positive = STANDING
    spoken = min(_total_seconds(graph, lengths), manifest.seconds_limits[1]) if lengths else None
    return Request(
        graph,
        _as_trained(positive, vocabulary),
        tuple(_as_trained(part, vocabulary) for part in negated),
        spoken if seconds is None else None,
        turn_of([graph]),
        bool(lengths),
        tuple(notes),
    )


def _parts_left_out(graph: SemanticGraph) -> list[str]:
    """Tell what of a long sentence has no node, as a graph has room for `MAX_NODES` (`text.parser.build_graph`)."""
    if graph.node_count < MAX_NODES:
        return []
    end = max((node.end for action in graph.actions for node in action.arguments), default=0)
    later = {action.start for action in graph.actions if action.start >= end}
    words = [found for found in _WORD.finditer(graph.caption, end) if found.start() not in later]
    if all(found.group().lower() in _JOINING for found in words):
        return []
    first = next(found for found in words if found.group().lower() not in _JOINING)
    return [
        f"the sentence has more parts than the {MAX_NODES - 1} that are read: those from {first.group()!r} on, at "
        f"character {first.start() + 1}, are left out, but for the actions; say it in several sentences"
    ]


def _note_length(lengths: dict[int, tuple[Unit, float]], quantity: Quantity, length: float) -> None:
    """Note the length of an action: its seconds before its steps, and of steps all ("two steps left, one back")."""
    unit, noted = lengths.get(quantity.action, (quantity.unit, 0.0))
    if unit == quantity.unit == "steps":
        lengths[quantity.action] = unit, noted + length
    elif quantity.action not in lengths or unit == "steps":
        lengths[quantity.action] = quantity.unit, length


def _total_seconds(graph: SemanticGraph, lengths: Mapping[int, tuple[Unit, float]]) -> float:
    """Add up what follows one another, and take the longest of what happens at once."""
    each = [length for _, length in lengths.values()]
    return sum(each) if len(each) > 1 and len(split_in_order(graph)) > 1 else max(each)


@dataclass(frozen=True)
class AskedComposition:
    """What the sentences of a composition ask for."""

    spec: CompositionSpec
    """With what the sentences negate among the negated concepts."""
    graphs: tuple[SemanticGraph, ...]
    """Of its `texts`, in words that the model was shown."""
    seconds: float | None
    """The longest length that a sentence asks for; None if none does, or the caller gave one."""
    turn: Turn | None
    notes: tuple[str, ...]


def interpret_composition(
    spec: CompositionSpec,
    graphs: Sequence[SemanticGraph],
    manifest: Manifest,
    vocabulary: Vocabulary | None = None,
    seconds: float | None = None,
) -> AskedComposition:
    """Read the sentences of a composition, each as `interpret` does.

    What a sentence negates must not happen beside the others either: it is one more negated concept (Eq. 8), once.

    Args:
        spec: what is composed.
        graphs: of its `texts`, as the user wrote them.
        manifest, vocabulary, seconds: as in `interpret`.

    Raises:
        InvalidGraphError: see `interpret`.
    """
    count = len(spec.concepts)
    weights = [
        *(concept.weight for concept in spec.concepts),
        *(1.0 for _ in graphs[count : len(graphs) - len(spec.negated)]),
        *(concept.weight for concept in spec.negated),
    ]
    wanted, negated, lengths, notes = [], dict[str, SemanticGraph](), [], list[str]()
    for graph, weight in zip(graphs, weights, strict=True):
        request = interpret(graph, manifest, vocabulary, seconds)
        if weight < 0 and request.negated:  # what must not happen, and negates something: as it is
            wanted.append(graph)
            continue
        wanted.append(request.wanted)
        if weight > 0:
            lengths += [] if request.seconds is None else [request.seconds]
            notes += request.notes
            for unwanted in request.negated:
                negated.setdefault(unwanted.caption, unwanted)
    more = tuple(Concept(unwanted, SPOKEN_NEGATION_WEIGHT) for unwanted in negated.values())
    asked = replace(spec, negated=(*spec.negated, *more), partial=(*spec.partial, *(True for _ in more)))
    turn = turn_of(graphs[:count], weights[:count])
    told = tuple(dict.fromkeys(notes))
    return AskedComposition(asked, (*wanted, *negated.values()), max(lengths, default=None), turn, told)


def parts_hands(graph: SemanticGraph) -> bool:
    """Tell whether one action of a graph is for the left hand and another for the right.

    Seldom do both happen in one run, as training joined few such pairs: of sentences of walking, a raised and a waving
    hand 5 % had all of it, and have 84 % where actions are sampled alone (`kinegraph_benchmarks.quality.composition`).
    """
    verbs = [action.start for action in graph.actions]

    def sides(action: Action) -> set[str]:  # an argument with a verb in it ("while waving") is another action's
        own = [node for node in action.arguments if not any(node.start <= verb < node.end for verb in verbs)]
        return {side.lower() for node in own for side in _HAND.findall(node.text)}

    acting = [action for action in graph.actions if not action.negated and action.weight > 0]
    one_sided = [side for side in map(sides, acting) if len(side) == 1]
    return len(set().union(*one_sided)) == 2


def of_separate_parts(graphs: Sequence[SemanticGraph]) -> bool:
    """Tell whether at most one of several graphs is for more than hands and arms, and no hand is for two of them."""
    arms = [_arms_of(graph) for graph in graphs]
    taken = [side for sides in arms if sides is not None for side in sides]
    return sum(sides is None for sides in arms) <= 1 and len(taken) == len(set(taken))


def _arms_of(graph: SemanticGraph) -> frozenset[str] | None:
    """Return the sides of the arms that a graph is for; None if it is for more than arms."""
    sides: set[str] = set()
    if not graph.actions or any(action.negated for action in graph.actions):
        return None
    for action in graph.actions:
        named = [found for node in action.arguments for found in _ARMS.finditer(node.text)]
        if not (_GESTURE.fullmatch(action.text) or (named and _MOVING.fullmatch(action.text))):
            return None
        own = {found[1].lower() for found in named if found[1] and not found[3]}
        sides |= own or {"left", "right"}
    return frozenset(sides)


def turn_of(graphs: Sequence[SemanticGraph], weights: Sequence[float] | None = None) -> Turn | None:
    """Read how far a body turns that does all of some graphs; None if they do not say, or say several things.

    Args:
        graphs: of what happens at once.
        weights: of the graphs: the heavier, the later a turn is held back whose size is not said, and below 0 it does
            not count; None is 1 for each.
    """
    turns = set()
    for graph, weight in zip(graphs, weights or [1.0] * len(graphs), strict=True):
        turn = read_turn(graph) if weight > 0 and _TURNING.search(graph.caption) else None
        if turn is not None:
            turns.add(turn if turn.is_said else replace(turn, degrees=weight * turn.degrees))
    return turns.pop() if len(turns) == 1 else None


def _spoken_seconds(quantity: Quantity, manifest: Manifest) -> tuple[float | None, str | None]:
    """Turn a length or count in words into seconds, and tell what the bundle cannot do of it."""
    shortest, longest = manifest.seconds_limits
    if quantity.unit == "times":
        return None, f"{quantity.text!r}: how often something happens is not counted; `sequence` repeats a sentence"
    is_steps = quantity.unit == "steps"
    wanted = (quantity.number + 1) * SECONDS_PER_STEP if is_steps else quantity.number
    if shortest <= wanted <= longest:
        return wanted, None
    made = min(max(wanted, shortest), longest)
    how = "`sequence` makes longer clips of several sentences" if wanted > longest else "loop or cut it"
    return made, f"{quantity.text!r}: a sentence has {shortest:g} to {longest:g} seconds, this one {made:g}; {how}"


def _as_trained(graph: SemanticGraph, vocabulary: Vocabulary | None) -> SemanticGraph:
    """Tell a graph as captions of training are told: in the third person, in words that they have.

    A graph that has no room left for the words stays as it is.
    """
    if not graph.caption.isascii():
        graph = with_straight_quotes(graph)
    with suppress(InvalidGraphError):
        if not _starts_with_node(graph):
            graph = without_request(graph)
    with suppress(InvalidGraphError):
        if _TOLD.match(graph.caption) is None:
            graph = in_third_person(graph)
    with suppress(InvalidGraphError):
        if _WORDINGS.search(graph.caption):
            graph = known_wording(graph)
    with suppress(InvalidGraphError):
        if _KNOWN_SUBJECT.match(graph.caption) is None:
            graph = known_subject(graph, lambda word: vocabulary is None or is_shown(word, vocabulary))
    return graph


def _starts_with_node(graph: SemanticGraph) -> bool:
    """Tell whether a caption begins with an action or its argument, as most do: a quick look, too."""
    starts = [node.start for action in graph.actions for node in action.arguments]
    return 0 in (*starts, *(action.start for action in graph.actions))


def _without(graph: SemanticGraph, quantity: Quantity) -> SemanticGraph:
    """Remove a quantity's words; a graph of whose actions they are a part ("three jumps") stays as it is."""
    try:
        return without_quantity(graph, quantity)
    except InvalidGraphError:
        return graph


def split_in_order(graph: SemanticGraph) -> list[SemanticGraph]:
    """Split a graph whose actions follow one another into parts to be made one by one.

    Sampled at once, "walks forward, then bows" bows in none of ten clips of 8 s, and walks in none of 4 s (studio
    0.7.0); made of its parts it does both in all (`kinegraph_benchmarks.quality.wording`, studio 0.8.0).

    Args:
        graph: as the user wrote it.

    Returns:
        The parts, or the graph alone if it is to be sampled at once.
    """
    return [graph] if len(graph.actions) < 2 and _THEN.search(graph.caption) is None else split_sequence(graph)


def share_frames(total: int, own: Sequence[GenerateOptions], manifest: Manifest) -> list[GenerateOptions]:
    """Share the frames of a clip among its parts, in proportion to the length that each of them asks for.

    Args:
        total: frames of the clip, at least the fewest of a part for each of them.
        own: options of the parts, each with the length that its sentence asks for.
        manifest: of the bundle.
    """
    if total == sum(part.frames for part in own):
        return list(own)
    least = manifest.frames.min
    spare = total - least * len(own)
    weights = [max(part.frames - least, 1) for part in own]
    ends = [round(spare * sum(weights[: index + 1]) / sum(weights)) for index in range(len(own))]
    shares = [end - begin + least for begin, end in zip([0, *ends[:-1]], ends, strict=True)]
    return [
        replace(part, frames=frames, seconds=frames / manifest.fps) for part, frames in zip(own, shares, strict=True)
    ]
