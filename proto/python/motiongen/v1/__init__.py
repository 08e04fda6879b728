"""Version 1 of the contract: `motion_pb2`, `session_pb2`, `service_pb2`, `service_pb2_grpc`."""
