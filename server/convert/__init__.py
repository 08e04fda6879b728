"""Protocol messages <-> engine values: pure, and the only room that checks what a client sent."""

from server.convert.events import engine_event, prompt_texts
from server.convert.outputs import session_update

__all__ = ["engine_event", "prompt_texts", "session_update"]
