"""What a browser or a session file may tell a character, as messages with `op`, and the call that each is."""

from __future__ import annotations

from collections.abc import Callable

from motiongen_client.edit import Edit
from motiongen_client.errors import InvalidInput
from motiongen_client.prompts import Preset, Prompt
from motiongen_client.session import Session
from motiongen_client.types import Constraint, Priority
from motiongen_tools.view import fields
from motiongen_tools.view.constraint_json import read_constraint
from motiongen_tools.view.fields import Message

LONGEST_HOLD_S = 20.0
CUT_FRAMES = 16
"""How many played frames a cut goes on from: whole patches, and all that a window looks back."""
PRIORITIES = {each.value: each for each in Priority}


def apply(session: Session, message: Message) -> Edit:
    """Tell a session what a message says. Raises InvalidInput naming the field, or what ended the session."""
    operation = OPERATIONS.get(str(message.get("op")))
    if operation is None:
        raise InvalidInput("op", message.get("op"), f"one of {', '.join(OPERATIONS)}")
    return operation(session, message)


def read_prompt(message: Message) -> Prompt:
    """A preset by `preset`, else the words of `text`."""
    if message.get("preset") is not None:
        return Preset(fields.text(message, "preset"))
    words = fields.text(message, "text").strip()
    if not words:
        raise InvalidInput("text", "", "some words, such as 'a person walks forward', or a preset")
    return words


def _set_prompt(session: Session, message: Message) -> Edit:
    return session.set_prompt(
        read_prompt(message),
        frame=fields.optional_whole(message, "frame"),
        end_frame=fields.optional_whole(message, "end_frame"),
        prompt_id=fields.optional_whole(message, "prompt_id", 1),
    )


def _remove_prompts(session: Session, message: Message) -> Edit:
    return session.remove_prompts(fields.wholes(message, "prompt_ids"))


def _add_constraints(session: Session, message: Message) -> Edit:
    return session.add_constraints(_constraints(message))


def _constraints(message: Message) -> list[Constraint]:
    given = message.get("constraints")
    if not isinstance(given, list) or not given or not all(isinstance(one, dict) for one in given):
        raise InvalidInput("constraints", given, "a list of one constraint or more")
    return [read_constraint(one) for one in given]


def _replace_constraint(session: Session, message: Message) -> Edit:
    constraint = read_constraint(fields.mapping(message, "constraint"))
    return session.replace_constraint(fields.whole(message, "constraint_id", 1), constraint)


def _remove_constraints(session: Session, message: Message) -> Edit:
    return session.remove_constraints(fields.wholes(message, "constraint_ids"))


def _clear_constraints(session: Session, message: Message) -> Edit:
    return session.clear_constraints()


def _set_constraints(session: Session, message: Message) -> Edit:
    return session.set_constraints(_constraints(message))


def _teleport(session: Session, message: Message) -> Edit:
    return session.teleport(
        fields.number(message, "x_m"),
        fields.number(message, "z_m"),
        heading_rad=fields.number(message, "heading_rad", 0.0),
    )


def _cut_to(session: Session, message: Message) -> Edit:
    """Go on from frames that were played: those before `frame`, as many as a cut takes."""
    end = fields.whole(message, "frame", CUT_FRAMES)
    return session.cut_to(session.motion(end - CUT_FRAMES, end))


def _set_options(session: Session, message: Message) -> Edit:
    priority = fields.text(message, "priority") if message.get("priority") is not None else None
    if priority is not None and priority not in PRIORITIES:
        raise InvalidInput("priority", priority, f"one of {', '.join(PRIORITIES)}")
    weights = (fields.optional_number(message, "text_guidance"), fields.optional_number(message, "constraint_guidance"))
    return session.set_options(
        priority=None if priority is None else PRIORITIES[priority],
        lookahead_frames=fields.optional_whole(message, "lookahead_frames", 1, 1 << 31),
        denoise_steps=fields.optional_whole(message, "steps", 1, 1 << 31),
        guidance=None if weights == (None, None) else weights,
        history_frames=fields.optional_whole(message, "history_frames", 1, 1 << 31),
    )


def _set_velocity(session: Session, message: Message) -> Edit:
    seconds = fields.number(message, "seconds", 1.0)
    if not 0 < seconds <= LONGEST_HOLD_S:
        raise InvalidInput("seconds", seconds, f"above 0, up to {LONGEST_HOLD_S:g}")
    return session.set_velocity(
        fields.number(message, "x_mps"),
        fields.number(message, "z_mps"),
        seconds=seconds,
        heading_rad=fields.optional_number(message, "heading_rad"),
        keep_prompt=fields.flag(message, "keep_prompt"),
    )


def _pause(session: Session, message: Message) -> Edit:
    return session.pause()


def _resume(session: Session, message: Message) -> Edit:
    return session.resume()


OPERATIONS: dict[str, Callable[[Session, Message], Edit]] = {
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
