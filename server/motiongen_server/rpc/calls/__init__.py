"""gRPC calls: who may make them, how long their requests may take, and the health and reflection services."""
