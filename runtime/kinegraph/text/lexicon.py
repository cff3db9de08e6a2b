"""Word lists of the parser: verbs of motion, and how captions name manners, directions, places and times.

"Manner" is PropBank's role ARGM-MNR."""

from __future__ import annotations

from typing import Final

UNACCUSATIVE: Final = frozenset(
    "turn stand rise stop fall stumble rotate spin move bend lean trip slip balance sway roll remain stay start begin"
    " end finish happen collapse sit lie kneel slide".split()
)
"""Verbs whose subject undergoes the motion: ARG1 in PropBank, unless they take an object."""

TRANSITIVE: Final = frozenset(
    "raise lower lift bend stretch open close push pull move swing wave cross hold shake clap rub touch grab pick drop"
    " throw catch kick".split()
)
"""Verbs that share the object of a verb they are coordinated with ("raises and lowers the hand")."""

STATIVE: Final = frozenset("look seem appear feel be remain become sound".split())
"""Verbs of a state instead of a motion."""

TRAVEL: Final = frozenset("go come return get rise climb descend".split())
"""Verbs with a start (ARG3) and a goal (ARG4)."""
TRAVEL_ON: Final = frozenset(
    "walk run go climb jog step move jump hop come crawl march stroll sneak slide sprint".split()
)
"""Verbs that go "up a slope" or "down the stairs"; with other verbs, "up" is a particle ("lifts up a box")."""
TRANSFER: Final = frozenset(
    "put place pick take give wipe hold lean kick throw stretch tie tap hand bring push shove".split()
)
"""Verbs with a recipient or a place of what is moved (ARG2)."""

MANNER_NOUNS: Final = frozenset(
    "way manner fashion style mood speed pace energy joy pride confidence fatigue vigor spirit effort ease care force"
    " rage anger hurry mannerism language attitude heart rhythm caution tempo step arm hand leg foot knee elbow head"
    " body shoulder hip fist finger back posture stance speed gait strength power".split()
)
"""Objects that make a prepositional phrase one of manner ("with energy", "with the right hand")."""

DIRECTION_PREPOSITIONS: Final = frozenset(
    "to toward towards into onto from through across around along past up down off out forward backward away over"
    " round".split()
)
PLACE_PREPOSITIONS: Final = frozenset(
    "on under above below behind near beside between inside outside within against among beneath upon next in at"
    " front".split()
)
TIME_PREPOSITIONS: Final = frozenset("after before during until while since for throughout once when".split())
MANNER_PREPOSITIONS: Final = frozenset("with without like as by of via".split())

TIME_NOUNS: Final = frozenset("second minute hour moment time while beginning end start once twice times".split())
WAYS: Final = frozenset("way manner fashion style mood speed pace rage spirit".split())
"""Nouns of "in a ... way"."""
CIRCLE_NOUNS: Final = frozenset(
    "circle line curve square arc zigzag triangle path loop pattern semicircle spiral".split()
)
"""Nouns that name the shape of a path ("walks in a circle")."""
SIDE_NOUNS: Final = frozenset("left right side front back direction clockwise counterclockwise forward".split())

DIRECTION_ADVERBS: Final = frozenset(
    "forward forwards backward backwards back left right up down away around ahead sideways straight out in over off"
    " upward upwards downward downwards leftward leftwards rightward rightwards clockwise counterclockwise"
    " anticlockwise inward outward diagonally round through across along aside sideward onward onwards".split()
)
TIME_ADVERBS: Final = frozenset(
    "then now afterwards afterward first finally next again once twice later before after meanwhile still immediately"
    " subsequently shortly always soon simultaneously thrice eventually already".split()
)
MANNER_ADVERBS: Final = frozenset("fast hard well slow quick together alone better faster slower high low wide".split())
PLACE_ADVERBS: Final = frozenset("here there somewhere overhead nearby outside inside home everywhere".split())
OTHER_ADVERBS: Final = frozenset("slightly almost about approximately nearly only just little bit further far".split())
DISCOURSE_ADVERBS: Final = frozenset("also maybe perhaps probably actually instead however though even too so".split())

TIME_MARKERS: Final = frozenset("while when after before until once whenever till as".split())

EVENT_NOUNS: Final = frozenset(
    "walk run jog jump hop kick punch wave bow turn spin step cartwheel handstand squat lunge dance throw catch swing"
    " stumble fall stretch waltz crawl push pull backflip flip somersault leap skip march sprint dash roll rotation"
    " pirouette salute clap greeting gesture nod shrug stride slash lift raise stroll pace knock tap movement motion"
    " stand sit kneel climb trot limp shuffle twirl tiptoe balance stop start bend lean reach point shake".split()
)
"""Nouns that name a motion, and verbs that taggers take for nouns in short captions."""

