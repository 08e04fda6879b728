"""Checkpoint folders: by name or from the hub, read with suspicion, written in the released layout."""
