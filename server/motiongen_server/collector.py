"""The address of the OpenTelemetry collector that traces are sent to."""

from __future__ import annotations

from motiongen_server.addresses import is_port
from motiongen_server.settings import SettingError

PLAIN, TLS = "grpc:", "grpcs:"


def check_collector(address: str) -> None:
    """Raise SettingError unless the address is empty or that of a collector."""
    scheme, _, rest = address.partition(":")
    host, _, port = rest.rpartition(":")
    if address and (f"{scheme}:" not in (PLAIN, TLS) or not host or not is_port(port) or not int(port)):
        raise SettingError(f"trace_to is {address!r}; it must be {PLAIN}HOST:PORT, or {TLS}HOST:PORT for TLS")
