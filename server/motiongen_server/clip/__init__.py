"""Clips: bounded motion for planners and tools, made by the same engine as sessions, in their background."""

from motiongen_server.clip.desk import ClipDesk

__all__ = ["ClipDesk"]
