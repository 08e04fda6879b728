"""Snapshots: the state of sessions, kept outside the process so that another process can continue them."""
