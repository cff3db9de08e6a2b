"""Word lists of the parser: verbs of motion, and how captions name manners, directions, places and times.

"Manner" is PropBank's role ARGM-MNR."""

from __future__ import annotations

from typing import Final

STRAIGHT: Final = {"’": "'", "‘": "'", "ʼ": "'", "“": '"', "”": '"', "º": "°"}
"""Signs as telephones and word processors write them, and what captions of training have for them."""

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

ENDING: Final = frozenset("stop quit cease avoid refrain".split())
"""Verbs after which the participle behind them does not happen ("stops walking")."""
KEEPING: Final = frozenset("keep hold leave".split())
"""Verbs that negate raising where their object stays down ("keeps the hands down")."""
NEGATORS: Final = frozenset("not n't nt never without no neither nor cannot".split())
"""Words that negate the verb behind them."""
CATENATIVE: Final = ENDING | frozenset("start begin continue keep finish like love enjoy practise practice".split())
"""Verbs whose object is the participle behind them ("starts walking")."""

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

NEVER_VERBS: Final = (DIRECTION_ADVERBS - {"left"}) | frozenset("circle reverse clockwise side sides".split())
"""Words that the tagger sometimes takes for verbs, although captions use them as nouns and adverbs."""

VERBS: Final = EVENT_NOUNS - frozenset("greeting movement motion rotation".split()) | frozenset(
    "advance aim amble applaud approach arise arrange arrive ascend attack avoid backpedal bash bask beckon begin"
    " bite blink block bob bounce bound box brace breakdance breaststroke breathe brush bump butt caress carry cast"
    " cease charge chase cheer chew chop circle clamber clasp clean clear clench close clutch collapse comb come"
    " compensate continue cook cough crack cradle crank creep cross crouch cry cuddle curl curtsey curtsy cycle dab"
    " dart deal defend depart descend dig dismount dive do dodge drag draw dress dribble drill drink drive drop duck"
    " dust eat embrace enter escape evade examine exhale exit extend faint fake falter feed feint fetch fidget fight"
    " finish flail flap flee flex flinch fling flop fold follow freeze frown gallop gather gaze glance glide go grab"
    " grasp greet grin grip guard guide gyrate hail halt hammer handspring hang haul heave hesitate hide hike hiss hit"
    " hobble hoist hold hover hug hula hunch hurdle hurl hurry inch indicate inhale inspect jab jerk jig jiggle juggle"
    " keep kiss knead knit land lash laugh lay lead leave lick lie limbo linger listen load lock look loosen lounge"
    " lower lug lumber lurch make meander meditate mime mimic mince moonwalk mop mope mosey mount move nudge open"
    " paddle paint pant parry pass pat pause pedal peek peer perch perform pet pick pinch pitch pivot place plank play"
    " plod plop plunge poke pose pounce pour prance pray press pretend proceed pummel put quit rake react read rebound"
    " receive recline recoil recover reel refrain regain relax release remain respond rest retreat return revolve ride"
    " ring rise roam rotate row rub rummage rush sashay saunter saw scamper scoot scramble scratch scream screw scuff"
    " scurry search seek serve set shadow shadowbox shamble shave shield shift shimmy shiver shoot shout shovel show"
    " shudder shut sidestep sidle sign signal sing sink sip skate skateboard ski skid slam slap sleep sling slink slip"
    " slither slouch slow slump smash smile smoke snap snatch sneak sneeze sniff snowboard soar sob sow spar speak"
    " speed splash sprawl spread spring squash squeeze squint squirm stab stack stagger stalk stare steer stir stomp"
    " stoop straddle straighten strain strike stroke struggle strum strut stutter surf swagger swallow swat sway sweep"
    " swerve swim swipe swish swivel tackle take talk tango teeter text thrash thrust thump tickle tilt toddle topple"
    " toss totter touch traipse tramp trample tread trek tremble trip trudge try tuck tug tumble twerk twiddle twist"
    " twitch type unclench uncross uncurl undress unfold unload unlock untie unwrap unzip uppercut use vault vibrate"
    " waddle wade wail wait wake wander ward wash watch wear weave whack whip whirl whistle wiggle wince wink wipe"
    " wobble wrap wrestle wriggle wring write writhe yank yawn yell zigzag zip".split()
)
"""Verbs of motion, base forms."""


def third_person(verb: str) -> str:
    """Put a verb in base form into the third person singular of the present."""
    if verb in ("be", "have"):
        return {"be": "is", "have": "has"}[verb]
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


PARTICIPLES: Final = {_participle(verb): verb for verb in sorted(VERBS)}
"""Present participle to base form."""
FINITE_VERBS: Final = {third_person(verb): verb for verb in sorted(VERBS) if verb != "do"}
"""Third person to base form; without "does", which is as often an auxiliary."""

