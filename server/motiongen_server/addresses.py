"""Addresses to listen on: how they are written, and whether others than this machine can reach them."""

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
    """What is counted as one address, for limits that hold for each: an IPv4 address, or the /64 of an IPv6 one.

    Whoever has any IPv6 address has all of its /64 (RFC 6177), so that each of them would have a budget of its own. An
    IPv4 address that is written as an IPv6 one counts as the former; what is no address is left as it is.
    """
    if ":" not in host:
        return host
    try:
        address = IPv6Address(host.partition("%")[0])  # without the interface of a link-local one
    except ValueError:
        return host
    if address.ipv4_mapped is not None:
        return str(address.ipv4_mapped)
    return str(IPv6Network((address, 64), strict=False))


def is_local(host: str) -> bool:
    """Whether only programs of this machine reach what listens there. host: a name, an IP address, or unix:PATH.

    A name other than localhost may mean any address, so it counts as one that others reach.
    """
    if host == "localhost" or host.startswith(UNIX):
        return True
    try:
        return ip_address(host).is_loopback
    except ValueError:
        return False


def is_port(text: str) -> bool:
    """Whether it is a port's number, 0 too, in the digits that everybody reads."""
    return text.isascii() and text.isdecimal() and len(text) <= 5 and int(text) <= 65535


def check_exposure(setting: str, host: str, lacking: Sequence[str], insecure: bool) -> None:
    """Raise SettingError where others reach a listener without the protection that it lacks, unless that is meant.

    setting: the name of the host's; lacking: what would protect it, in words.
    """
    if lacking and not insecure and not is_local(host):
        raise SettingError(
            f"{setting} is {host!r}, which other machines reach, without {' and without '.join(lacking)}; give that, "
            "listen on a loopback address, or say --insecure where the network itself keeps others away"
        )


def proxy_options(address: str) -> tuple[tuple[str, int], ...]:
    """Options of a gRPC channel to host:port: to this machine itself never by a proxy that the environment names.

    gRPC would go by `http_proxy` there too, which may lie elsewhere, where it finds another machine, or nobody.
    """
    return (("grpc.enable_http_proxy", 0),) if is_local(host_of(address)) else ()
