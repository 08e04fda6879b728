"""How a client reaches its server: ChannelSettings (address, TLS, token, metadata, gRPC options) and Route."""

from __future__ import annotations

import re
import secrets
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from ipaddress import ip_address
from typing import Any, TypeAlias, cast

import grpc
import grpc.aio

from motiongen_client.errors import InvalidInput, OtherServer
from motiongen_client.types import as_tuple, check_text, check_type

Token: TypeAlias = str | Callable[[], str]
Option: TypeAlias = tuple[str, str | int]

OPTIONS: tuple[Option, ...] = (
    ("grpc.keepalive_time_ms", 30_000),
    ("grpc.keepalive_timeout_ms", 10_000),
    ("grpc.keepalive_permit_without_calls", 0),
    # A window of fixed size: with gRPC's own bandwidth estimate, it would buffer minutes of unread motion.
    ("grpc.http2.bdp_probe", 0),
    ("grpc.http2.lookahead_bytes", 256 * 1024),
    ("grpc.max_receive_message_length", 8 * 1024 * 1024),
    ("grpc.max_send_message_length", 8 * 1024 * 1024),
    # A stream has state, which a call transparently retried by gRPC would lack.
    ("grpc.enable_retries", 0),
    # Each call has a connection of its own; a shared one that hangs would hang the next call too.
    ("grpc.use_local_subchannel_pool", 1),
    # Notice a starting server soon; by default, gRPC waits up to two minutes.
    ("grpc.initial_reconnect_backoff_ms", 100),
    ("grpc.max_reconnect_backoff_ms", 2_000),
)
_NAMES_FOR_TLS = ("grpc.ssl_target_name_override", "grpc.default_authority")
REPLICA_KEY = "x-motiongen-key"
"""Metadata key by which a proxy can route all calls of a client to the one server that has its sessions."""
DRAWN_KEY = re.compile(r"[0-9a-f]{16}")
"""Form of the keys drawn at random here. They identify nobody, so servers may tell them to other clients."""
_UNIX = "unix:"
_MOST_PORT_DIGITS = 5
_MOST_OPTION = 2**31 - 1
_PROXY = "grpc.enable_http_proxy"
_KEY = re.compile(r"(?!grpc-)[0-9a-z_.-]+(?<!-bin)")
_TEXT = re.compile(r"[\x20-\x7e]+")
_TOKEN = re.compile(r"[\x21-\x7e]+")


def names_for_tls(address: str, chosen: Iterable[str]) -> list[Option]:
    """Options for checking a server's certificate. chosen: names of options that the application sets itself.

    For a Unix socket the certificate must be for localhost: gRPC would look for the socket's path in it.
    """
    is_ours = address.startswith(_UNIX) and not set(chosen).intersection(_NAMES_FOR_TLS)
    return [("grpc.default_authority", "localhost")] if is_ours else []


