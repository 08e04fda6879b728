"""Converts between the contract's messages and this package's types. Pure."""

from motiongen_client.convert.answers import (
    code_name,
    constraint_reached,
    frame,
    opened,
    other_servers,
    outcome,
    residual,
    seconds,
    service_level,
    session_end,
    session_token,
    text,
    warnings,
)
from motiongen_client.convert.catalogs import catalog, rig
from motiongen_client.convert.frames import FrameReader
from motiongen_client.convert.outputs import check_outputs
from motiongen_client.convert.requests import (
    constraint,
    generate_clip,
    open_session,
    ping,
    prompt_span,
    seek,
    set_options,
)

__all__ = [
    "FrameReader", "catalog", "check_outputs", "code_name", "constraint", "constraint_reached", "frame",
    "generate_clip", "open_session", "opened", "other_servers", "outcome", "ping", "prompt_span", "residual", "rig",
    "seconds", "seek", "service_level", "session_end", "session_token", "set_options", "text",
    "warnings",
]  # fmt: skip
