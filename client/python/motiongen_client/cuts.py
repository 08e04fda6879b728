"""Cuts: moving a character elsewhere at once, or continuing it from other frames, or from earlier ones of its own."""

from __future__ import annotations

import contextlib
from abc import ABC, abstractmethod

from motiongen.v1 import session_pb2
from motiongen_client import convert
from motiongen_client.edit import Edit
from motiongen_client.errors import InvalidInput
from motiongen_client.motion import Motion
from motiongen_client.types import StartPose, check_frame, check_type


class Cuts(ABC):
    """The part of a `Session` that makes cuts. Nothing is blended at a cut; frame numbers continue."""

    _offset: int

    def teleport(self, x_m: float, z_m: float, *, heading_rad: float = 0.0) -> Edit:
        """Stand at a ground position (world metres) with a heading, from the first frame that can still change."""
        seek = convert.seek(StartPose(x_m, z_m, heading_rad), None)
        return self._send_edit("the cut", session_pb2.SessionEvent(seek=seek))

    def cut_to(self, prior: Motion) -> Edit:
        """Continue from other frames, whole patches of them, as if they had come just before."""
        check_type("prior", prior, Motion, "a Motion")
        return self._send_edit("the cut", session_pb2.SessionEvent(seek=convert.seek(None, prior)))

    def seek(self, frame: int) -> Edit:
        """Continue from one of the session's own frames, as if those before it had just been shown: a new way onward.

        The frames that follow are generated anew, by the prompts and constraints in force at their new numbers. The
        server keeps some seconds behind the playhead; for other frames, EventRefused (FRAME_NOT_HELD) says which it
        has. `cut_to` continues from frames kept here.
        """
        check_frame("frame", frame)
        if not frame:
            raise InvalidInput("frame", frame, "a frame from 1 on: none is before the first")
        return self._send_edit("the cut", session_pb2.SessionEvent(seek=self._seek_message(frame)))

    @abstractmethod
    def _send_edit(self, what: str, event: session_pb2.SessionEvent) -> Edit:
        """Send an edit to the server."""

    @abstractmethod
    def _prior(self, end_frame: int) -> Motion:
        """The last frames before end_frame, as many as a window sees. Raises InvalidInput if they are not kept."""

    def _seek_message(self, frame: int) -> session_pb2.Seek:
        """A seek by number if the server's session has the frame; as frames if it is from before a reopening."""
        is_there = frame > self._offset
        return session_pb2.Seek(frame=frame) if is_there else convert.seek(None, self._prior(frame))

    def _say_as_frames(self, event: session_pb2.SessionEvent) -> None:
        """Turn a seek to a frame from before the reopening into one with frames, if these are kept here."""
        if event.seek.frame:
            with contextlib.suppress(InvalidInput):
                event.seek.CopyFrom(self._seek_message(event.seek.frame))