@dataclass(frozen=True)
class ChannelSettings:
    """address: host:port or unix:PATH. credentials: from `grpc.ssl_channel_credentials()`; None: plain text.

    token: sent with every call; or a function that returns it, called for every call, so that an expired token is
    replaced. metadata: sent with every call too. options: gRPC options, which override `OPTIONS`. Raises InvalidInput.
    """

    address: str
    credentials: grpc.ChannelCredentials | None = None
    token: Token | None = field(default=None, repr=False)
    metadata: Sequence[tuple[str, str]] = field(default=(), repr=False)
    options: Sequence[Option] = ()

    def __post_init__(self) -> None:
        check_text("address", self.address, "host:port, such as localhost:50051, or unix:PATH")
        host = _host_of(self.address)
        allowed = "what grpc.ssl_channel_credentials() returns, or None"
        check_type("credentials", self.credentials, grpc.ChannelCredentials | None, allowed)
        if self.token is not None and not callable(self.token):
            _check_token(self.token)
        for name in ("metadata", "options"):
            object.__setattr__(self, name, _pairs(name, getattr(self, name)))
        if self._is_bare and not _is_local(host):
            allowed = "TLS (credentials=grpc.ssl_channel_credentials()) where a token crosses the network"
            raise InvalidInput("credentials", None, allowed)
        if self._is_bare and any(name == _PROXY and value for name, value in self.options):
            raise InvalidInput("options", _PROXY, "TLS (credentials=...) where a token goes by a proxy")
        for key, text in self.metadata:
            if key == "authorization":
                raise InvalidInput("metadata", key, "token=..., which is sent by TLS or to this machine only")
            if not _KEY.fullmatch(key) or not isinstance(text, str) or not _TEXT.fullmatch(text):
                raise InvalidInput("metadata", key, "pairs of a key in lower case, not of gRPC's own, and ASCII text")
        for name, value in self.options:
            check_text("options", name, "names of gRPC options")
            is_number = isinstance(value, int) and -_MOST_OPTION <= value <= _MOST_OPTION
            if not is_number and not isinstance(value, bytes):
                check_text("options", value, f"a text, or a whole number of 32 bits, for {name}")  # type: ignore[arg-type]

    def open(self) -> grpc.aio.Channel:
        """A new channel."""
        chosen = {name for name, _ in self.options}
        options = [*self.options, *(option for option in OPTIONS if option[0] not in chosen)]
        if self._is_bare and _PROXY not in chosen:
            options.append((_PROXY, 0))  # gRPC would use a proxy from the environment even for this machine
        if self.credentials is None:
            channel = grpc.aio.insecure_channel(self.address, options=options)
        else:
            options += names_for_tls(self.address, chosen)
            channel = grpc.aio.secure_channel(self.address, self.credentials, options=options)
        if self.token is None and not self.metadata:
            return channel
        return cast(grpc.aio.Channel, _WithMetadata(channel, self._call_metadata))

    @property
    def routing_key(self) -> str:
        """The key by which a proxy chooses a server; "" if there is none."""
        return next((text for name, text in self.metadata if name == REPLICA_KEY), "")

    def routed_by(self, key: str) -> ChannelSettings:
        """The same settings with another routing key."""
        others = [pair for pair in self.metadata if pair[0] != REPLICA_KEY]
        return replace(self, metadata=(*others, (REPLICA_KEY, key)))

    @property
    def _is_bare(self) -> bool:
        """Whether a token is sent as plain text."""
        return self.token is not None and self.credentials is None

    def _call_metadata(self) -> tuple[tuple[str, str], ...]:
        token = self.token() if callable(self.token) else self.token
        if token is None:
            return tuple(self.metadata)
        _check_token(token)
        return (*self.metadata, ("authorization", f"Bearer {token}"))


class Route:
    """Where the calls of one stream lead: the same address and routing key until another server is wanted."""

    def __init__(self, settings: ChannelSettings, is_allowed: Callable[[str], bool] = lambda _: False) -> None:
        """is_allowed: whether servers may send this client, with its token, to an address."""
        self._settings = settings
        self._own_address = settings.address
        self._is_allowed = is_allowed
        self._named: list[ChannelSettings] = []

    @property
    def is_at_home(self) -> bool:
        """Whether it leads to the client's own address at present, rather than to one named by a server."""
        return self._settings.address == self._own_address

    def open(self) -> grpc.aio.Channel:
        """A new channel."""
        return self._settings.open()

    def follow(self, servers: Iterable[OtherServer]) -> bool:
        """Direct the next channel to the first of these servers that is allowed. Returns False if none is."""
        ways = [self._way(each) for each in servers]
        self._named = [way for way in ways if way is not None]
        if not self._named:
            return False
        self._settings = self._named.pop(0)
        return True

    def pass_over(self, *, is_starting: bool) -> None:
        """Direct the next channel to the next server that was named, since the present one does not serve calls.

        If none is left, it goes to the client's own address; with another key if the server there is only starting.
        """
        if self._named:
            self._settings = self._named.pop(0)
            return
        self._settings = replace(self._settings, address=self._own_address)
        if is_starting:
            self.change()

    def change(self) -> None:
        """Draw a new routing key, so that a proxy may choose another server. Keys of the application's are kept."""
        if has_drawn_key(self._settings):
            self._settings = self._settings.routed_by(drawn_key())

    def _way(self, server: OtherServer) -> ChannelSettings | None:
        """By the server's own address if that is allowed, else by its key; None if neither works."""
        if server.address and self._is_allowed(server.address):
            with suppress(InvalidInput):  # not a valid address
                return replace(self._settings, address=server.address)
        if server.routing_key and has_drawn_key(self._settings):
            with suppress(InvalidInput):  # not valid as metadata
                return replace(self._settings, address=self._own_address).routed_by(server.routing_key)
        return None


