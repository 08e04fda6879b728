"""Script: the prompt spans and constraints of one character, what became of them, and how to undo them."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

from motiongen_client.types import ConstraintReached, Placement
from motiongen_tools.view.constraint_json import frames_of, read_constraint
from motiongen_tools.view.fields import Message

MOST_SPANS = 200
MOST_CONSTRAINTS = 400
PRESENT_PROMPT = 1  # the id of the prompt that is set without a frame


@dataclass
class Span:
    """A prompt over frames. message: the one that set it; start, end: None as long as nothing has ended it."""

    prompt_id: int
    message: Message
    start: int
    end: int | None = None
    is_scheduled: bool = False

    def shown(self) -> dict[str, Any]:
        return {
            "prompt_id": self.prompt_id,
            "text": self.message.get("text") or "",
            "preset": self.message.get("preset"),
            "start": self.start,
            "end": self.end,
            "scheduled": self.is_scheduled,
        }


@dataclass
class Target:
    """An accepted constraint. reached: its outcome, once known; placement: where the server placed it."""

    constraint_id: int
    spec: Message
    effective_frame: int | None
    is_removed: bool = False
    reached: ConstraintReached | None = None
    placement: Placement | None = None

    @property
    def frames(self) -> tuple[int, int] | None:
        """The first and the last frame that it applies to; None until the server has chosen them."""
        if self.placement is not None:
            return self.placement.first_frame, self.placement.last_frame
        return self._own_frames

    @cached_property
    def _own_frames(self) -> tuple[int, int] | None:
        return frames_of(read_constraint(self.spec))

    def shown(self) -> dict[str, Any]:
        placed = self.placement
        first, last = self.frames or (None, None)
        state, reached = "waiting", self.reached
        if reached is not None:
            state = "met" if reached.met else "missed"
        elif self.is_removed:
            state = "removed"
        return {
            "id": self.constraint_id,
            "spec": self.spec,
            "first": first,
            "last": last,
            "arrival": last if placed is None else placed.arrival_frame,
            "state": state,
            "effective_frame": self.effective_frame,
            "position_error_m": None if reached is None else reached.position_error_m,
            "rotation_error_rad": None if reached is None else reached.rotation_error_rad,
        }


@dataclass
class Script:
    """The spans and targets of one character, in the order in which they were accepted. The oldest are forgotten."""

    spans: list[Span] = field(default_factory=list)
    targets: dict[int, Target] = field(default_factory=dict)

    def take(
        self, message: Message, effective_frame: int | None, prompt_id: int | None, ids: tuple[int, ...], playhead: int
    ) -> None:
        """Note a message that the server accepted. ids: of its constraints; playhead: used if it altered no frame."""
        frame = playhead if effective_frame is None else effective_frame
        match message.get("op"):
            case "set_prompt" if prompt_id is not None:
                self._set_prompt(message, frame, prompt_id)
            case "remove_prompts":
                self._end_spans(set(message["prompt_ids"]), frame)
            case "add_constraints" | "set_constraints":
                if message["op"] == "set_constraints":
                    self._remove(list(self.targets))
                for key, spec in zip(ids, message["constraints"], strict=True):
                    self.targets[key] = Target(key, spec, effective_frame)
            case "replace_constraint":
                self.targets[ids[0]] = Target(ids[0], message["constraint"], effective_frame)
            case "remove_constraints":
                self._remove(message["constraint_ids"])
            case "clear_constraints":
                self._remove(list(self.targets))
        del self.spans[:-MOST_SPANS]
        for key in list(self.targets)[:-MOST_CONSTRAINTS]:
            del self.targets[key]

    def note_placements(self, placements: Iterable[Placement]) -> None:
        """Note where the server placed constraints that left choices to it."""
        for placement in placements:
            target = self.targets.get(placement.constraint_id)
            if target is not None:
                target.placement = placement

    def note_reached(self, reached: ConstraintReached) -> None:
        """Note the outcome of a constraint whose last frame can no longer change."""
        target = self.targets.get(reached.constraint_id)
        if target is not None:
            target.reached = reached

    def note_reopened(self, frame: int) -> None:
        """Note that another session continues at `frame`, which does not get constraints whose frames have passed."""
        for target in self.targets.values():
            frames = target.frames
            if target.reached is None and frames is not None and frames[1] < frame:
                target.is_removed = True

    def inverse(self, message: Message, prompt_id: int | None, ids: tuple[int, ...]) -> list[Message]:
        """The messages that undo one, computed before `take`; empty if it cannot be undone."""
        match message.get("op"):
            case "set_prompt":
                return self._without_prompt(prompt_id)
            case "remove_prompts":
                held = [self._span(key) for key in message["prompt_ids"]]
                return [again for span in held if span is not None and (again := _again(span))]
            case "add_constraints":
                return [{"op": "remove_constraints", "constraint_ids": list(ids)}]
            case "set_constraints":
                return [{"op": "remove_constraints", "constraint_ids": list(ids)}, *self._anew(list(self.targets))]
            case "replace_constraint":
                before = self.targets.get(ids[0])
                if before is None or before.is_removed:
                    return [{"op": "remove_constraints", "constraint_ids": list(ids)}]
                return [{"op": "replace_constraint", "constraint_id": ids[0], "constraint": before.spec}]
            case "remove_constraints":
                return self._anew(message["constraint_ids"])
            case "clear_constraints":
                return self._anew(list(self.targets))
        return []

    def shown(self) -> dict[str, Any]:
        """The script as the page draws it."""
        return {
            "spans": [span.shown() for span in self.spans],
            "targets": [target.shown() for target in self.targets.values()],
        }

    # ---- prompts

    def _span(self, prompt_id: int) -> Span | None:
        return next((span for span in reversed(self.spans) if span.prompt_id == prompt_id), None)

    def _set_prompt(self, message: Message, effective_frame: int, prompt_id: int) -> None:
        frame, end = message.get("frame"), message.get("end_frame")
        if frame is None and end is None:
            for span in self.spans:
                if span.start <= effective_frame and (span.end is None or span.end > effective_frame):
                    span.end = effective_frame
            self.spans = [span for span in self.spans if span.end is None or span.end > span.start]
            self.spans.append(Span(prompt_id, message, effective_frame))
            return
        self.spans = [span for span in self.spans if span.prompt_id != prompt_id or span.end == span.start]
        self.spans.append(Span(prompt_id, message, max(frame or 0, effective_frame), end, is_scheduled=True))

    def _end_spans(self, prompt_ids: set[int], frame: int) -> None:
        for span in self.spans:
            if span.prompt_id in prompt_ids and (span.end is None or span.end > frame):
                span.end = max(frame, span.start)
        self.spans = [span for span in self.spans if span.end is None or span.end > span.start]

    def _without_prompt(self, prompt_id: int | None) -> list[Message]:
        if prompt_id is None:
            return []
        before = self._span(prompt_id)
        if before is None:
            return [{"op": "remove_prompts", "prompt_ids": [prompt_id]}]
        return [_again(before)]

    # ---- constraints

    def _remove(self, ids: list[int]) -> None:
        for key in ids:
            target = self.targets.get(key)
            if target is not None and target.reached is None:
                target.is_removed = True

    def _anew(self, ids: list[int]) -> list[Message]:
        gone = [self.targets[key] for key in ids if key in self.targets]
        specs = [target.spec for target in gone if target.reached is None and not target.is_removed]
        return [{"op": "add_constraints", "constraints": specs}] if specs else []


def _again(span: Span) -> Message:
    """The message that sets a span again, under its own id."""
    kept = {key: value for key, value in span.message.items() if key in ("op", "text", "preset", "frame", "end_frame")}
    return kept if span.prompt_id == PRESENT_PROMPT else {**kept, "prompt_id": span.prompt_id}
