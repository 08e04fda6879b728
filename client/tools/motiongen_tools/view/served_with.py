"""ServedWith: class, steps, guidance, look-ahead and history of one character, and how a change of them is undone."""

from __future__ import annotations

from motiongen_client.types import Model, Opened, SessionOptions
from motiongen_tools.view.fields import Message

WEIGHTS = ("text_guidance", "constraint_guidance")


class ServedWith:
    """The options that a session plays with, under the names that messages have for them."""

    def __init__(self, options: SessionOptions, opened: Opened, model: Model) -> None:
        defaults = (model.default_text_guidance, model.default_constraint_guidance)
        asked = (options.text_guidance, options.constraint_guidance)
        weights = [default if weight is None else weight for weight, default in zip(asked, defaults, strict=True)]
        self._values: dict[str, str | int | float] = {
            "priority": options.priority.value,
            "lookahead_frames": opened.lookahead_frames,
            "steps": opened.denoise_steps,
            "history_frames": options.history_frames or model.default_history_frames,
            **dict(zip(WEIGHTS, weights, strict=True)),
        }

    def completed(self, message: Message) -> Message:
        """The message with both weights where it has one, as the server sets both anew."""
        if all(message.get(name) is None for name in WEIGHTS):
            return message
        return {**message, **{name: self._values[name] for name in WEIGHTS if message.get(name) is None}}

    def inverse(self, message: Message) -> Message:
        """The message that undoes one, seen before `take`."""
        return {"op": "set_options", **{name: value for name, value in self._values.items() if _has(message, name)}}

    def take(self, message: Message) -> None:
        """The server has accepted a message."""
        self._values |= {name: message[name] for name in self._values if _has(message, name)}


def _has(message: Message, name: str) -> bool:
    return message.get(name) is not None
