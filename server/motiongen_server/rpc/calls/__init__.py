"""Calls of gRPC: who may make one, how long its request is waited for, and the small services beside the motion."""
