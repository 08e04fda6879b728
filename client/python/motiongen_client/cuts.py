"""Cuts: a character that stands elsewhere at once, or goes on from other frames, its own among them."""

from __future__ import annotations

import contextlib
from abc import ABC, abstractmethod

from motiongen.v1 import session_pb2
from motiongen_client import convert
from motiongen_client.edit import Edit
from motiongen_client.errors import InvalidInput
from motiongen_client.motion import Motion
from motiongen_client.types import StartPose, check_frame


class Cuts(ABC):
    """The part of a `Session` that cuts. Nothing is blended at a cut; frames are numbered on."""

    _offset: int

    def teleport(self, x_m: float, z_m: float, *, heading_rad: float = 0.0) -> Edit:
        """Stand at a ground position (world metres), facing somewhere, from the first frame that can still change."""
        seek = convert.seek(StartPose(x_m, z_m, heading_rad), None)
        return self._send_edit("the cut", session_pb2.SessionEvent(seek=seek))

    def cut_to(self, prior: Motion) -> Edit:
        """Go on from other frames, whole patches of them, as if they had come just before."""
        return self._send_edit("the cut", session_pb2.SessionEvent(seek=convert.seek(None, prior)))

    def seek(self, frame: int) -> Edit:
        """Go on from a frame of its own, as if the frames before that one had just been: another way out of a moment.

        The frames that follow are made anew, by what holds where they stand. The server keeps some seconds behind the
        playhead: of others EventRefused (FRAME_NOT_HELD) says which it has. `cut_to` goes on from what is kept here.
        """
        check_frame("frame", frame)
        if not frame:
            raise InvalidInput("frame", frame, "a frame from 1 on: none is before the first")
        return self._send_edit("the cut", session_pb2.SessionEvent(seek=self._seek_message(frame)))

    @abstractmethod
    def _send_edit(self, what: str, event: session_pb2.SessionEvent) -> Edit:
        """Tell the server."""

    @abstractmethod
    def _prior(self, end_frame: int) -> Motion:
        """The frames before one, as many as a window sees. Raises InvalidInput where they are not kept."""

    def _seek_message(self, frame: int) -> session_pb2.Seek:
        """By number where the session at the server has the frame; one from before it was opened anew as frames."""
        is_there = frame > self._offset
        return session_pb2.Seek(frame=frame) if is_there else convert.seek(None, self._prior(frame))

    def _say_as_frames(self, event: session_pb2.SessionEvent) -> None:
        """Change a seek to a frame that the session opened anew does not know, as far as its frames are kept here."""
        if event.seek.frame:
            with contextlib.suppress(InvalidInput):
                event.seek.CopyFrom(self._seek_message(event.seek.frame))
