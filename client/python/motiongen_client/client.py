"""MotionClient, the entry point: a connection to one server, its catalogue, and streams of sessions."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import replace
from importlib.metadata import PackageNotFoundError, version

import grpc
import grpc.aio

from motiongen.v1 import service_pb2
from motiongen.v1.service_pb2_grpc import MotionServiceStub
from motiongen_client import clip, convert
from motiongen_client.backoff import Backoff
from motiongen_client.catalogs import has_model, newest_catalog
from motiongen_client.channel import ChannelSettings, Option, Route, Token, drawn_key, has_drawn_key
from motiongen_client.elsewhere import Elsewhere
from motiongen_client.errors import EventRefused, ServerUnavailable, StreamLost
from motiongen_client.line_policy import LinePolicy
from motiongen_client.prompts import Prompt
from motiongen_client.session import Session
from motiongen_client.status import MOST_TIMEOUT_S, NOT_ALLOWED, answer_of, error_of
from motiongen_client.stream import Stream
from motiongen_client.types import NO_PROMPTS, Catalog, Clip, Constraint, SessionOptions, check_number, check_type


class MotionClient:
    """A connection to one motiongen server. Use it as `async with MotionClient("localhost:50051") as client`.

    address, credentials, token, metadata, channel_options: see `ChannelSettings`. Give a token that expires as a
    function that returns the current one. connect_timeout_s: how long to wait for a server that is ready. policy: what
    to do when the connection is lost.
    catalog: what the server offers, as of the last request: it is fetched on connecting, on each reconnection, and when
    a model is wanted that the held catalogue lacks.
    """

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
        """Raises InvalidInput.

        other_addresses: where a server without free capacity may send this client, with its token: addresses, or a
        function that says whether one is allowed. Not needed through a proxy, where all servers have the same address.
        """
        settings = ChannelSettings(address, credentials, token, metadata, channel_options)
        self._settings = settings if settings.routing_key else settings.routed_by(drawn_key())
        check_number("connect_timeout_s", connect_timeout_s, "a number of seconds", lambda s: s == s)  # any but NaN
        check_type("policy", policy, LinePolicy | None, "a LinePolicy, or None")
        self.address = address
        self.catalog: Catalog
        self._connect_timeout_s = connect_timeout_s
        self._policy = policy or LinePolicy()
        self._connecting = asyncio.Lock()
        self._channel: grpc.aio.Channel | None = None
        self._stub: MotionServiceStub
        self._streams: list[Stream] = []
        takes_keys = has_drawn_key(self._settings)
        self._elsewhere = Elsewhere(self._stream, other_addresses, takes_keys=takes_keys)
        self._own_stream: Stream | None = None
        self._starting: asyncio.Task[Stream] | None = None  # of the client's own stream

    async def connect(self) -> MotionClient:
        """Wait for the server and fetch its catalogue. Raises ServerUnavailable or NotAllowed.

        `async with` calls it. Does nothing if the client is connected; if it is being connected, waits for that.
        """
        async with self._connecting:
            if self._channel is not None:
                return self
            self._channel = self._settings.open()
            self._stub = MotionServiceStub(self._channel)
            try:
                self.catalog = convert.catalog(await self._await_catalog())
            except BaseException:
                await self.close()
                raise
        return self

    async def _await_catalog(self) -> service_pb2.GetCatalogResponse:
        """Ask until a server that is ready answers, or the time is up."""
        time, backoff = asyncio.get_running_loop().time, Backoff()
        ends_s = time() + self._connect_timeout_s
        while True:
            left_s = ends_s - time()
            try:
                request = service_pb2.GetCatalogRequest()
                most_s = min(max(left_s, 0.001), MOST_TIMEOUT_S)
                call = self._stub.GetCatalog(request, timeout=most_s, wait_for_ready=True)
                return await answer_of(call)
            except grpc.aio.AioRpcError as error:
                failure = error
            if failure.code() in NOT_ALLOWED:
                raise error_of(failure, "connecting", self.address) from None
            wait_s = backoff.next_s()
            if failure.code() is not grpc.StatusCode.UNAVAILABLE or time() + wait_s > ends_s:
                raise ServerUnavailable(self.address, self._why_unavailable(failure)) from None
            await asyncio.sleep(wait_s)

    def _why_unavailable(self, failure: grpc.aio.AioRpcError) -> str:
        """What kept `connect` from its catalogue. gRPC tells nobody why a handshake failed: what to check is named."""
        if failure.code() is not grpc.StatusCode.DEADLINE_EXCEEDED:
            return f"{failure.code().name}, {failure.details()}"
        why = f"no answer within {self._connect_timeout_s:g} s"
        if self._settings.credentials is not None:
            why += "; its certificate must name this address and come from an authority that is trusted here, and it "
            why += "may require one of the client"
        return why

    async def _renew_catalog(self) -> None:
        """Fetch the catalogue again, since models may have been loaded or unloaded. Raises ServerUnavailable."""
        self._take_catalog(await newest_catalog(self._stub, self.catalog, self.address, self._policy.hello_timeout_s))

    def _take_catalog(self, catalog: Catalog) -> None:
        self.catalog = catalog

    def stream(self, *, report_hz: float = 2.0) -> Stream:
        """A new stream; enter it with `async with`. It carries many sessions, so most applications need only one."""
        return self._stream("", "", report_hz, moves=False)

    def _stream(self, address: str, routing_key: str, report_hz: float = 2.0, *, moves: bool = True) -> Stream:
        """A stream, to another address or with another routing key if given. moves: its sessions may change streams."""
        self._check_connected()
        settings = replace(self._settings, address=address or self.address)
        route = Route(settings.routed_by(routing_key) if routing_key else settings, self._elsewhere.is_allowed)
        stream = Stream(
            route.open,
            settings.address,
            self.catalog,
            agent_name(),
            report_hz=report_hz,
            policy=self._policy,
            move=self._elsewhere.move if moves else None,
            route=route,
            on_catalog=None if address or routing_key else self._take_catalog,  # another server may have other models
        )
        self._streams = [each for each in self._streams if not each.is_over]
        self._streams.append(stream)
        return stream

    async def _own(self) -> Stream:
        """The stream that `open` uses; concurrent callers wait for the same one."""
        if self._own_stream is not None and not self._own_stream.is_over:
            return self._own_stream
        if self._starting is None or self._starting.done():
            self._starting = asyncio.create_task(self._start_own(), name="motiongen-start")
            self._starting.add_done_callback(_see)
        return await asyncio.shield(self._starting)  # a cancelled caller must not cancel it for the others

    async def _start_own(self) -> Stream:
        self._own_stream = await self._stream("", "").start()
        return self._own_stream

    @property
    def is_connected(self) -> bool:
        """Whether the stream that `open` uses is connected to the server at present."""
        return self._own_stream is not None and self._own_stream.is_connected

    async def open(
        self,
        prompt: Prompt | None = None,
        *,
        later_prompts: Mapping[int, Prompt] = NO_PROMPTS,
        options: SessionOptions | None = None,
        constraints: Sequence[Constraint] = (),
        keep_s: float | None = 60.0,
    ) -> Session:
        """Create a character on a stream that the client keeps for this; otherwise as `Stream.open`.

        If the server has no free capacity, the client asks a server that it names, on another stream. It does the same
        when the session has to continue after a loss.
        """
        own = await self._own()

        async def open_on(stream: Stream) -> Session:
            return await stream.open(
                prompt, later_prompts=later_prompts, options=options, constraints=constraints, keep_s=keep_s
            )

        return await self._elsewhere.open(own, open_on)

    async def generate_clip(
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
        """Generate num_samples clips of num_frames frames each, as fast as the server's free capacity allows.

        later_prompts: keyed by the frame at which each takes over. Sample n uses seed + n. timeout_s: the time after
        which the server stops working on them. Raises InvalidInput, UnknownName, EventRefused, DeadlineExceeded or
        ServerUnavailable.
        """
        self._check_connected()
        wanted = SessionOptions() if options is None else options
        check_type("options", wanted, SessionOptions, "SessionOptions, or None")

        async def made() -> list[Clip]:
            return await clip.generate_clip(
                self._stub,
                self.address,
                self.catalog,
                prompt,
                num_frames=num_frames,
                num_samples=num_samples,
                later_prompts=later_prompts,
                options=wanted,
                constraints=constraints,
                timeout_s=timeout_s,
            )

        if not has_model(self.catalog, wanted):
            await self._renew_catalog()
        try:
            return await made()
        except EventRefused as refusal:
            if wanted.model_id or refusal.reason != "UNKNOWN_MODEL":
                raise
        await self._renew_catalog()  # the default model has been unloaded since
        return await made()

    def _check_connected(self) -> None:
        if self._channel is None:
            raise StreamLost("CANCELLED", "the client is closed, or was never connected")

    async def close(self) -> None:
        """End all streams and the connection. May be called again."""
        channel, self._channel = self._channel, None  # from here on, no new stream can be made
        await self._elsewhere.close()
        await asyncio.gather(*(stream.close() for stream in self._streams))  # each may wait for a server that hangs
        if self._starting is not None:
            await asyncio.gather(self._starting, return_exceptions=True)  # it fails at once, since its stream is closed
        self._streams.clear()
        self._own_stream = None
        if channel is not None:
            await channel.close(None)

    async def __aenter__(self) -> MotionClient:
        return await self.connect()

    async def __aexit__(self, *_: object) -> None:
        await self.close()


def _see(starting: asyncio.Task[Stream]) -> None:
    """Retrieve the failure of a start that nobody may await any more; otherwise asyncio would report it as a bug."""
    if not starting.cancelled():
        starting.exception()


def agent_name() -> str:
    """Name and version of this library, for the server's logs."""
    try:
        return f"motiongen-python/{version('motiongen-client')}"
    except PackageNotFoundError:
        return "motiongen-python/source"  # run from a checkout, not installed
