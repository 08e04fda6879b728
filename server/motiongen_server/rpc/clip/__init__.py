"""Clips: bounded motion for planners and tools, made by the same engine as sessions, in their background."""

from motiongen_server.rpc.clip.clip_service import ClipService
from motiongen_server.rpc.clip.request import clip_request

__all__ = ["ClipService", "clip_request"]
