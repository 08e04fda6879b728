"""Decides by the settings whether this server exchanges its free capacity with others."""

from __future__ import annotations

from motiongen_server.replicas.directory import RedisDirectory
from motiongen_server.replicas.other_servers import OtherServers
from motiongen_server.snapshots.stores import is_for_several_servers


def open_other_servers(store: str, address: str) -> OtherServers | None:
    """None if the store of sessions is for this machine only. A Redis is not connected to yet.

    address: where clients reach this server, "" if only through a proxy.
    """
    return OtherServers(RedisDirectory(store), address) if is_for_several_servers(store) else None
