"""The same client without asyncio: every call blocks until it is done.

    with MotionClient("localhost:50051") as client:
        walker = client.open(prompt="a person walks forward")
        for frame in walker.frames(seconds=4):
            print(frame.time_s, frame.joint_positions_m()[0])

One background thread runs the event loop of one client; everything here hands work to it and waits.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence

import grpc
from numpy.typing import ArrayLike

from motiongen_client import client, edit, session, stream
from motiongen_client.background_loop import BackgroundLoop
from motiongen_client.channel import Option, Token
from motiongen_client.motion import Frame, Motion, Rig
from motiongen_client.prompts import Prompt
from motiongen_client.session import SessionStats
from motiongen_client.types import (
    NO_PROMPTS,
    Catalog,
    Clip,
    Constraint,
    Opened,
    Outcome,
    ServiceLevel,
    SessionEnd,
    SessionOptions,
)


class Edit:
    """A change on its way to the server. `wait()` for its Outcome, or leave it and go on."""

    def __init__(self, loop: BackgroundLoop, inner: edit.Edit) -> None:
        self._loop = loop
        self._inner = inner
        self.event_seq = inner.event_seq
        self.constraint_ids = inner.constraint_ids

    def wait(self) -> Outcome:
        """The server's answer. Raises EventRefused, SessionEnded or StreamLost."""

        async def work() -> Outcome:
            return await self._inner

        return self._loop.run(work())

    @property
    def outcome(self) -> Outcome | None:
        """The server's answer, if it has accepted the change already."""
        return self._inner.outcome

    @property
    def latency_s(self) -> float | None:
        """Seconds from sending the change to receiving the first frame it changed; None until then."""
        return self._inner.latency_s


class Session:
    """One character; see `motiongen_client.Session`, whose methods these are."""

    def __init__(self, loop: BackgroundLoop, inner: session.Session) -> None:
        self._loop = loop
        self._inner = inner

    @property
    def opened(self) -> Opened:
        """What the server chose for the session."""
        return self._inner.opened

    @property
    def rig(self) -> Rig:
        return self._inner.rig

    @property
    def service_level(self) -> ServiceLevel:
        """How well the server serves it at present."""
        return self._inner.service_level

    @property
    def end(self) -> SessionEnd | None:
        """How the session ended; None while it lives."""
        return self._inner.end

    @property
    def stats(self) -> SessionStats:
        """Counts and times so far."""
        return self._loop.call(lambda: self._inner.stats)

    def set_prompt(self, prompt: Prompt, *, frame: int | None = None) -> Edit:
        """Direct the motion by a text, now or from a frame on."""
        return self._edit(lambda: self._inner.set_prompt(prompt, frame=frame))

    def add_waypoint(self, x_m: float, z_m: float, *, frame: int, heading_rad: float | None = None) -> Edit:
        """Be at a ground position (world metres) at a frame."""
        return self._edit(lambda: self._inner.add_waypoint(x_m, z_m, frame=frame, heading_rad=heading_rad))

    def add_trajectory(
        self, positions_m: ArrayLike, *, first_frame: int, headings_rad: ArrayLike | None = None
    ) -> Edit:
        """Follow a path: positions_m (N, 2) world x, z in metres, one a frame; headings_rad (N,)."""
        return self._edit(
            lambda: self._inner.add_trajectory(positions_m, first_frame=first_frame, headings_rad=headings_rad)
        )

    def add_constraints(self, constraints: Iterable[Constraint]) -> Edit:
        """Add constraints to those there are."""
        return self._edit(lambda: self._inner.add_constraints(constraints))

    def set_constraints(self, constraints: Iterable[Constraint]) -> Edit:
        """Put these constraints in place of all there are."""
        return self._edit(lambda: self._inner.set_constraints(constraints))

    def remove_constraints(self, constraint_ids: Iterable[int]) -> Edit:
        """Drop constraints by the ids that `Edit.constraint_ids` gave."""
        return self._edit(lambda: self._inner.remove_constraints(constraint_ids))

    def clear_constraints(self) -> Edit:
        """Drop all constraints."""
        return self._edit(self._inner.clear_constraints)

    def set_velocity(
        self,
        x_mps: float,
        z_mps: float,
        *,
        seconds: float = 1.0,
        heading_rad: float | None = None,
        keep_prompt: bool = False,
    ) -> Edit:
        """Move over the ground at a velocity, metres a second, for so many seconds or until the next call."""
        return self._edit(
            lambda: self._inner.set_velocity(
                x_mps, z_mps, seconds=seconds, heading_rad=heading_rad, keep_prompt=keep_prompt
            )
        )

    def pause(self) -> Edit:
        """Stop the playhead."""
        return self._edit(self._inner.pause)

    def resume(self) -> Edit:
        """Let the playhead go on after `pause`."""
        return self._edit(self._inner.resume)

    def frame_in(self, seconds: float) -> int:
        """The frame that is shown `seconds` from now."""
        return self._loop.call(lambda: self._inner.frame_in(seconds))

    def frames(self, seconds: float | None = None, *, realtime: bool = True) -> Iterator[Frame]:
        """Each frame once, in order, in real time or as fast as they are generated."""
        frames = self._inner.frames(seconds, realtime=realtime)

        async def following() -> Frame | None:
            return await anext(frames, None)

        try:
            while (frame := self._loop.run(following())) is not None:
                yield frame
        finally:
            self._loop.leave(frames)

    def poll(self) -> Frame | None:
        """Move the playhead to the present and return the frame to show now; None before the first one came."""
        return self._loop.call(self._inner.poll)

    def motion(self, first_frame: int | None = None, end_frame: int | None = None) -> Motion:
        """The frames shown so far that are still kept, or those from first_frame up to end_frame - 1."""
        return self._loop.call(lambda: self._inner.motion(first_frame, end_frame))

    def close(self) -> SessionEnd:
        """End the session. Returns how it ended; calling it again returns the same."""
        return self._loop.run(self._inner.close())

    def __enter__(self) -> Session:
        return self

    def __exit__(self, *exc_info: object) -> None:
        self._loop.finish(self._inner.__aexit__(*exc_info))

    def _edit(self, make: Callable[[], edit.Edit]) -> Edit:
        return Edit(self._loop, self._loop.call(make))


