"""Direction: the prompts, constraints, velocities and pauses of a session, each sent at once and in order."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Iterable

from numpy.typing import ArrayLike

from motiongen.v1 import session_pb2
from motiongen_client import convert
from motiongen_client.carrier import Carrier
from motiongen_client.changes import Changes
from motiongen_client.edit import Edit
from motiongen_client.errors import EventRefused, InvalidInput
from motiongen_client.motion import Rig
from motiongen_client.playback import Playback
from motiongen_client.prompts import Prompt, prompt_name
from motiongen_client.reached import ReachedBook
from motiongen_client.sending import Sending
from motiongen_client.types import (
    Constraint,
    Flexible,
    HeadingTarget,
    RootPath,
    RootTrajectory,
    Waypoint,
    as_array,
    as_tuple,
    check_finite,
    check_flag,
    check_frame,
    check_whole,
)

PRESENT_PROMPT_ID = 1  # the prompt set without a frame; scheduled prompts take the ids above it


class Direction(Sending):
    """The part of a `Session` with which an application directs it. Every change returns an `Edit`."""

    rig: Rig
    playback: Playback

    def __init__(self, handle: int, carrier: Carrier, clock: Callable[[], float]) -> None:
        super().__init__(handle, carrier, clock)
        self._next_constraint_id = 1
        self._next_prompt_id = PRESENT_PROMPT_ID + 1
        self._scheduled_prompts: dict[int, int] = {}  # prompt id -> start frame, once the server has accepted it
        self._reached = ReachedBook(self._expects)
        self._changed = Changes()  # set when something has arrived, or is due now

    def set_prompt(
        self, prompt: Prompt, *, frame: int | None = None, end_frame: int | None = None, prompt_id: int | None = None
    ) -> Edit:
        """Direct the motion by a text, such as "a person walks forward", by a Preset, or by a TextEmbedding.

        Without `frame` it replaces the present prompt as soon as possible. With `frame` it is scheduled: it takes over
        at that frame and holds until another takes over. With `end_frame` it is temporary: it ends before that frame,
        and the earlier prompt holds again. `Edit.prompt_id` is its id: pass it as prompt_id to replace the prompt, at
        other frames if you like, or to `remove_prompts`.
        """
        for name, value in (("frame", frame), ("end_frame", end_frame)):
            if value is not None:
                check_frame(name, value)
        if end_frame is not None and end_frame <= (frame or 0):
            raise InvalidInput("end_frame", end_frame, f"a frame above {frame or 0}, the first that it holds for")
        if prompt_id is not None:
            most = self._next_prompt_id - 1
            check_whole("prompt_id", prompt_id, "the prompt_id of an earlier Edit", least=1, most=most)
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
        if frame is not None and end_frame is None:  # a prompt with an end needs no removal
            key, scheduled = prompt_id, frame
            sent.when_accepted(lambda: self._scheduled_prompts.__setitem__(key, scheduled))
        return sent

    def _begun_prompts(self, prompt_id: int, is_replaced: bool) -> list[int]:
        """Ids of begun prompts to remove when another is set. is_replaced: the one in force is among them."""
        begun = [key for key, start in self._scheduled_prompts.items() if start <= self.playback.playhead]
        begun.sort(key=self._scheduled_prompts.__getitem__)
        return [key for key in (begun if is_replaced else begun[:-1]) if key != prompt_id]

    def _unschedule(self, prompt_ids: Iterable[int], edit: Edit) -> None:
        """Unschedule prompts that an edit removes or replaces. If it is refused they are restored, unless unknown."""
        scheduled = self._scheduled_prompts
        gone = {key: scheduled.pop(key) for key in prompt_ids if key in scheduled}

        def put_back(refusal: EventRefused) -> None:
            if refusal.reason != "UNKNOWN_PROMPT":
                self._scheduled_prompts = gone | self._scheduled_prompts

        edit.when_refused(put_back)

    def remove_prompts(self, prompt_ids: Iterable[int]) -> Edit:
        """Remove prompts by their ids (`Edit.prompt_id`). Without any prompt in force, the motion has no text."""
        ids = _ids("prompt_ids", prompt_ids)
        edit = session_pb2.EditPrompts(remove=ids)
        sent = self._send_edit("the removal of prompts", session_pb2.SessionEvent(edit_prompts=edit))
        self._unschedule(ids, sent)
        return sent

    def add_waypoint(
        self, x_m: float, z_m: float, *, frame: int, last_frame: int | None = None, heading_rad: float | None = None
    ) -> Edit:
        """Be at a ground position (world metres) at a frame; `frame_in` gives the frame some seconds from now.

        With last_frame: at any frame from `frame` to last_frame.
        """
        return self.add_constraints([Flexible(Waypoint(frame, x_m, z_m, heading_rad), last_frame)])

    def go_to(self, x_m: float, z_m: float, *, heading_rad: float | None = None, is_relative: bool = False) -> Edit:
        """Walk to a ground position, however far, as soon as a person can be there; `Outcome.placements` says when.

        is_relative: x_m is to the left of the character, z_m ahead of it, and heading_rad relative to its heading.
        """
        return self.add_constraints(
            [Flexible(Waypoint(0, x_m, z_m, heading_rad), at_any_frame=True, is_relative=is_relative)]
        )

    def follow_path(
        self, corners_m: ArrayLike, *, speed_mps: float | None = None, smoothing_m: float | None = None
    ) -> Edit:
        """Walk from here along straight lines through corners_m (N, 2), world x, z in metres, and stand at the last.

        speed_mps: 1.2 unless given; slower in bends. smoothing_m: how far corners are cut, 0.3 m unless given.
        """
        return self.add_constraints([RootPath(as_array("corners_m", corners_m, (None, 2)), speed_mps, smoothing_m)])

    def add_trajectory(
        self, positions_m: ArrayLike, *, first_frame: int, headings_rad: ArrayLike | None = None
    ) -> Edit:
        """Be at positions_m (N, 2), world x, z in metres, one per frame from `first_frame`; headings_rad (N,)."""
        headings = None if headings_rad is None else as_array("headings_rad", headings_rad, (None,))
        return self.add_constraints(
            [RootTrajectory(first_frame, as_array("positions_m", positions_m, (None, 2)), headings)]
        )

    def add_constraints(self, constraints: Iterable[Constraint]) -> Edit:
        """Add constraints to the present ones. `Edit.constraint_ids` are their ids, in the order given."""
        return self._edit_constraints("the addition of constraints", constraints)

    def replace_constraint(self, constraint_id: int, constraint: Constraint) -> Edit:
        """Replace a constraint by its id (`Edit.constraint_ids`); the new one has the same id."""
        most = self._next_constraint_id - 1
        check_whole("constraint_id", constraint_id, "one of the constraint_ids of an earlier Edit", least=1, most=most)
        edit = session_pb2.EditConstraints(upsert=[convert.constraint(constraint_id, constraint)])
        sent = self._send_edit("a constraint", session_pb2.SessionEvent(edit_constraints=edit), (constraint_id,))
        sent.is_replacement = True
        self._reached.replace(constraint_id)
        sent.when_refused(lambda _: self._reached.replaced(constraint_id, is_accepted=False))
        return sent

    def add_heading(self, heading_rad: float, *, frame: int) -> Edit:
        """Face a direction (radians about +Y, 0 toward +Z) at a frame, wherever the character is."""
        return self.add_constraints([HeadingTarget(frame, heading_rad)])

    def set_constraints(self, constraints: Iterable[Constraint]) -> Edit:
        """Replace all constraints with these."""
        return self._edit_constraints("the replacement of all constraints", constraints, clear=True)

    def remove_constraints(self, constraint_ids: Iterable[int]) -> Edit:
        """Remove constraints by their ids (`Edit.constraint_ids`)."""
        return self._edit_constraints("the removal of constraints", (), remove=_ids("constraint_ids", constraint_ids))

    def clear_constraints(self) -> Edit:
        """Remove all constraints."""
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
        """Move over the ground at a world velocity in metres per second, as soon as possible; 0, 0 means stand still.

        Each call replaces the one before, and ends after `seconds`: call it again while a stick is held. heading_rad:
        where to face meanwhile; None: in the direction of movement. Meanwhile the prompt is the model's own for that
        speed (`Model.locomotion_presets`), if it has one, unless keep_prompt keeps the session's. At speeds beyond the
        model's training, feet may glide; the answer then has a warning.
        """
        for name, value in (("x_mps", x_mps), ("z_mps", z_mps), ("seconds", seconds)):
            check_finite(name, value)
        if heading_rad is not None:
            check_finite("heading_rad", heading_rad)
        check_flag("keep_prompt", keep_prompt)
        hold_frames = max(self.rig.frames_in(seconds), 0)
        if hold_frames >= 1 << 32:
            raise InvalidInput("seconds", seconds, "at most Limits.max_hold_frames frames")
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
        """Whether the session is paused."""
        return not self.playback.is_playing

    def pause(self) -> Edit:
        """Stop the playhead: the last frame stays, and the server generates no further than the look-ahead."""
        sent = self._send_play_state("the pause", session_pb2.PLAY_STATE_PAUSED)
        if not sent.done():  # a session that is over plays what is left instead
            self.playback.pause()
        return sent

    def resume(self) -> Edit:
        """Let the playhead go on after `pause`."""
        sent = self._send_play_state("the end of the pause", session_pb2.PLAY_STATE_PLAYING)
        if not sent.done():
            self.playback.resume()
            self._changed.set()
        return sent

    @abstractmethod
    def _expects(self, constraint_id: int) -> bool:
        """Whether the constraint with this id is being set, or was accepted and is not over."""

    def _edit_constraints(
        self, what: str, constraints: Iterable[Constraint], *, remove: tuple[int, ...] = (), clear: bool = False
    ) -> Edit:
        targets = as_tuple("constraints", constraints, "several constraints, such as [Waypoint(...)]")
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


def _ids(name: str, ids: Iterable[int]) -> tuple[int, ...]:
    """Ids as a tuple. Raises InvalidInput."""
    allowed = f"several ids, such as the {name.removesuffix('s')}s of earlier Edits"
    given = as_tuple(name, ids, allowed)
    for each in given:
        check_whole(name, each, allowed)
    return given
