"""ChannelSettings: how a client reaches its server: address, TLS, token, metadata, and gRPC's own options."""

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

Token: TypeAlias = str | Callable[[], str]
Option: TypeAlias = tuple[str, str | int]

OPTIONS: tuple[Option, ...] = (
    ("grpc.keepalive_time_ms", 30_000),
    ("grpc.keepalive_timeout_ms", 10_000),
    ("grpc.keepalive_permit_without_calls", 0),
    # A window of fixed size: left to its own measure of the line, gRPC would take in minutes of motion unread.
    ("grpc.http2.bdp_probe", 0),
    ("grpc.http2.lookahead_bytes", 256 * 1024),
    ("grpc.max_receive_message_length", 8 * 1024 * 1024),
    ("grpc.max_send_message_length", 8 * 1024 * 1024),
    # A stream carries state; a call repeated behind our back would carry none.
    ("grpc.enable_retries", 0),
    # Each call has a connection of its own: one that stopped would stop the next call too.
    ("grpc.use_local_subchannel_pool", 1),
    # A server that starts is seen soon; the default would wait up to two minutes.
    ("grpc.initial_reconnect_backoff_ms", 100),
    ("grpc.max_reconnect_backoff_ms", 2_000),
)
_NAMES_FOR_TLS = ("grpc.ssl_target_name_override", "grpc.default_authority")
REPLICA_KEY = "x-motiongen-key"
"""Metadata by which a proxy can bring all calls of one client to one server, which has its sessions."""
DRAWN_KEY = re.compile(r"[0-9a-f]{16}")
"""Those that are drawn here: they name nobody, so servers may tell them to others."""
_UNIX = "unix:"
_MOST_PORT_DIGITS = 5
_PROXY = "grpc.enable_http_proxy"
_KEY = re.compile(r"(?!grpc-)[0-9a-z_.-]+(?<!-bin)")
_TEXT = re.compile(r"[\x20-\x7e]+")
_TOKEN = re.compile(r"[\x21-\x7e]+")


def names_for_tls(address: str, chosen: Iterable[str]) -> list[Option]:
    """Options by which a server's certificate is checked, but for those that are chosen.

    A socket of this machine is localhost to it: gRPC would look for its path among the names of the certificate.
    """
    is_ours = address.startswith(_UNIX) and not set(chosen).intersection(_NAMES_FOR_TLS)
    return [("grpc.default_authority", "localhost")] if is_ours else []


