"""The gateway's connection to an encoder service: the service's certificate, and the gateway's token."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import grpc

from motiongen_server.addresses import host_of, is_local
from motiongen_server.config import ServerConfig
from motiongen_server.identity.tls import check_authorities
from motiongen_server.identity.watched import Watched
from motiongen_server.settings import SettingError


def encoder_credentials(config: ServerConfig) -> grpc.ChannelCredentials:
    """Credentials by which the encoder service's certificate is verified. Raises SettingError."""
    if not config.text_encoder_ca:
        return grpc.ssl_channel_credentials()
    try:
        check_authorities(config.text_encoder_ca)
        return grpc.ssl_channel_credentials(Path(config.text_encoder_ca).read_bytes())
    except (ValueError, OSError) as error:
        raise SettingError(f"text_encoder_ca cannot be used: {error}") from error


def encoder_token(config: ServerConfig, address: str, by_tls: bool) -> Callable[[], str] | None:
    """Returns the current token of the file when called; None if no token is set. Raises SettingError."""
    path = config.text_encoder_token
    if not path:
        return None
    if not by_tls and not is_local(host_of(address)):
        raise SettingError("text_encoder_token would cross the network in plain text; give grpcs:HOST:PORT")
    try:
        watched = Watched("text encoder's token", [path], lambda: _read_token(Path(path)))
    except (ValueError, OSError) as error:
        raise SettingError(f"text_encoder_token cannot be read: {error}") from error

    def present() -> str:
        watched.look()
        return watched.value

    return present


def _read_token(path: Path) -> str:
    """Raises ValueError if no call can carry the token, as when the file is just being written, and OSError."""
    token = path.read_text(encoding="utf-8-sig").strip()  # some editors write a byte order mark
    if not token or not token.isascii() or not token.isprintable() or " " in token:
        raise ValueError("it must be one word of ASCII characters")
    return token
