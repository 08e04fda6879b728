"""Options of the tests' gRPC channels."""

from __future__ import annotations

ALONE = (("grpc.use_local_subchannel_pool", 1),)
"""Gives a channel its own connection, as clients elsewhere have; otherwise channels to one address share one."""
