"""The words from which caption paraphrases are made: what is done (by content) and how (by style)."""

from __future__ import annotations

from dataclasses import dataclass

from motiongen_ardy.data.derived_phrases import PLAIN, SIDED

SUBJECTS = ("a person", "the person", "someone", "a character", "the character")


@dataclass(frozen=True)
class Manner:
    """How something is done. adjectives precede the subject, adverbials follow the action."""

    adjectives: tuple[str, ...] = ()
    adverbials: tuple[str, ...] = ()


_TIRED = Manner(("tired", "weary", "exhausted"), ("tiredly", "wearily", "as if exhausted", "in a tired way"))
_OLD = Manner(("old", "elderly"), ("like an old person", "the way an elderly person would", "as if old"))
_MASCULINE = Manner(("masculine",), ("in a masculine way", "with masculine movements"))

# A style without manner ("normal", and "none" for clips that were not acted in a style) gets plain captions.
MANNERS: dict[str, Manner] = {
    "normal": Manner(),
    "none": Manner(),
    "active": Manner(("energetic", "lively", "active"), ("energetically", "with a lot of energy", "in a lively way")),
    "angry": Manner(("angry",), ("angrily", "in an angry way")),
    "childish": Manner(("childish", "childlike"), ("like a child", "childishly")),
    "chimpira": Manner(("thuggish",), ("like a street punk", "like a young thug", "in a thuggish way")),
    "elderly": _OLD,
    "exhausted": _TIRED,
    "feminine": Manner(("feminine",), ("in a feminine way", "with feminine movements")),
    "giant": Manner(("giant",), ("like a giant", "the way a giant would")),
    "happy": Manner(("happy", "cheerful"), ("happily", "cheerfully", "in a happy mood")),
    "masculine": _MASCULINE,
    "masculinity": _MASCULINE,
    "musical": Manner((), ("to the beat of music", "as if moving to music", "musically")),
    "not-confident": Manner(("timid", "unconfident"), ("without confidence", "timidly")),
    "old": _OLD,
    "proud": Manner(("proud",), ("proudly", "with pride")),
    "sad": Manner(("sad", "unhappy"), ("sadly", "as if sad")),
    "tired": _TIRED,
    "youthful": Manner(("youthful", "young"), ("youthfully", "like a young person")),
}

_SIDED: dict[str, tuple[str, ...]] = {
    "walk-{side}": (
        "walk|walks|walking to the {side}",
        "walk|walks|walking {side}",
        "walk|walks|walking {side}ward",
        "move|moves|moving to the {side} on foot",
        "go|goes|going to the {side}",
        "step|steps|stepping to the {side}",
    ),
    "walk-turn-{side}": (
        "turn|turns|turning {side} while walking",
        "turn|turns|turning to the {side} while walking",
        "walk|walks|walking forward and {turn} {side}",
        "walk|walks|walking and then {turn} to the {side}",
        "walk|walks|walking and {make} a {side} turn",
        "take|takes|taking a {side} turn while walking",
        "walk|walks|walking around a corner to the {side}",
    ),
    "wave-{side}-hand": (
        "wave|waves|waving with the {side} hand",
        "wave|waves|waving the {side} hand",
        "wave|waves|waving with their {side} hand",
        "wave|waves|waving using the {side} hand",
        "wave|waves|waving the {side} arm",
        "wave|waves|waving hello with the {side} hand",
        "greet|greets|greeting someone by waving the {side} hand",
    ),
    "raise-up-{side}-hand": (
        "raise|raises|raising the {side} hand",
        "raise|raises|raising their {side} hand",
        "raise|raises|raising the {side} arm",
        "lift|lifts|lifting the {side} hand up",
        "lift|lifts|lifting the {side} arm",
        "put|puts|putting the {side} hand up",
        "raise|raises|raising the {side} hand up high",
    ),
    "hold-up-{side}-hand": (
        "hold|holds|holding the {side} hand up",
        "keep|keeps|keeping the {side} hand raised",
        "stand|stands|standing still with the {side} hand raised",
        "stand|stands|standing with the {side} arm up",
        "hold|holds|holding the {side} arm in the air",
    ),
    "lower-{side}-hand": (
        "lower|lowers|lowering the {side} hand",
        "lower|lowers|lowering the {side} arm",
        "put|puts|putting the {side} hand down",
        "take|takes|taking the {side} hand down",
        "let|lets|letting the {side} arm down",
    ),
}  # fmt: skip

