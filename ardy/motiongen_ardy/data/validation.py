"""The validation split: one train capture in 25, by a hash of its id, with everything derived from it."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence

SHARE = 25
SEPARATOR = "+"
CUT_MARK = "~cut"  # between the id of a capture and the number of one of its pieces


def is_validation(origins: Sequence[str]) -> bool:
    """Whether a clip belongs to validation. origins: the ids of the captured clips from which it was made.

    A clip made from several captures belongs to it as soon as one of them does, so that training sees none of their
    frames. Pieces of one capture belong together.
    """
    captures = {one.partition(CUT_MARK)[0] for one in origins}
    return any(int(hashlib.sha1(f"validation:{one}".encode()).hexdigest(), 16) % SHARE == 0 for one in captures)


def origins(clip_id: str, derived_from: Mapping[str, str]) -> list[str]:
    """The captured clips from which a clip was made (itself, if captured). derived_from: of every clip, "" if captured.

    Several origins are joined by "+". An id that is not in the set counts as captured.
    """
    found, open_ids, seen = [], [clip_id], set()
    while open_ids:
        one = open_ids.pop()
        if one in seen:
            continue
        seen.add(one)
        parents = [part for part in derived_from.get(one, "").split(SEPARATOR) if part]
        if parents:
            open_ids += parents
        else:
            found.append(one)
    return found


def with_validation(splits: Mapping[str, str], derived_from: Mapping[str, str]) -> dict[str, str]:
    """The split of every clip by id, with "validation" taken out of "train"."""
    return {
        clip: "validation" if split == "train" and is_validation(origins(clip, derived_from)) else split
        for clip, split in splits.items()
    }
