"""Checks a GenerateClip request, and turns it into specs for the engine."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from google.protobuf.message import DecodeError

from motiongen.v1 import service_pb2, session_pb2
from motiongen_server.engine.types import (
    NOBODY,
    Asked,
    Float32Array,
    Open,
    Owner,
    Priority,
    RootPath,
    SessionKey,
    SessionSpec,
    Unplaced,
)
from motiongen_server.rpc.catalog import Catalog
from motiongen_server.rpc.convert import engine_event
from motiongen_server.rpc.convert.checks import check_range, refuse
from motiongen_server.rpc.errors.streams import malformed, request_of_too_many_fields
from motiongen_server.rpc.wire_fields import CLIP, Malformed, num_fields

MAX_SEED = 1 << 64
LOOKAHEAD_WINDOWS = 4
"""How many windows of a sample are made beyond what its client has taken."""


def check_extent(request: service_pb2.GenerateClipRequest, catalog: Catalog) -> None:
    """Raise EventRefused if a clip is too long, has too many samples, or sets what only sessions have."""
    limits = catalog.limits
    check_range(request.frame_count, 1, limits.max_clip_frames, "CLIP_LENGTH_OUT_OF_RANGE", "frame_count")
    check_range(request.sample_count, 0, limits.max_clip_samples, "TOO_MANY_SAMPLES", "sample_count")
    for name in ("priority", "lookahead_frames"):
        value = getattr(request.open, name)
        if value:
            allowed = "none: a clip is generated as a whole, in the background of sessions"
            raise refuse("NOT_FOR_CLIPS", f"open.{name}", f"{name} is {value}", allowed)
    if request.open.resume_token:
        given = "there is a token of a session that is to be resumed"
        raise refuse("NOT_FOR_CLIPS", "open.resume_token", given, "none: a clip starts anew; it may have prior_frames")


def clip_request(data: bytes, most_fields: int) -> service_pb2.GenerateClipRequest:
    """Parse the request of a call. Raises StreamRefused if it is malformed, or has too many fields."""
    try:
        if num_fields(data, 0, len(data), CLIP, most_fields) > most_fields:
            raise request_of_too_many_fields(most_fields)
        return service_pb2.GenerateClipRequest.FromString(data)
    except (DecodeError, Malformed) as error:
        raise malformed(str(error)) from error


def opening_event(request: service_pb2.GenerateClipRequest) -> session_pb2.SessionEvent:
    """The event that would open a session like the clip."""
    return session_pb2.SessionEvent(event_seq=1, open=request.open)


def last_frame_of(constraint: Asked) -> int:
    """The last frame that a constraint of a clip names; 0 if it is to be met as soon as possible, and names none."""
    if not isinstance(constraint, Unplaced):
        return constraint.last_frame
    if isinstance(constraint.target, RootPath) or constraint.at_any_frame:
        return 0
    return constraint.target.last_frame if constraint.last_frame is None else constraint.last_frame


def clip_specs(
    request: service_pb2.GenerateClipRequest,
    number: int,
    embeddings: Mapping[str, Float32Array],
    received_at: float,
    catalog: Catalog,
    owner: Owner = NOBODY,
) -> list[SessionSpec]:
    """A spec for each sample. number: identifies the call to the engine; owner: whose it is.

    Raises EventRefused.
    """
    event = engine_event(opening_event(request), SessionKey(number, 0), received_at, embeddings, catalog)
    assert isinstance(event, Open)
    num_frames = request.frame_count
    for index, constraint in enumerate(event.spec.constraints):
        last_frame = last_frame_of(constraint)
        if last_frame >= num_frames:
            given = f"its last frame is {last_frame}"
            allowed = f"frames 0 to {num_frames - 1} of the clip"
            raise refuse("CONSTRAINT_OUTSIDE_CLIP", f"open.constraints[{index}].frame", given, allowed)
    lookahead = min(num_frames, LOOKAHEAD_WINDOWS * catalog.facts.horizon)
    whole = replace(event.spec, priority=Priority.BATCH, lookahead=lookahead, clip_frames=num_frames, owner=owner)
    return [
        replace(whole, session=SessionKey(number, sample), seed=(whole.seed + sample) % MAX_SEED)
        for sample in range(request.sample_count or 1)
    ]
