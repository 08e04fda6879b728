"""Network addresses: how they are written, which count as one, and whether other machines can reach them."""

from __future__ import annotations

from collections.abc import Sequence
from ipaddress import IPv6Address, IPv6Network, ip_address

from motiongen_server.settings import SettingError

UNIX = "unix:"


def join_address(host: str, port: int) -> str:
    """host:port, with an IPv6 host in brackets; the path of a unix socket, unix:PATH, has no port."""
    if host.startswith(UNIX):
        return host
    return f"[{host}]:{port}" if ":" in host else f"{host}:{port}"


def host_of(address: str) -> str:
    """The host of host:port, without the brackets of IPv6."""
    return address.rpartition(":")[0].removeprefix("[").removesuffix("]")


def network_of(host: str) -> str:
    """What counts as one address for limits: an IPv4 address, or the /64 network of an IPv6 address.

    Whoever has one IPv6 address has all of its /64 (RFC 6177), and would otherwise have a budget for each. An
    IPv4-mapped IPv6 address counts as the IPv4 address; anything that is not an address is returned unchanged.
    """
    if ":" not in host:
        return host
    try:
        address = IPv6Address(host.partition("%")[0])  # without the zone of a link-local address
    except ValueError:
        return host
    if address.ipv4_mapped is not None:
        return str(address.ipv4_mapped)
    return str(IPv6Network((address, 64), strict=False))


def is_local(host: str) -> bool:
    """Whether only programs on this machine can reach a listener there. host: a name, an IP address, or unix:PATH.

    A name other than localhost may mean any address, so it counts as reachable by others.
    """
    if host == "localhost" or host.startswith(UNIX):
        return True
    try:
        return ip_address(host).is_loopback
    except ValueError:
        return False


def is_port(text: str) -> bool:
    """Whether it is a port number or 0, in ASCII digits."""
    return text.isascii() and text.isdecimal() and len(text) <= 5 and int(text) <= 65535


def check_exposure(setting: str, host: str, lacking: Sequence[str], insecure: bool) -> None:
    """Raise SettingError if other machines can reach a listener that lacks protection, unless `insecure` is set.

    setting: the name of the setting for the host. lacking: the protection that is missing, in words.
    """
    if lacking and not insecure and not is_local(host):
        raise SettingError(
            f"{setting} is {host!r}, which other machines reach, without {' and without '.join(lacking)}; add that, "
            "listen on a loopback address, or use --insecure if the network itself keeps others out"
        )


def proxy_options(address: str) -> tuple[tuple[str, int], ...]:
    """Options of a gRPC channel to host:port, so that this machine itself is never reached through a proxy.

    gRPC would use the proxy of `http_proxy` there, too; from a proxy elsewhere, the address means another machine.
    """
    return (("grpc.enable_http_proxy", 0),) if is_local(host_of(address)) else ()