IRREGULAR_FORMS: Final = {
    "went": "go", "gone": "go", "ran": "run", "took": "take", "taken": "take", "stood": "stand", "sat": "sit",
    "fell": "fall", "fallen": "fall", "threw": "throw", "thrown": "throw", "caught": "catch", "swung": "swing",
    "bent": "bend", "knelt": "kneel", "leapt": "leap", "spun": "spin", "rose": "rise", "risen": "rise", "lay": "lie",
    "held": "hold", "kept": "keep", "made": "make", "did": "do", "done": "do", "got": "get", "came": "come",
    "gave": "give", "given": "give", "left": "leave", "crept": "creep", "slid": "slide", "struck": "strike",
    "swam": "swim", "dove": "dive", "drew": "draw", "shook": "shake", "shaken": "shake", "strode": "stride",
    "was": "be", "were": "be", "are": "be", "am": "be", "been": "be", "had": "have", "brought": "bring",
    "worn": "wear", "hung": "hang",
}  # fmt: skip
"""Irregular past forms of verbs of motion, with their base form."""
PAST_PARTICIPLES: Final = frozenset(
    "hit taken fallen thrown caught bent held kept made done given shaken struck put".split()
)
"""Irregular participles of the passive voice."""

CONFUSED: Final = {"waive": "wave", "waives": "waves", "waiving": "waving", "quater": "quarter"}
"""English words that are spelling slips in a caption, with their correction."""

ABBREVIATIONS: Final = {
    "w/o": "without", "fwd": "forward", "bwd": "backward", "bkwd": "backward", "thru": "through", "pls": "please",
    "plz": "please", "thx": "thanks", "ppl": "people", "sec": "second", "secs": "seconds", "ur": "your", "yr": "your",
}  # fmt: skip
"""Short forms of words, with the words that they stand for."""

CLOCKWISE: Final = "clockwise"
COUNTERCLOCKWISE: Final = "counterclockwise"
WORDINGS: Final = (
    (r"\b(?:(?:counter|anti|contra)[\s‐‑–-]*clock-?wise|ccw)\b", COUNTERCLOCKWISE),
    (r"\b(?:clock-?wise|cw)\b", CLOCKWISE),
    (r"\bw/o\b", "without"),
    (r"\bw/|(?<=\s)w(?=\s)", "with"),
    (r"(?<=\s)[&+](?=\s)", "and"),
    (r"\bfwd\b", "forward"),
    (r"\bb[k]?wd\b|\bbackwards\b", "backward"),
)
"""Spellings that training captions have seldom or never, as patterns, with the word for each.

Of those that overlap the first counts.

`kinegraph.interpretation.known_wording` tells the rotations as sides: clockwise, seen from above, is to the right.
"""
ROTATIONS: Final = frozenset((CLOCKWISE, COUNTERCLOCKWISE))
NOUN_ADJECTIVES: Final = frozenset(
    "fast slow slower quick high low big small little long short half quarter couple double single triple hard soft"
    " front side back jumping spinning several two three four five six seven eight nine ten many few more some no"
    " any".split()
)
"""Words before a noun of motion, so that a plural behind them is no verb ("high kicks")."""
POSTURES: Final = frozenset(
    "up down out apart together wide high low straight overhead crossed raised lowered bent extended outstretched"
    " stretched folded clasped open closed sideways forward back".split()
)
"""Words behind a part of the body that say how it is held ("with both arms up")."""
STATE_ADJECTIVES: Final = frozenset(
    "old young tall small big single same other opposite whole entire upper lower slightly fully bare".split()
)
"""Words between an article and a body part or a person."""

PERSON_NOUNS: Final = frozenset("human subject humanoid avatar".split())
"""Words for the person who moves that the tagger takes for adjectives or names."""
SUBJECT_NOUNS: Final = PERSON_NOUNS | frozenset(
    "person man woman someone somebody figure character individual child boy girl guy lady player dancer people actor"
    " kid adult athlete he she it they".split()
)
BODY_PLURALS: Final = frozenset(
    "arms hands legs feet knees elbows heads shoulders hips fists fingers heels toes ankles wrists eyes palms thighs"
    " forearms".split()
)
BODY_NOUNS: Final = BODY_PLURALS | frozenset(
    "arm hand leg foot knee elbow head body shoulder hip fist finger back chest torso neck waist heel toe ankle wrist"
    " face eye chin palm mouth belly thigh forearm upperbody".split()
)

VOCABULARY: Final = (
    VERBS
    | frozenset(FINITE_VERBS)
    | frozenset(PARTICIPLES)
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
