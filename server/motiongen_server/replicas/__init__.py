"""Which other servers of the same store have room: told by all of them, and named to clients that are refused here."""
