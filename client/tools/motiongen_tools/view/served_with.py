"""ServedWith: priority, steps, guidance, look-ahead and history of one character, and how to undo changes of them."""

from __future__ import annotations

from collections.abc import Iterable

from motiongen_client.types import Model, Opened, SessionOptions
from motiongen_tools.view.fields import Message

WEIGHTS = ("text_guidance", "constraint_guidance")


class ServedWith:
    """The options of a session, under the names that messages use for them."""

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
        self._under_way: list[Message] = []

    def completed(self, message: Message) -> Message:
        """The message with both guidance weights if it has one, since the server sets both; the other as asked last."""
        if all(message.get(name) is None for name in WEIGHTS):
            return message
        asked = dict(self._values)
        for before in self._under_way:
            asked |= _named(before, asked)
        return {**message, **{name: asked[name] for name in WEIGHTS if message.get(name) is None}}

    def inverse(self, message: Message) -> Message:
        """The message that undoes one, computed before its `answer`."""
        return {"op": "set_options", **{name: self._values[name] for name in _named(message, self._values)}}

    def ask(self, message: Message) -> None:
        """Note that a message was sent."""
        self._under_way.append(message)

    def answer(self, message: Message, is_accepted: bool) -> None:
        """Note that the server has accepted or refused a message."""
        self._under_way = [each for each in self._under_way if each is not message]
        if is_accepted:
            self._values |= _named(message, self._values)


def _named(message: Message, names: Iterable[str]) -> dict[str, str | int | float]:
    return {name: message[name] for name in names if message.get(name) is not None}
