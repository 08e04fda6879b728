"""Snapshots: what sessions are, kept outside the process, so that another one can go on with them."""