class _WithMetadata:
    """A channel whose calls all carry metadata.

    It does not use interceptors: with those, grpc.aio puts tasks and queues of its own between a call and its caller,
    so that the end of a call is noticed late.
    """

    def __init__(self, channel: grpc.aio.Channel, metadata: Callable[[], tuple[tuple[str, str], ...]]) -> None:
        self._channel = channel
        self._metadata = metadata

    def __getattr__(self, name: str) -> Any:
        found = getattr(self._channel, name)
        if name not in ("unary_unary", "unary_stream", "stream_unary", "stream_stream"):
            return found

        def method(*arguments: Any, **more: Any) -> Callable[..., Any]:
            call = found(*arguments, **more)
            return lambda *given, **also: call(*given, metadata=self._metadata(), **also)

        return method


def drawn_key() -> str:
    """A random routing key, for a client without one."""
    return secrets.token_hex(8)


def has_drawn_key(settings: ChannelSettings) -> bool:
    """Whether the routing key was drawn here, not chosen by an application."""
    return DRAWN_KEY.fullmatch(settings.routing_key) is not None


def _host_of(address: str) -> str:
    """The host of an address, or the whole address if it is a Unix socket. Raises InvalidInput."""
    is_text = address.isprintable()  # false for lone surrogates, which stand for bytes that are not UTF-8
    if is_text and address.startswith(_UNIX) and address != _UNIX:
        return address
    host, _, port = address.rpartition(":")
    is_number = port.isascii() and port.isdecimal() and len(port) <= _MOST_PORT_DIGITS
    if not is_text or not host or not is_number or not 0 < int(port) < 65536:
        allowed = "host:port with a port from 1 to 65535, such as localhost:50051, or unix:PATH"
        raise InvalidInput("address", address, allowed)
    if "://" in host:
        raise InvalidInput("address", address, f"host:port without a scheme: {address.rpartition('://')[2]}")
    if ":" in host and not (host.startswith("[") and host.endswith("]")):
        raise InvalidInput("address", address, f"an IPv6 address in brackets, such as [{host}]:{port}")
    return host


def _is_local(host: str) -> bool:
    """Whether a host is this machine."""
    if host == "localhost" or host.startswith(_UNIX):
        return True
    try:
        return ip_address(host.removeprefix("[").removesuffix("]")).is_loopback
    except ValueError:
        return False


def _pairs(name: str, given: Iterable[tuple[str, Any]]) -> tuple[tuple[str, Any], ...]:
    """Pairs of a text and something. Raises InvalidInput, without what was given, which may be a secret."""
    allowed = "pairs, such as [('key', 'value')]"
    try:
        pairs = as_tuple(name, given, allowed)
    except InvalidInput:
        raise InvalidInput(name, type(given).__name__, allowed) from None
    for pair in pairs:
        if not isinstance(pair, tuple | list) or len(pair) != 2 or not isinstance(pair[0], str):
            raise InvalidInput(name, type(pair).__name__, allowed)
    return tuple((key, value) for key, value in pairs)


def _check_token(token: str) -> None:
    if not isinstance(token, str):
        raise InvalidInput("token", type(token).__name__, "a text, or a function that returns one")
    if not _TOKEN.fullmatch(token):
        raise InvalidInput("token", f"{len(token)} characters", "printable ASCII without spaces")  # it stays secret