GET: Final = frozenset("get gets getting got".split())
"""Forms of "get", an action of its own in "gets pushed"."""

NEVER_VERBS: Final = (DIRECTION_ADVERBS - frozenset(("left",))) | frozenset(("circle", "reverse", "clockwise"))
"""Words that the tagger sometimes takes for verbs, although captions use them as nouns and adverbs."""

VERBS: Final = EVENT_NOUNS - frozenset("greeting movement motion rotation".split()) | frozenset(
    "raise lower pick put carry hold take make do perform go come crouch duck dive drop flap flex gallop glide"
    " grab hang hit hug hurry land lie look move open close paddle pass pat play pretend pull rest rise return rub"
    " rush sneak scratch sidestep sink slap slip slow smash squeeze stagger stalk stomp straighten strike stroke"
    " strut sway sweep tilt touch toss tread trip trudge twist unfold use wander wiggle wipe wobble wriggle yawn"
    " zigzag begin continue keep cross dodge draw drag drink eat evade gesture grasp guide juggle march mimic"
    " mince mope pivot press reach recover rotate scoot show skate ski sling snap splash spread squat stir stoop"
    " stroll struggle stumble swim swing tap wave weave fold nod clasp circle walk flail gather greet hail hobble"
    " inch lurch mime pant plod pose prance relax retreat saunter slump tiptoe traipse tumble waddle whirl wince"
    " leave lead try drive swipe flinch fling bounce brush box fight shadowbox hula sit sprint catch wade"
    " compensate".split()
)
"""Verbs of motion, base forms."""


def _third_person(verb: str) -> str:
    if verb.endswith(("s", "sh", "ch", "x", "z", "o")):
        return verb + "es"
    return verb[:-1] + "ies" if verb.endswith("y") and verb[-2] not in "aeiou" else verb + "s"


def _participle(verb: str) -> str:
    if verb.endswith("ie"):
        return verb[:-2] + "ying"
    if verb.endswith("e") and not verb.endswith("ee"):
        return verb[:-1] + "ing"
    doubled = verb[-1] in "bdgmnprt" and verb[-2] in "aeiou" and verb[-3:-2] not in tuple("aeiou") and len(verb) < 6
    return verb + verb[-1] + "ing" if doubled else verb + "ing"


FINITE_VERBS: Final = {_third_person(verb): verb for verb in sorted(VERBS) if verb != "do"}
"""Third person to base form; without "does", which is as often an auxiliary."""

CONFUSED: Final = {"waive": "wave", "waives": "waves", "waiving": "waving", "quater": "quarter"}
"""English words that are spelling slips in a caption, with their correction."""

ROTATIONS: Final = frozenset("clockwise counterclockwise anticlockwise counter-clockwise anti-clockwise".split())

PERSON_NOUNS: Final = frozenset("human subject humanoid avatar".split())
"""Words for the person who moves that the tagger takes for adjectives or names."""
SUBJECT_NOUNS: Final = PERSON_NOUNS | frozenset(
    "person man woman someone somebody figure character individual child boy girl guy lady player dancer people actor"
    " kid adult athlete he she it they".split()
)
BODY_NOUNS: Final = frozenset(
    "arm hand leg foot knee elbow head body shoulder hip fist finger back arms hands legs feet knees elbows heads"
    " shoulders hips fists fingers chest torso neck waist heel heels toe toes ankle wrist face".split()
)

VOCABULARY: Final = (
    VERBS
    | frozenset(FINITE_VERBS)
    | frozenset(_participle(verb) for verb in VERBS)
    | EVENT_NOUNS
    | SUBJECT_NOUNS
    | BODY_NOUNS
    | DIRECTION_ADVERBS
    | CIRCLE_NOUNS
    | SIDE_NOUNS
    | WAYS
    | TIME_MARKERS
    | DIRECTION_PREPOSITIONS
    | frozenset(
        "both with without their then again slowly quickly fast slightly happily sadly angrily proudly tiredly wearily"
        " energetically calmly carefully sharply suddenly abruptly gently softly briskly timidly nervously gracefully"
        " smoothly backwardly repeatedly several steps times degrees meters quarter small large high clockwise"
        " counterclockwise another person persons while position object something ground floor".split()
    )
)
"""Words that spelling correction may choose."""
