"""Whether the settings have this server tell others of its room."""

from __future__ import annotations

from motiongen_server.replicas.directory import RedisDirectory
from motiongen_server.replicas.other_servers import OtherServers
from motiongen_server.snapshots.stores import is_for_several_servers


def open_other_servers(store: str, address: str) -> OtherServers | None:
    """None where the store of sessions is of this machine alone. Nothing is asked of a Redis yet.

    address: where clients reach this server, "" where they come through a proxy only.
    """
    return OtherServers(RedisDirectory(store), address) if is_for_several_servers(store) else None
