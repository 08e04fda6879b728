"""Applies edits of prompts to a session's conditions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from motiongen_server.engine.session.conditions import Conditions
from motiongen_server.engine.session.edit_refusals import passed, too_many, unknown
from motiongen_server.engine.types import Prompt, SetPrompts


def edit_prompts(held: Conditions, event: SetPrompts, floor: int, limit: int) -> tuple[Conditions, int | None]:
    """Apply an edit of prompts. floor: the first frame that can still change.

    Returns the new conditions and the first frame from floor on whose prompt differs, None if none does. A prompt in
    force stays so until the one that replaces it begins, so that no frame in between is without text. Before floor
    nothing changes, since a window may still be made there: the next report may show that the client is less far than
    estimated. Raises EventRefused for an unknown id, a span that has passed, or more than `limit` prompts.
    """
    # Several prompts may have one id: all but the last are remainders of those that it replaced. Remainders keep their
    # place in the order, since of equal starts the one set last wins.
    prompts: Sequence[Prompt] = held.prompts
    for index, prompt_id in enumerate(event.remove):
        if prompt_id not in (ids := _ids_from(floor, prompts)):
            raise unknown("prompt", prompt_id, index, ids)
        of_its_id = [each for each in prompts if each.prompt_id == prompt_id]
        prompts = _with_left(prompts, prompt_id, [_until(floor, each) for each in of_its_id])
    for index, prompt in enumerate(event.upsert):
        if prompt.end_frame is not None and prompt.end_frame <= floor:
            field = f"edit_prompts.upsert[{index}].end_frame"
            least = floor + 1  # a span ends before its end_frame
            raise passed("prompt", prompt.prompt_id, prompt.end_frame - 1, floor, field, least)
    prompts = upserted(prompts, event.upsert, floor)
    if (count := len(_ids_from(floor, prompts))) > limit:
        raise too_many("prompts", count, limit)
    result = replace(held, prompts=tuple(prompts))
    return result, result.first_change(held, floor, None)


def upserted(held: Sequence[Prompt], upsert: Sequence[Prompt], floor: int) -> tuple[Prompt, ...]:
    """The prompts after each of `upsert`, in order, was added or replaced those of its id."""
    prompts = list(held)
    for prompt in upsert:
        begin = max(floor, prompt.begin)
        of_its_id = [each for each in prompts if each.prompt_id == prompt.prompt_id]
        prompts = _with_left(prompts, prompt.prompt_id, _left_for(begin, floor, of_its_id))
        prompts.append(replace(prompt, start_frame=begin))
    return tuple(prompts)


def _ids_from(floor: int, prompts: Sequence[Prompt]) -> set[int]:
    """The ids of prompts in force at floor or later; the others were removed or replaced."""
    return {each.prompt_id for each in prompts if each.end_frame is None or each.end_frame > floor}


def _with_left(prompts: Sequence[Prompt], prompt_id: int, left: Sequence[Prompt | None]) -> list[Prompt]:
    """The prompts with those of one id replaced by their remainders, in the same order; None: nothing remains."""
    of_its_id = iter(left)
    edited = [next(of_its_id) if each.prompt_id == prompt_id else each for each in prompts]
    return [each for each in edited if each is not None]


def _left_for(begin: int, floor: int, held: Sequence[Prompt]) -> list[Prompt | None]:
    """The remainder of each prompt of an id, in order, if another one replaces them at `begin`."""
    if not held or held[-1].begin <= floor:
        return [_until(begin, each) for each in held]
    *earlier, never_begins = held
    if earlier and earlier[-1].end_frame == never_begins.begin:  # it was shortened for the one that never begins
        earlier[-1] = replace(earlier[-1], end_frame=begin)
    return [*(_until(begin, each) for each in earlier), None]


def _until(frame: int, prompt: Prompt) -> Prompt | None:
    """The prompt, shortened to end at a frame at the latest; None if it would not have begun."""
    if prompt.begin >= frame:
        return None
    ends_before = prompt.end_frame is not None and prompt.end_frame <= frame
    return prompt if ends_before else replace(prompt, end_frame=frame)
