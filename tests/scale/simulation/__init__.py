"""A fleet of servers, simulated event by event: arrivals in waves, a zone that fails, an upgrade under way."""
