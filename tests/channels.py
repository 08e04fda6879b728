"""How channels of tests connect."""

from __future__ import annotations

ALONE = (("grpc.use_local_subchannel_pool", 1),)
"""Options of a channel with a connection of its own, as a client elsewhere has; else those to an address share one."""
