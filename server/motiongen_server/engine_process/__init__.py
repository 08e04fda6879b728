"""The engine in a process of its own: what crosses between it and the gateway, and both ends of the way."""
