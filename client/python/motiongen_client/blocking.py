"""The client without asyncio: every call blocks until it is done.

    with MotionClient("localhost:50051") as client:
        walker = client.open(prompt="a person walks forward")
        for frame in walker.frames(seconds=4):
            print(frame.time_s, frame.joint_positions_m()[0])

Each client has a background thread that runs its event loop; everything here hands work to that thread and waits. It
may be used from any thread, but not in a process that is forked afterwards.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Collection, Mapping, Sequence

import grpc

from motiongen_client import client, stream
from motiongen_client.background_loop import BackgroundLoop
from motiongen_client.blocking_edit import Edit
from motiongen_client.blocking_session import Session
from motiongen_client.channel import Option, Token
from motiongen_client.errors import StreamLost
from motiongen_client.line_policy import LinePolicy
from motiongen_client.prompts import Prompt
from motiongen_client.types import NO_PROMPTS, Catalog, Clip, Constraint, SessionOptions

__all__ = ["Edit", "MotionClient", "Session", "Stream"]


class Stream:
    """One call to the server with its sessions; use it as `with client.stream() as stream`."""

    def __init__(self, loop: BackgroundLoop, inner: stream.Stream) -> None:
        self._loop = loop
        self._inner = inner

    @property
    def is_connected(self) -> bool:
        """Whether there is a call at present."""
        return self._inner.is_connected

    @property
    def is_over(self) -> bool:
        """Whether it was closed or has failed for good."""
        return self._inner.is_over

    @property
    def draining(self) -> bool:
        """Whether the server has sent a Goodbye."""
        return self._inner.draining

    @property
    def replica_id(self) -> str:
        """The server's name."""
        return self._inner.replica_id

    @property
    def round_trip_s(self) -> float | None:
        """As last measured; None before the first measurement."""
        return self._inner.round_trip_s

    def ready(self) -> None:
        """Wait until there is a call, making one if needed, for `LinePolicy.hello_timeout_s` at most."""
        self._loop.run(self._inner.ready())

    def open(
        self,
        prompt: Prompt | None = None,
        *,
        later_prompts: Mapping[int, Prompt] = NO_PROMPTS,
        options: SessionOptions | None = None,
        constraints: Sequence[Constraint] = (),
        keep_s: float | None = 60.0,
    ) -> Session:
        """Create a character, directed by a prompt and constraints from its first frame on."""
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
        policy: LinePolicy | None = None,
        other_addresses: Collection[str] | Callable[[str], bool] = (),
    ) -> None:
        """As for the client with asyncio. A function for the token is called on the client's background thread."""
        self._inner = client.MotionClient(
            address,
            credentials=credentials,
            token=token,
            metadata=metadata,
            channel_options=channel_options,
            connect_timeout_s=connect_timeout_s,
            policy=policy,
            other_addresses=other_addresses,
        )
        self._connecting = threading.Lock()
        self._loop: BackgroundLoop | None = None

    @property
    def catalog(self) -> Catalog:
        """What the server offers."""
        return self._inner.catalog

    @property
    def is_connected(self) -> bool:
        """Whether the stream that `open` uses is connected to the server at present."""
        return self._inner.is_connected

    def connect(self) -> MotionClient:
        """Connect and fetch the catalogue, unless that has been done. `with` calls it. Raises ServerUnavailable."""
        with self._connecting:  # by one thread; the others wait for it
            if self._loop is not None and not self._loop.is_ending:
                return self
            loop = self._loop = BackgroundLoop()
            try:
                loop.run(self._inner.connect())
            except BaseException:
                loop.stop()
                raise
        return self

    @property
    def _own_loop(self) -> BackgroundLoop:
        """Raises StreamLost if the client was never connected."""
        if self._loop is None:
            raise StreamLost("CANCELLED", "the client was never connected")
        return self._loop

    def stream(self, *, report_hz: float = 2.0) -> Stream:
        """A new stream; enter it with `with`."""
        loop = self._own_loop
        return Stream(loop, loop.call(lambda: self._inner.stream(report_hz=report_hz)))

    def open(
        self,
        prompt: Prompt | None = None,
        *,
        later_prompts: Mapping[int, Prompt] = NO_PROMPTS,
        options: SessionOptions | None = None,
        constraints: Sequence[Constraint] = (),
        keep_s: float | None = 60.0,
    ) -> Session:
        """Create a character on a stream that the client keeps for this."""
        loop = self._own_loop
        opening = self._inner.open(
            prompt, later_prompts=later_prompts, options=options, constraints=constraints, keep_s=keep_s
        )
        return Session(loop, loop.run(opening))

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
        """Generate clips: motion of a fixed length, several samples at once."""
        loop = self._own_loop
        work = self._inner.generate_clip(
            prompt,
            num_frames=num_frames,
            num_samples=num_samples,
            later_prompts=later_prompts,
            options=options,
            constraints=constraints,
            timeout_s=timeout_s,
        )
        return loop.run(work)

    def close(self) -> None:
        """End all streams, the connection and the background thread. May be called again."""
        if self._loop is None:
            return
        try:
            self._loop.finish(self._inner.close())
        finally:
            self._loop.stop()

    def __enter__(self) -> MotionClient:
        return self.connect()

    def __exit__(self, *_: object) -> None:
        self.close()
