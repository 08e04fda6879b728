"""Refusals of events, calls and whole streams: each has a reason for programs and a message for people."""
