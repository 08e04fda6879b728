"""The gateway's edge: streams and calls of gRPC, checked and turned into events of the engine."""
