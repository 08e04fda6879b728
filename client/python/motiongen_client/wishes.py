"""Wishes: what a session was told and the server accepted, so that a replacement can be told the same. Pure."""

from __future__ import annotations

from collections.abc import Iterable

from motiongen.v1 import motion_pb2, session_pb2
from motiongen_client.frame_shift import shifted_constraint, shifted_span
from motiongen_client.placing import path_left, placed
from motiongen_client.types import Placement

PLAYING = session_pb2.PLAY_STATE_PLAYING
MOST_UNTOLD = 256
"""Limit on past constraints whose outcome has not arrived. It arrives for each, unless the connection is lost."""


class Wishes:
    """The prompts, constraints, velocity, cut and play state in force, in the application's frame numbers."""

    def __init__(self) -> None:
        self._prompts: list[motion_pb2.PromptSpan] = []  # in the order they were set
        self._constraints: dict[int, motion_pb2.Constraint] = {}
        self._placements: dict[int, Placement] = {}
        self._velocity: tuple[session_pb2.SetVelocity, int] | None = None  # with the frame at which it ends
        self._cut: tuple[session_pb2.Seek, int] | None = None  # with its first frame
        self._play_state: session_pb2.PlayState = PLAYING

    def take_opening(self, opening: session_pb2.OpenSession) -> None:
        """Take the prompts and constraints with which the session was opened."""
        self._prompts = list(opening.prompts)
        self._constraints = {target.constraint_id: target for target in opening.constraints}

    def place(self, placements: Iterable[Placement]) -> None:
        """The server has placed constraints: from now on they stand for those frames and places."""
        for placement in placements:
            key = placement.constraint_id
            if key in self._constraints:
                self._constraints[key] = placed(self._constraints[key], placement)
                self._placements[key] = placement

    def take_reopening(self, frame: int, placements: Iterable[Placement]) -> None:
        """The session was opened anew at a frame with the constraints left then, and has placed them again."""
        for key, target in self._constraints.items():
            left = self._left(key, frame) if target.HasField("root_path") else None
            if left is not None:  # the new session has only the rest of a partly walked path
                self._constraints[key] = left
        self.place(placements)

    def excludes(self, constraint_id: int, frame: int, replaced_from: int | None) -> bool:
        """Whether a report with this frame is of an earlier constraint with this id, which the present one replaced.

        replaced_from: the first frame that the present one can influence, if the other's report may still come.
        """
        if self._begins_after(constraint_id, frame):
            return True
        if replaced_from is None:
            return False
        target = self._constraints.get(constraint_id)
        reported_at = None if target is None else _reported_at(target)
        return frame < replaced_from if reported_at is None else frame != reported_at

    def _begins_after(self, constraint_id: int, frame: int) -> bool:
        """Whether the constraint that now has this id asks for nothing at or before a frame."""
        target, placement = self._constraints.get(constraint_id), self._placements.get(constraint_id)
        if placement is not None:
            return frame < placement.first_frame
        if target is None or target.at_any_frame or target.frames_from_effect or target.HasField("root_path"):
            return False
        return frame < target.frame

    def holds(self, constraint_id: int) -> bool:
        """Whether a constraint with this id was accepted and is not over."""
        return constraint_id in self._constraints

    def end(self, constraint_id: int) -> None:
        """It is known what became of a constraint, which is thus over, even if it was met early."""
        self._constraints.pop(constraint_id, None)
        self._placements.pop(constraint_id, None)

    def take(
        self,
        event: session_pb2.SessionEvent,
        effective_frame: int,
        playhead: int,
        placements: Iterable[Placement] = (),
    ) -> None:
        """The server has accepted an event. effective_frame: the first frame that shows it.

        playhead: what is past at this frame may be dropped. placements: of those of its constraints that left frames or
        places to the server.
        """
        match event.WhichOneof("event"):
            case "edit_prompts":
                gone = set(event.edit_prompts.remove)
                self._prompts = [
                    span
                    for span in self._prompts
                    if span.prompt_id not in gone and (not span.end_frame or span.end_frame > playhead)
                ]
                for span in event.edit_prompts.upsert:
                    self._put_span(_from(max(span.start_frame, effective_frame), span), playhead)
            case "edit_constraints":
                if event.edit_constraints.clear:
                    self._constraints.clear()
                for constraint_id in event.edit_constraints.remove:
                    self._constraints.pop(constraint_id, None)
                for constraint_id in self.passed_at(playhead)[:-MOST_UNTOLD]:
                    del self._constraints[constraint_id]
                for target in event.edit_constraints.upsert:
                    self._constraints.pop(target.constraint_id, None)
                    self._placements.pop(target.constraint_id, None)
                    self._constraints[target.constraint_id] = target
                self.place(placements)
                self._placements = {key: held for key, held in self._placements.items() if key in self._constraints}
            case "set_velocity":
                velocity = event.set_velocity
                self._velocity = (velocity, effective_frame + velocity.hold_frames)
            case "seek":
                self._cut = (event.seek, effective_frame)
            case "set_play_state":
                self._play_state = event.set_play_state.state

    def prompts_from(self, frame: int, most: int) -> list[motion_pb2.PromptSpan]:
        """The spans for a session that begins at a frame: begun ones, the one in force last of these, then later ones.

        If there are more than `most`, those that a later span with the same id replaces are left out.
        """
        begun = [span for span in self._prompts if span.start_frame <= frame]
        begun.sort(key=lambda span: span.start_frame)
        later = [span for span in self._prompts if span.start_frame > frame]
        spans = [span for each in (*begun, *later) if (span := shifted_span(each, frame)) is not None]
        return spans if len(spans) <= most else list({span.prompt_id: span for span in spans}.values())

    def _put_span(self, span: motion_pb2.PromptSpan, playhead: int) -> None:
        """Set a span. One with the same id that has begun holds until the new one starts, as on the server."""
        of_its_id = [each for each in self._prompts if each.prompt_id == span.prompt_id]
        never_begins = of_its_id[-1] if of_its_id and of_its_id[-1].start_frame > playhead else None
        left = {id(each): _until(span.start_frame, each, never_begins) for each in of_its_id}
        held = [left.get(id(each), each) for each in self._prompts]
        self._prompts = [*(each for each in held if each is not None), span]

    def constraints_from(self, frame: int) -> list[motion_pb2.Constraint]:
        """The constraints that a session beginning at a frame can still meet."""
        left = (self._left(key, frame) for key in self._constraints)
        return [target for target in left if target is not None]

    def passed_at(self, frame: int) -> list[int]:
        """The ids of the constraints that a session beginning at a frame cannot meet any more."""
        return [key for key in self._constraints if self._left(key, frame) is None]

    def _left(self, constraint_id: int, frame: int) -> motion_pb2.Constraint | None:
        """What is left of a constraint for a session beginning at a frame; None if it has passed."""
        target, placement = self._constraints[constraint_id], self._placements.get(constraint_id)
        if placement is not None and placement.last_frame < frame:
            return None
        if placement is not None and target.HasField("root_path"):
            return path_left(target, placement, frame)
        return shifted_constraint(target, frame)

    def events_from(self, frame: int) -> list[session_pb2.SessionEvent]:
        """The other events to send to a session that begins at a frame, without event numbers."""
        events = []
        if self._cut is not None and self._cut[1] >= frame:  # the cut is still to come
            cut = session_pb2.SessionEvent()
            cut.seek.CopyFrom(self._cut[0])
            events.append(cut)
        if self._velocity is not None and self._velocity[1] > frame:
            velocity = session_pb2.SetVelocity()
            velocity.CopyFrom(self._velocity[0])
            velocity.hold_frames = min(velocity.hold_frames, self._velocity[1] - frame)
            events.append(session_pb2.SessionEvent(set_velocity=velocity))
        if self._play_state != PLAYING:
            state = session_pb2.SetPlayState(state=self._play_state)
            events.append(session_pb2.SessionEvent(set_play_state=state))
        return events


def _reported_at(target: motion_pb2.Constraint) -> int | None:
    """The frame that a report of a constraint has; None if it may have one of several."""
    if target.HasField("last_frame") or target.at_any_frame or target.frames_from_effect:
        return None
    if target.HasField("root_path"):
        return None
    if target.HasField("root_trajectory"):
        return target.frame + max(len(target.root_trajectory.positions) // 2, 1) - 1
    return target.frame


def _from(frame: int, span: motion_pb2.PromptSpan) -> motion_pb2.PromptSpan:
    moved = motion_pb2.PromptSpan()
    moved.CopyFrom(span)
    moved.start_frame = frame
    return moved


def _until(
    frame: int, span: motion_pb2.PromptSpan, never_begins: motion_pb2.PromptSpan | None
) -> motion_pb2.PromptSpan | None:
    """What is left of a span if one with its id starts at a frame and replaces never_begins too; None: nothing."""
    was_cut_for_that = never_begins is not None and span.end_frame == never_begins.start_frame
    end = span.end_frame if span.end_frame and not was_cut_for_that else frame
    if span is never_begins or span.start_frame >= min(end, frame):
        return None
    left = motion_pb2.PromptSpan()
    left.CopyFrom(span)
    left.end_frame = min(end, frame)
    return left
