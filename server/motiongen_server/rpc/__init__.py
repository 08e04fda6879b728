"""The gateway's edge: checks gRPC streams and calls, and turns them into events for the engine."""
