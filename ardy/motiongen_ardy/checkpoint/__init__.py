"""Checkpoint folders: found by name or on the hub, read as untrusted input, written in the released layout."""