_PLAIN: dict[str, tuple[str, ...]] = {
    "walk": (
        "walk|walks|walking forward",
        "walk|walks|walking",
        "walk|walks|walking ahead",
        "walk|walks|walking straight ahead",
        "walk|walks|walking forwards",
        "walk|walks|walking along",
        "go|goes|going for a walk",
        "move|moves|moving forward on foot",
    ),
    "walk-back": (
        "walk|walks|walking backward",
        "walk|walks|walking backwards",
        "walk|walks|walking back",
        "step|steps|stepping backwards",
        "move|moves|moving backward on foot",
        "go|goes|going backwards",
    ),
    "run": (
        "run|runs|running",
        "run|runs|running forward",
        "run|runs|running ahead",
        "run|runs|running straight ahead",
        "run|runs|running forwards",
        "jog|jogs|jogging",
        "jog|jogs|jogging forward",
        "move|moves|moving at a run",
    ),
    "dash": (
        "sprint|sprints|sprinting",
        "dash|dashes|dashing forward",
        "dash|dashes|dashing",
        "sprint|sprints|sprinting forward",
        "run|runs|running fast",
        "run|runs|running very fast",
    ),
    "bow": (
        "bow|bows|bowing",
        "take|takes|taking a bow",
        "make|makes|making a bow",
        "bow|bows|bowing down",
        "bend|bends|bending forward in a bow",
        "greet|greets|greeting someone with a bow",
    ),
    "bye": (
        "say|says|saying goodbye with a gesture",
        "wave|waves|waving goodbye",
        "gesture|gestures|gesturing goodbye",
        "make|makes|making a goodbye gesture",
        "say|says|saying bye",
    ),
    "byebye": (
        "wave|waves|waving bye-bye",
        "wave|waves|waving goodbye",
        "say|says|saying bye-bye with a gesture",
        "make|makes|making a bye-bye gesture",
    ),
    "guide": (
        "guide|guides|guiding someone with a gesture",
        "show|shows|showing someone the way",
        "make|makes|making a guiding gesture",
        "point|points|pointing out the way",
    ),
    "respond": ("respond|responds|responding with a gesture", "make|makes|making a gesture in response"),
    "call": ("call|calls|calling someone with a gesture", "call|calls|calling out to someone"),
    "punch": ("punch|punches|punching", "throw|throws|throwing punches", "practice|practices|practicing punches"),
    "kick": ("kick|kicks|kicking", "throw|throws|throwing kicks", "practice|practices|practicing kicks"),
    "slash": (
        "slash|slashes|slashing",
        "perform|performs|performing slashes",
        "make|makes|making slashing moves",
    ),
    "dance-short": ("dance|dances|dancing", "perform|performs|performing a short dance", "do|does|doing a dance"),
    "wave-both-hands": (
        "wave|waves|waving with both hands",
        "wave|waves|waving both hands",
        "wave|waves|waving both arms",
        "wave|waves|waving using both hands",
        "wave|waves|waving hello with both hands",
        "greet|greets|greeting someone by waving both hands",
    ),
    "raise-up-both-hands": (
        "raise|raises|raising both hands",
        "raise|raises|raising their hands",
        "raise|raises|raising both arms",
        "lift|lifts|lifting both hands up",
        "lift|lifts|lifting both arms",
        "put|puts|putting both hands up",
        "raise|raises|raising both hands up high",
    ),
    "hold-up-both-hands": (
        "hold|holds|holding both hands up",
        "keep|keeps|keeping both hands raised",
        "stand|stands|standing still with both hands raised",
        "stand|stands|standing with both arms up",
        "hold|holds|holding both arms in the air",
    ),
    "lower-both-hands": (
        "lower|lowers|lowering both hands",
        "lower|lowers|lowering both arms",
        "put|puts|putting both hands down",
        "take|takes|taking both hands down",
        "let|lets|letting both arms down",
    ),
    "stand": (
        "stand|stands|standing still",
        "stand|stands|standing",
        "stand|stands|standing in place",
        "stand|stands|standing on the spot",
        "stand|stands|standing without moving",
        "stay|stays|staying still",
        "stay|stays|staying in place",
        "remain|remains|remaining still",
        "wait|waits|waiting",
        "stand|stands|standing idle",
        "do|does|doing nothing",
    ),
    "run-jog": ("run|runs|running", "jog|jogs|jogging", "run|runs|running forward", "jog|jogs|jogging forward"),
}  # fmt: skip


@dataclass(frozen=True)
class Action:
    """An action in three forms: "walk forward", "walks forward", "walking forward"."""

    base: str
    third: str
    gerund: str


# Further verbs of a phrase, which take the same form as the first one.
_FORMS = {
    "turn": ("turn", "turns", "turning"),
    "make": ("make", "makes", "making"),
    "walk": ("walk", "walks", "walking"),
    "start_walking": ("start walking", "starts walking", "starting to walk"),
    "wait": ("wait", "waits", "waiting"),
    "stop": ("stop", "stops", "stopping"),
}


def actions(content: str) -> tuple[Action, ...]:
    """The phrases for a content label, the most usual first; empty for a content without phrases."""
    phrases = _PLAIN.get(content) or PLAIN.get(content, ())
    side = ""
    for slug, sided in (_SIDED | SIDED).items():
        for candidate in ("left", "right"):
            if slug.format(side=candidate) == content:
                phrases, side = sided, candidate
    return tuple(_action(phrase, side) for phrase in phrases)


def _action(phrase: str, side: str) -> Action:
    base, third, last = phrase.split("|")
    gerund, _, rest = last.partition(" ")
    tail = f" {rest}" if rest else ""

    def say(verb: str, form: int) -> str:
        return verb + tail.format(side=side, **{key: forms[form] for key, forms in _FORMS.items()})

    return Action(say(base, 0), say(third, 1), say(gerund, 2))