class Stream:
    """One call to the server with its sessions; use it as `with client.stream() as stream`."""

    def __init__(self, loop: BackgroundLoop, inner: stream.Stream) -> None:
        self._loop = loop
        self._inner = inner

    def open(
        self,
        prompt: Prompt | None = None,
        *,
        later_prompts: Mapping[int, Prompt] = NO_PROMPTS,
        options: SessionOptions | None = None,
        constraints: Sequence[Constraint] = (),
        keep_s: float | None = 60.0,
    ) -> Session:
        """Make a character, directed by a prompt and constraints from its first frame on."""
        opening = self._inner.open(
            prompt, later_prompts=later_prompts, options=options, constraints=constraints, keep_s=keep_s
        )
        return Session(self._loop, self._loop.run(opening))

    def close(self) -> None:
        """End all sessions and the call. May be called again."""
        self._loop.finish(self._inner.close())

    def __enter__(self) -> Stream:
        self._loop.run(self._inner.start())
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


class MotionClient:
    """A connection to one server; use it as `with MotionClient("localhost:50051") as client`."""

    def __init__(
        self,
        address: str,
        *,
        credentials: grpc.ChannelCredentials | None = None,
        token: Token | None = None,
        metadata: Sequence[tuple[str, str]] = (),
        channel_options: Sequence[Option] = (),
        connect_timeout_s: float = 10.0,
    ) -> None:
        """As the client with asyncio; a function that gives the token is called on the client's own thread."""
        self._inner = client.MotionClient(
            address,
            credentials=credentials,
            token=token,
            metadata=metadata,
            channel_options=channel_options,
            connect_timeout_s=connect_timeout_s,
        )
        self._loop: BackgroundLoop

    @property
    def catalog(self) -> Catalog:
        """What the server offers."""
        return self._inner.catalog

    def connect(self) -> MotionClient:
        """Connect and fetch the catalogue. `with` does it. Raises ServerUnavailable."""
        self._loop = BackgroundLoop()
        try:
            self._loop.run(self._inner.connect())
        except BaseException:
            self._loop.stop()
            raise
        return self

    def stream(self, *, report_hz: float = 4.0) -> Stream:
        """A new stream, to be entered with `with`."""
        return Stream(self._loop, self._loop.call(lambda: self._inner.stream(report_hz=report_hz)))

    def open(
        self,
        prompt: Prompt | None = None,
        *,
        later_prompts: Mapping[int, Prompt] = NO_PROMPTS,
        options: SessionOptions | None = None,
        constraints: Sequence[Constraint] = (),
        keep_s: float | None = 60.0,
    ) -> Session:
        """Make a character on a stream that the client keeps for this."""
        opening = self._inner.open(
            prompt, later_prompts=later_prompts, options=options, constraints=constraints, keep_s=keep_s
        )
        return Session(self._loop, self._loop.run(opening))

    def generate_clip(
        self,
        prompt: Prompt | None = None,
        *,
        num_frames: int,
        num_samples: int = 1,
        later_prompts: Mapping[int, Prompt] = NO_PROMPTS,
        options: SessionOptions | None = None,
        constraints: Sequence[Constraint] = (),
        timeout_s: float | None = None,
    ) -> list[Clip]:
        """Bounded motion, several samples at once."""
        work = self._inner.generate_clip(
            prompt,
            num_frames=num_frames,
            num_samples=num_samples,
            later_prompts=later_prompts,
            options=options,
            constraints=constraints,
            timeout_s=timeout_s,
        )
        return self._loop.run(work)

    def close(self) -> None:
        """End all streams, the connection and the background thread. May be called again."""
        try:
            self._loop.finish(self._inner.close())
        finally:
            self._loop.stop()

    def __enter__(self) -> MotionClient:
        return self.connect()

    def __exit__(self, *_: object) -> None:
        self.close()
