"""Captions: plain paraphrases of the labels, and captions of mirrored clips.

Every caption made here comes from the content and style labels alone, by template; nobody and nothing looked at the
motion to write it. A caption therefore says no more than the labels do.
"""

from __future__ import annotations

import hashlib
import re
from functools import lru_cache

from motiongen_ardy.data.phrases import MANNERS, SUBJECTS, actions

_SWAPPED = {"left": "right", "right": "left"}
# "right" that is not a side ("all right", "right away") stays; "left" and "right" inside longer words are left alone,
# except for leftward(s), rightward(s), left-handed and the like.
_SIDE = re.compile(r"(?<!\ball )\b(left|right)(?=\b|wards?\b|most\b)(?! (?:away|now|angles?)\b)", re.IGNORECASE)
_TURNING = {"clockwise": "counterclockwise", "counterclockwise": "clockwise", "anticlockwise": "clockwise"}
_TURN = re.compile(r"\b(counterclockwise|anticlockwise|clockwise)\b", re.IGNORECASE)


@lru_cache(maxsize=100_000)
def mirror_caption(caption: str) -> str:
    """The caption of the mirror image: left and right change places, and so do the two ways of turning."""
    swapped = _SIDE.sub(lambda match: _like(match.group(0), _SWAPPED[match.group(0).lower()]), caption)
    return _TURN.sub(lambda match: _like(match.group(0), _TURNING[match.group(0).lower()]), swapped)


def mirror_content(content: str) -> str:
    """The content label of the mirror image: walk-turn-left becomes walk-turn-right."""
    return "-".join(_SWAPPED.get(part, part) for part in content.split("-"))


def _like(original: str, replacement: str) -> str:
    """The replacement in the letter case of the original."""
    if original.isupper():
        return replacement.upper()
    return replacement.capitalize() if original[0].isupper() else replacement


@lru_cache
def paraphrases(content: str, style: str, count: int = 30) -> tuple[str, ...]:
    """At most `count` captions for a content and a style label, most usual first.

    A plain style gives plain captions ("a person walks forward"); any other style is always said ("a tired person walks
    forward"), so that a plain caption promises plain motion. Labels without phrases give none.
    """
    if style not in MANNERS:
        return ()
    manner = MANNERS[style]
    usual: list[str] = []
    others: list[str] = []
    for action in actions(content):
        if not manner.adverbials:
            usual += [f"a person {action.third}", action.base]
            others += [f"{subject} {action.third}" for subject in SUBJECTS[1:]]
            others += [f"{subject} is {action.gerund}" for subject in SUBJECTS]
            others.append(action.gerund)
            continue
        usual.append(f"a person {action.third} {manner.adverbials[0]}")
        for adverbial in manner.adverbials:
            others += [f"{subject} {action.third} {adverbial}" for subject in SUBJECTS]
            others += [f"{subject} is {action.gerund} {adverbial}" for subject in SUBJECTS[:3]]
            others += [f"{action.base} {adverbial}", f"{action.gerund} {adverbial}"]
        for adjective in manner.adjectives:
            article = "an" if adjective[0] in "aeiou" else "a"
            others += [f"{article} {adjective} {noun} {action.third}" for noun in ("person", "character")]
    others = sorted(set(others).difference(usual), key=_shuffled)
    return tuple(dict.fromkeys(usual + others))[:count]


def _shuffled(text: str) -> str:
    """A sorting key that mixes the captions and is the same on every machine and in every run."""
    return hashlib.sha1(text.encode(), usedforsecurity=False).hexdigest()
