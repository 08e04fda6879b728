"""What a session is told: prompts, constraints, velocities and pauses, each sent at once and in order."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Iterable

from numpy.typing import ArrayLike

from motiongen.v1 import session_pb2
from motiongen_client import convert
from motiongen_client.carrier import Carrier
from motiongen_client.changes import Changes
from motiongen_client.cuts import Cuts
from motiongen_client.edit import Edit, EditBook
from motiongen_client.errors import EventRefused, InvalidInput, MotiongenError
from motiongen_client.frame_shift import shifted
from motiongen_client.motion import Rig
from motiongen_client.playback import Playback
from motiongen_client.prompts import Prompt, prompt_name
from motiongen_client.reached import ReachedBook
from motiongen_client.types import (
    Constraint,
    Flexible,
    HeadingTarget,
    RootPath,
    RootTrajectory,
    Waypoint,
    as_array,
    check_finite,
    check_frame,
)

PRESENT_PROMPT_ID = 1  # the prompt set without a frame; scheduled prompts take the ids above it


class Direction(Cuts):
    """The half of a `Session` that speaks to the server. Every change returns an `Edit`."""

    rig: Rig
    playback: Playback

    def __init__(self, handle: int, carrier: Carrier, clock: Callable[[], float]) -> None:
        self.handle = handle
        self._carrier = carrier
        self._clock = clock
        self._failure: MotiongenError | None = None
        self._next_seq = 1
        self._next_constraint_id = 1
        self._next_prompt_id = PRESENT_PROMPT_ID + 1
        self._scheduled_prompts: dict[int, int] = {}  # prompt id -> start frame, those the server has accepted
        self._edits = EditBook()
        self._reached = ReachedBook()
        self._unanswered: dict[int, session_pb2.SessionEvent] = {}  # by number, all but playheads
        self._offset = 0  # which of our frames is the server's frame 0
        self._changed = Changes()  # something came, or is due now

    def set_prompt(
        self, prompt: Prompt, *, frame: int | None = None, end_frame: int | None = None, prompt_id: int | None = None
    ) -> Edit:
        """Direct the motion by a text, such as "a person walks forward", by a Preset, or by a TextEmbedding.

        Without `frame` it replaces the present prompt as soon as possible. With `frame` it is scheduled: it takes over
        at that frame and holds until another takes over. With `end_frame` it is for a while: before that frame it ends,
        and what held before holds again. `Edit.prompt_id` names it; the same prompt_id again puts this one in its
        place, at other frames if need be, and `remove_prompts` drops it.
        """
        for name, value in (("frame", frame), ("end_frame", end_frame)):
            if value is not None:
                check_frame(name, value)
        if end_frame is not None and end_frame <= (frame or 0):
            raise InvalidInput("end_frame", end_frame, f"a frame above {frame or 0}, the first that it holds for")
        if prompt_id is not None and not 0 < prompt_id < self._next_prompt_id:
            raise InvalidInput("prompt_id", prompt_id, "the prompt_id of an earlier Edit")
        is_present = frame is None and end_frame is None
        if prompt_id is None and is_present:
            prompt_id = PRESENT_PROMPT_ID
        elif prompt_id is None:
            prompt_id = self._next_prompt_id
            self._next_prompt_id += 1
        gone = self._begun_prompts(prompt_id, is_present)
        edit = session_pb2.EditPrompts(remove=gone)
        edit.upsert.append(convert.prompt_span(prompt_id, prompt, frame, end_frame))
        sent = self._send_edit(prompt_name(prompt), session_pb2.SessionEvent(edit_prompts=edit), prompt_id=prompt_id)
        self._unschedule((*gone, prompt_id), sent)
        if frame is not None and end_frame is None:  # one with an end goes by itself
            key, scheduled = prompt_id, frame
            sent.when_accepted(lambda: self._scheduled_prompts.__setitem__(key, scheduled))
        return sent

    def _begun_prompts(self, prompt_id: int, is_replaced: bool) -> list[int]:
        """The scheduled prompts that hold no more once another is set; the last of them does, if none replaces it."""
        begun = [key for key, start in self._scheduled_prompts.items() if start <= self.playback.playhead]
        begun.sort(key=self._scheduled_prompts.__getitem__)
        return [key for key in (begun if is_replaced else begun[:-1]) if key != prompt_id]

    def _unschedule(self, prompt_ids: Iterable[int], edit: Edit) -> None:
        """An edit drops these, or sets them anew: where it is refused they hold as before, but for unknown ones."""
        scheduled = self._scheduled_prompts
        gone = {key: scheduled.pop(key) for key in prompt_ids if key in scheduled}

        def put_back(refusal: EventRefused) -> None:
            if refusal.reason != "UNKNOWN_PROMPT":
                self._scheduled_prompts = gone | self._scheduled_prompts

        edit.when_refused(put_back)

    def remove_prompts(self, prompt_ids: Iterable[int]) -> Edit:
        """Drop prompts by the ids that `Edit.prompt_id` gave; where none holds any more, the motion has no text."""
        ids = tuple(prompt_ids)
        edit = session_pb2.EditPrompts(remove=ids)
        sent = self._send_edit("the removal of prompts", session_pb2.SessionEvent(edit_prompts=edit))
        self._unschedule(ids, sent)
        return sent

    def add_waypoint(
        self, x_m: float, z_m: float, *, frame: int, last_frame: int | None = None, heading_rad: float | None = None
    ) -> Edit:
        """Be at a ground position (world metres) at a frame; `frame_in` turns seconds from now into one.

        With last_frame: at any frame from the one to the other.
        """
        return self.add_constraints([Flexible(Waypoint(frame, x_m, z_m, heading_rad), last_frame)])

    def go_to(self, x_m: float, z_m: float, *, heading_rad: float | None = None, is_relative: bool = False) -> Edit:
        """Walk to a ground position, however far, and be there as soon as a person can: `Outcome.placements` says when.

        is_relative: x_m to the left of the character and z_m ahead of it, and heading_rad from where it faces.
        """
        return self.add_constraints(
            [Flexible(Waypoint(0, x_m, z_m, heading_rad), at_any_frame=True, is_relative=is_relative)]
        )

    def follow_path(
        self, corners_m: ArrayLike, *, speed_mps: float | None = None, smoothing_m: float | None = None
    ) -> Edit:
        """Walk from here along lines through corners_m (N, 2), world x, z in metres, and stand at the last.

        speed_mps: 1.2 unless given; slower in bends. smoothing_m: how far corners are cut, 0.3 m unless given.
        """
        return self.add_constraints([RootPath(as_array("corners_m", corners_m, (None, 2)), speed_mps, smoothing_m)])

    def add_trajectory(
        self, positions_m: ArrayLike, *, first_frame: int, headings_rad: ArrayLike | None = None
    ) -> Edit:
        """Follow a path: positions_m (N, 2) world x, z in metres, one a frame from `first_frame`; headings_rad (N,)."""
        headings = None if headings_rad is None else as_array("headings_rad", headings_rad, (None,))
        return self.add_constraints(
            [RootTrajectory(first_frame, as_array("positions_m", positions_m, (None, 2)), headings)]
        )

    def add_constraints(self, constraints: Iterable[Constraint]) -> Edit:
        """Add constraints to those there are. `Edit.constraint_ids` are their ids, in the order given."""
        return self._edit_constraints("the addition of constraints", constraints)

    def replace_constraint(self, constraint_id: int, constraint: Constraint) -> Edit:
        """Put a constraint in the place of one that `Edit.constraint_ids` named; it keeps the id."""
        if not 0 < constraint_id < self._next_constraint_id:
            raise InvalidInput("constraint_id", constraint_id, "one of the constraint_ids of an earlier Edit")
        edit = session_pb2.EditConstraints(upsert=[convert.constraint(constraint_id, constraint)])
        sent = self._send_edit("a constraint", session_pb2.SessionEvent(edit_constraints=edit), (constraint_id,))
        self._reached.replace(constraint_id)
        sent.when_refused(lambda _: self._reached.replaced(constraint_id, is_accepted=False))
        return sent

    def add_heading(self, heading_rad: float, *, frame: int) -> Edit:
        """Face somewhere at a frame, radians about +Y from +Z, wherever the character is."""
        return self.add_constraints([HeadingTarget(frame, heading_rad)])

    def set_constraints(self, constraints: Iterable[Constraint]) -> Edit:
        """Put these constraints in place of all there are."""
        return self._edit_constraints("the replacement of all constraints", constraints, clear=True)

    def remove_constraints(self, constraint_ids: Iterable[int]) -> Edit:
        """Drop constraints by the ids that `Edit.constraint_ids` gave."""
        return self._edit_constraints("the removal of constraints", (), remove=tuple(constraint_ids))

    def clear_constraints(self) -> Edit:
        """Drop all constraints."""
        return self._edit_constraints("the removal of all constraints", (), clear=True)

    def set_velocity(
        self,
        x_mps: float,
        z_mps: float,
        *,
        seconds: float = 1.0,
        heading_rad: float | None = None,
        keep_prompt: bool = False,
    ) -> Edit:
        """Move over the ground at a velocity in the world, metres a second, as soon as possible; 0, 0 is to stand.

        Each call takes the place of the one before, and it ends `seconds` later: call it again while a stick is held.
        heading_rad: where to face meanwhile; None: where it goes. The prompt is meanwhile the model's own for that
        speed (`Model.locomotion_presets`), where it has any, unless keep_prompt says that the session's holds. Faster
        than the model's bodies step, feet may glide, which the answer warns of.
        """
        for name, value in (("x_mps", x_mps), ("z_mps", z_mps), ("seconds", seconds)):
            check_finite(name, value)
        if heading_rad is not None:
            check_finite("heading_rad", heading_rad)
        hold_frames = max(self.rig.frames_in(seconds), 0)
        if hold_frames >= 1 << 32:
            raise InvalidInput("seconds", seconds, "those of Limits.max_hold_frames at most")
        velocity = session_pb2.SetVelocity(
            x=x_mps,
            z=z_mps,
            heading=heading_rad,
            hold_frames=hold_frames,
            keep_prompt=keep_prompt,
        )
        return self._send_edit("the velocity", session_pb2.SessionEvent(set_velocity=velocity))

    @property
    def is_paused(self) -> bool:
        """Whether `pause` was called last."""
        return not self.playback.is_playing

    def pause(self) -> Edit:
        """Stop the playhead: the last frame stays, and the server computes no more than the look-ahead."""
        sent = self._send_play_state("the pause", session_pb2.PLAY_STATE_PAUSED)
        self.playback.pause()  # not before: one that is over plays what is left
        return sent

    def resume(self) -> Edit:
        """Let the playhead go on after `pause`."""
        sent = self._send_play_state("the end of the pause", session_pb2.PLAY_STATE_PLAYING)
        self.playback.resume()
        self._changed.set()
        return sent

    def _edit_constraints(
        self, what: str, constraints: Iterable[Constraint], *, remove: tuple[int, ...] = (), clear: bool = False
    ) -> Edit:
        targets = tuple(constraints)
        ids = self._take_constraint_ids(len(targets))
        upsert = [convert.constraint(key, target) for key, target in zip(ids, targets, strict=True)]
        edit = session_pb2.EditConstraints(upsert=upsert, remove=remove, clear=clear)
        sent = self._send_edit(what, session_pb2.SessionEvent(edit_constraints=edit), ids)
        sent.when_refused(lambda refusal: self._reached.refuse(ids, refusal))
        return sent

    def _take_constraint_ids(self, count: int) -> tuple[int, ...]:
        first = self._next_constraint_id
        self._next_constraint_id += count
        return tuple(range(first, first + count))

    def _send_play_state(self, what: str, state: session_pb2.PlayState) -> Edit:
        event = session_pb2.SessionEvent(set_play_state=session_pb2.SetPlayState(state=state))
        return self._send_edit(what, event)

    def _send_edit(
        self,
        what: str,
        event: session_pb2.SessionEvent,
        constraint_ids: tuple[int, ...] = (),
        prompt_id: int | None = None,
    ) -> Edit:
        edit = Edit(what, self._next_seq, self._clock(), constraint_ids, prompt_id)
        self._send(event)
        self._edits.add(edit)
        return edit

    @property
    @abstractmethod
    def _is_attached(self) -> bool:
        """Whether the server hears what is sent; else it waits among the unanswered."""

    @property
    def last_seq(self) -> int:
        """The number of the newest event: all of them outlive the server once `durable_seq` has come to it."""
        return self._next_seq - 1

    @property
    def _answered_seq(self) -> int:
        """Every event up to this number has been answered."""
        return min(self._unanswered, default=self._next_seq) - 1

    def _send(self, event: session_pb2.SessionEvent) -> None:
        """Give an event its number, and send it as soon as the server hears it. Raises why it never will."""
        if self._failure is not None:
            raise self._failure
        event.session = self.handle
        event.event_seq = self._next_seq
        self._carrier.check(event)
        if shifted(event, self._offset) is None:
            raise InvalidInput(event.WhichOneof("event") or "event", "frames that are past", "frames still to come")
        self._unanswered[self._next_seq] = event
        self._next_seq += 1
        if self._is_attached:
            self._transmit(event)

    def _transmit(self, event: session_pb2.SessionEvent) -> None:
        moved = shifted(event, self._offset)
        if moved is not None:
            self._carrier.send(moved)
