"""Refusals: why an event, a call or a whole stream is refused, in words for programs and for people."""
