"""Which other servers of the same store have room: each reports its own; clients that are refused here are told."""