@dataclass(frozen=True)
class ChannelSettings:
    """address: host:port or unix:PATH. credentials: of `grpc.ssl_channel_credentials()`; None speaks plain text.

    token: sent with every call, or what gives it, asked anew for every call, so that one that expires is followed by
    the next. metadata: sent with every call too. options: for gRPC, before those set here. Raises InvalidInput.
    """

    address: str
    credentials: grpc.ChannelCredentials | None = None
    token: Token | None = field(default=None, repr=False)
    metadata: Sequence[tuple[str, str]] = field(default=(), repr=False)
    options: Sequence[Option] = ()

    def __post_init__(self) -> None:
        host = _host_of(self.address)
        if isinstance(self.token, str):
            _check_token(self.token)
        if self._is_bare and not _is_local(host):
            allowed = "TLS (credentials=grpc.ssl_channel_credentials()) where a token crosses the network"
            raise InvalidInput("credentials", None, allowed)
        if self._is_bare and any(name == _PROXY and value for name, value in self.options):
            raise InvalidInput("options", _PROXY, "TLS (credentials=...) where a token goes by a proxy")
        for key, text in self.metadata:
            if key == "authorization":
                raise InvalidInput("metadata", key, "token=..., which is sent by TLS or to this machine only")
            if not _KEY.fullmatch(key) or not _TEXT.fullmatch(text):
                raise InvalidInput("metadata", key, "pairs of a key in lower case, not of gRPC's own, and ASCII text")

    def open(self) -> grpc.aio.Channel:
        """A new channel."""
        chosen = {name for name, _ in self.options}
        options = [*self.options, *(option for option in OPTIONS if option[0] not in chosen)]
        if self._is_bare and _PROXY not in chosen:
            options.append((_PROXY, 0))  # gRPC would use one of the environment for this machine too
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
        """The key by which a proxy chooses a server, "" for none."""
        return next((text for name, text in self.metadata if name == REPLICA_KEY), "")

    def routed_by(self, key: str) -> ChannelSettings:
        """The same, with another key."""
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
    """The way of one stream to a server: the same address and key with every call, until another server is wanted."""

    def __init__(self, settings: ChannelSettings, is_allowed: Callable[[str], bool] = lambda _: False) -> None:
        """is_allowed: whether a server may send this client, with its token, to an address."""
        self._settings = settings
        self._own_address = settings.address
        self._is_allowed = is_allowed
        self._named: list[ChannelSettings] = []

    @property
    def is_at_home(self) -> bool:
        """Whether it leads to the client's own address at present, and not to one that a server has named."""
        return self._settings.address == self._own_address

    def open(self) -> grpc.aio.Channel:
        """A new channel."""
        return self._settings.open()

    def follow(self, servers: Iterable[OtherServer]) -> bool:
        """Have the next channel lead to the first of these that this client may go to. False: there is none."""
        ways = [self._way(each) for each in servers]
        self._named = [way for way in ways if way is not None]
        if not self._named:
            return False
        self._settings = self._named.pop(0)
        return True

    def pass_over(self, *, is_starting: bool) -> None:
        """Have the next channel lead to the next server that was named, since this one serves nobody.

        Where none is left, to the client's own address; by another key where the server there is only starting.
        """
        if self._named:
            self._settings = self._named.pop(0)
            return
        self._settings = replace(self._settings, address=self._own_address)
        if is_starting:
            self.change()

    def change(self) -> None:
        """Have the next channel lead elsewhere, where a proxy places calls by their key and it was drawn here."""
        if has_drawn_key(self._settings):
            self._settings = self._settings.routed_by(drawn_key())

    def _way(self, server: OtherServer) -> ChannelSettings | None:
        """By the server's own address where that is allowed, else by its key; None where neither leads there."""
        if server.address and self._is_allowed(server.address):
            with suppress(InvalidInput):  # it is none
                return replace(self._settings, address=server.address)
        if server.routing_key and has_drawn_key(self._settings):
            with suppress(InvalidInput):  # metadata cannot carry it
                return replace(self._settings, address=self._own_address).routed_by(server.routing_key)
        return None


class _WithMetadata:
    """A channel whose calls all carry metadata.

    Not by interceptors: grpc.aio puts tasks and queues of its own between a call and whom it belongs to where there are
    any, and then a call that ends is told of late.
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
    """A key for a client that has none."""
    return secrets.token_hex(8)


def has_drawn_key(settings: ChannelSettings) -> bool:
    """Whether its key is none that an application has chosen."""
    return DRAWN_KEY.fullmatch(settings.routing_key) is not None


def _host_of(address: str) -> str:
    """Raises InvalidInput."""
    is_text = address.isprintable()  # half a pair of UTF-16, as bytes that are no UTF-8 come, is not
    if is_text and address.startswith(_UNIX) and address != _UNIX:
        return address
    host, _, port = address.rpartition(":")
    is_number = port.isascii() and port.isdecimal() and len(port) <= _MOST_PORT_DIGITS
    if not is_text or not host or not is_number or not 0 < int(port) < 65536:
        allowed = "host:port with a port from 1 to 65535, such as localhost:50051, or unix:PATH"
        raise InvalidInput("address", address, allowed)
    if ":" in host and not (host.startswith("[") and host.endswith("]")):
        raise InvalidInput("address", address, f"an IPv6 address in brackets, such as [{host}]:{port}")
    return host


def _is_local(host: str) -> bool:
    """Whether nothing that is sent there leaves this machine."""
    if host == "localhost" or host.startswith(_UNIX):
        return True
    try:
        return ip_address(host.removeprefix("[").removesuffix("]")).is_loopback
    except ValueError:
        return False


def _check_token(token: str) -> None:
    if not _TOKEN.fullmatch(token):
        raise InvalidInput("token", f"{len(token)} characters", "printable ASCII without spaces")  # and stays secret
