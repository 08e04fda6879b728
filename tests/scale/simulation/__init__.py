"""A fleet of servers, simulated event by event: arrivals in waves, a failing zone, a rolling upgrade."""
