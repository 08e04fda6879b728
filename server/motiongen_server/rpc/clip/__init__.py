"""Clips: bounded motion for planners and tools, made by the same engine as sessions, in their background."""

from motiongen_server.rpc.clip.clip_service import ClipService

__all__ = ["ClipService"]
