"""Commands of browsers and session files: messages with `op`, and the calls of a session that they stand for."""

from __future__ import annotations

from collections.abc import Callable

from motiongen_client.edit import Edit
from motiongen_client.errors import InvalidInput
from motiongen_client.prompts import Preset, Prompt
from motiongen_client.session import Session
from motiongen_client.types import Constraint, Priority
from motiongen_tools.view import fields
from motiongen_tools.view.constraint_json import read_constraint
from motiongen_tools.view.fields import MOST_ID, Message

LONGEST_HOLD_S = 20.0
CUT_FRAMES = 16
"""How many played frames a cut continues from: whole patches, and as many as a window sees of its history."""
PRIORITIES = {each.value: each for each in Priority}
Call = Callable[[Session], Edit]


def apply(session: Session, message: Message) -> Edit:
    """Apply a message to a session. Raises InvalidInput naming the field, or what ended the session."""
    return read(message)(session)


def read(message: Message) -> Call:
    """The call that a message stands for, for any session. Raises InvalidInput naming the field."""
    operation = OPERATIONS.get(str(message.get("op")))
    if operation is None:
        raise InvalidInput("op", message.get("op"), f"one of {', '.join(OPERATIONS)}")
    return operation(message)


def read_prompt(message: Message) -> Prompt:
    """The preset named by `preset`, otherwise the text in `text`."""
    if message.get("preset") is not None:
        return Preset(fields.text(message, "preset"))
    words = fields.text(message, "text").strip()
    if not words:
        raise InvalidInput("text", "", "some words, such as 'a person walks forward', or a preset")
    return words


def _set_prompt(message: Message) -> Call:
    prompt = read_prompt(message)
    frame, end_frame = fields.optional_whole(message, "frame"), fields.optional_whole(message, "end_frame")
    prompt_id = fields.optional_whole(message, "prompt_id", 1, MOST_ID)
    return lambda session: session.set_prompt(prompt, frame=frame, end_frame=end_frame, prompt_id=prompt_id)


def _remove_prompts(message: Message) -> Call:
    ids = fields.ids(message, "prompt_ids")
    return lambda session: session.remove_prompts(ids)


def _add_constraints(message: Message) -> Call:
    constraints = _constraints(message)
    return lambda session: session.add_constraints(constraints)


def _constraints(message: Message) -> list[Constraint]:
    given = message.get("constraints")
    if not isinstance(given, list) or not given or not all(isinstance(one, dict) for one in given):
        raise InvalidInput("constraints", given, "a list of one constraint or more")
    return [read_constraint(one) for one in given]


def _replace_constraint(message: Message) -> Call:
    constraint = read_constraint(fields.mapping(message, "constraint"))
    constraint_id = fields.whole(message, "constraint_id", 1, MOST_ID)
    return lambda session: session.replace_constraint(constraint_id, constraint)


def _remove_constraints(message: Message) -> Call:
    ids = fields.ids(message, "constraint_ids")
    return lambda session: session.remove_constraints(ids)


def _clear_constraints(message: Message) -> Call:
    return lambda session: session.clear_constraints()


def _set_constraints(message: Message) -> Call:
    constraints = _constraints(message)
    return lambda session: session.set_constraints(constraints)


def _teleport(message: Message) -> Call:
    x_m, z_m = fields.number(message, "x_m"), fields.number(message, "z_m")
    heading_rad = fields.number(message, "heading_rad", 0.0)
    return lambda session: session.teleport(x_m, z_m, heading_rad=heading_rad)


def _cut_to(message: Message) -> Call:
    """Continue from frames that were played: those before `frame`, as many as a cut takes."""
    end = fields.whole(message, "frame", CUT_FRAMES)
    return lambda session: session.cut_to(session.motion(end - CUT_FRAMES, end))


def _set_options(message: Message) -> Call:
    name = fields.text(message, "priority") if message.get("priority") is not None else None
    if name is not None and name not in PRIORITIES:
        raise InvalidInput("priority", name, f"one of {', '.join(PRIORITIES)}")
    priority = None if name is None else PRIORITIES[name]
    weights = (fields.optional_number(message, "text_guidance"), fields.optional_number(message, "constraint_guidance"))
    lookahead_frames, steps, history_frames = (
        fields.optional_whole(message, field, 1, 1 << 31) for field in ("lookahead_frames", "steps", "history_frames")
    )
    return lambda session: session.set_options(
        priority=priority,
        lookahead_frames=lookahead_frames,
        denoise_steps=steps,
        guidance=None if weights == (None, None) else weights,
        history_frames=history_frames,
    )


def _set_velocity(message: Message) -> Call:
    seconds = fields.number(message, "seconds", 1.0)
    if not 0 < seconds <= LONGEST_HOLD_S:
        raise InvalidInput("seconds", seconds, f"above 0, up to {LONGEST_HOLD_S:g}")
    x_mps, z_mps = fields.number(message, "x_mps"), fields.number(message, "z_mps")
    heading_rad, keeps = fields.optional_number(message, "heading_rad"), fields.flag(message, "keep_prompt")
    return lambda session: session.set_velocity(
        x_mps, z_mps, seconds=seconds, heading_rad=heading_rad, keep_prompt=keeps
    )


def _pause(message: Message) -> Call:
    return lambda session: session.pause()


def _resume(message: Message) -> Call:
    return lambda session: session.resume()


OPERATIONS: dict[str, Callable[[Message], Call]] = {
    "set_prompt": _set_prompt,
    "remove_prompts": _remove_prompts,
    "add_constraints": _add_constraints,
    "replace_constraint": _replace_constraint,
    "remove_constraints": _remove_constraints,
    "clear_constraints": _clear_constraints,
    "set_constraints": _set_constraints,
    "set_velocity": _set_velocity,
    "pause": _pause,
    "resume": _resume,
    "teleport": _teleport,
    "cut_to": _cut_to,
    "set_options": _set_options,
}
