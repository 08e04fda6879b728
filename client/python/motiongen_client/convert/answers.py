"""Converts a server's answers about a session from messages."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from itertools import islice

from google.protobuf.duration_pb2 import Duration

from motiongen.v1 import motion_pb2, service_pb2, session_pb2
from motiongen_client.errors import EventRefused, OtherServer, ProtocolViolation
from motiongen_client.types import (
    ConstraintReached,
    Deviation,
    ModelWarning,
    Opened,
    Outcome,
    Placement,
    Residual,
    ServiceLevel,
    SessionEnd,
)
from motiongen_client.types.checks import MOST_FRAME

_MOST_OTHER_SERVERS = 3  # the contract's limit; each may be called in turn
MOST_CHARACTERS = 4096
"""Limit on each text of an answer that is kept, far above those of honest servers."""
MOST_WARNINGS = 64
"""Limit on the warnings of an answer that are kept. There is one for each kind of mistake, or for each prompt."""
MOST_PLACEMENTS = 16384
"""Limit on the placements of an answer: one for each constraint that a request of a MiB can hold."""
WARNINGS_LEFT_OUT = "WARNINGS_LEFT_OUT"


def text(given: str) -> str:
    """A server's text as it is kept. If it is too long, it is cut, and says so at its end."""
    left_out = len(given) - MOST_CHARACTERS
    return given if left_out <= 0 else f"{given[:MOST_CHARACTERS]}… ({left_out} more characters were left out)"


def frame(number: int, offset: int = 0) -> int:
    """A server's frame number as the client counts. offset: the client's frame numbers minus the server's.

    Raises ProtocolViolation for a number beyond `MOST_FRAME`.
    """
    if number > MOST_FRAME:
        raise ProtocolViolation(f"frame {number} is out of range; frames are numbered up to {MOST_FRAME}")
    return number + offset


def opened(message: session_pb2.SessionOpened, offset: int = 0) -> Opened:
    """What the server chose. offset: as for `frame`."""
    return Opened(
        session_id=text(message.session_id),
        seed=message.seed,
        start_frame=frame(message.start_frame, offset),
        rig_id=text(message.rig_id),
        model_id=text(message.model_id),
        frame_rate_hz=message.frame_rate,
        lookahead_frames=message.lookahead_frames,
        committed_horizon_frames=message.committed_horizon_frames,
        denoise_steps=message.denoise_steps,
        warnings=warnings(message.warnings),
        placements=placements(message.placements, offset),
        outputs={block.name: block.width for block in message.outputs},
    )


def session_token(message: session_pb2.SessionOpened) -> str:
    """The token by which a session is resumed. Raises ProtocolViolation if it is too long: cut, it would be useless."""
    if len(message.session_token) > MOST_CHARACTERS:
        given = f"a session token has {len(message.session_token)} characters"
        raise ProtocolViolation(f"{given}; at most {MOST_CHARACTERS} are kept")
    return message.session_token


def placements(messages: Sequence[motion_pb2.ConstraintPlacement], offset: int = 0) -> tuple[Placement, ...]:
    """Where constraints were placed. offset: as for `frame`. Raises ProtocolViolation if there are too many."""
    if len(messages) > MOST_PLACEMENTS:
        raise ProtocolViolation(f"an answer has {len(messages)} placements; at most {MOST_PLACEMENTS} are kept")
    return tuple(
        Placement(
            constraint_id=each.constraint_id,
            first_frame=frame(each.first_frame, offset),
            last_frame=frame(each.last_frame, offset),
            arrival_frame=frame(each.arrival_frame, offset),
            anchor_frame=frame(each.anchor_frame, offset),
            anchor_x_m=each.anchor_x,
            anchor_z_m=each.anchor_z,
            anchor_heading_rad=each.anchor_heading,
        )
        for each in messages
    )


def warnings(messages: Sequence[session_pb2.EventWarning]) -> tuple[ModelWarning, ...]:
    """The first of the warnings; if there are too many, a last one says how many were left out."""
    first = [ModelWarning(text(each.reason), text(each.message), text(each.field)) for each in messages[:MOST_WARNINGS]]
    if (left_out := len(messages) - MOST_WARNINGS) > 0:
        first.append(ModelWarning(WARNINGS_LEFT_OUT, f"{left_out} more warnings of the server were left out", ""))
    return tuple(first)


def other_servers(messages: Iterable[session_pb2.OtherServer]) -> tuple[OtherServer, ...]:
    first = islice(messages, _MOST_OTHER_SERVERS)
    return tuple(OtherServer(text(each.address), text(each.routing_key)) for each in first)


def outcome(message: session_pb2.EditOutcome, event: str, offset: int = 0) -> Outcome | EventRefused:
    """What became of an event. event: what it was, in words; offset: as for `frame`."""
    if message.code == 0:
        effective_frame = frame(message.effective_frame, offset) if message.HasField("effective_frame") else None
        placed = placements(message.placements, offset)
        return Outcome(message.event_seq, effective_frame, warnings(message.warnings), placed)
    retry_after_s = seconds(message.retry_after) if message.HasField("retry_after") else None
    code = code_name(message.code)
    return EventRefused(
        event,
        code,
        text(message.reason),
        text(message.message),
        field=text(message.field),
        allowed=text(message.allowed),
        retry_after_s=retry_after_s,
        other_servers=other_servers(message.other_servers),
    )


def service_level(message: session_pb2.ServiceLevel) -> ServiceLevel:
    tier = session_pb2.ServiceTier.Name(message.tier) if message.tier in _SERVICE_TIERS else "UNSPECIFIED"
    return ServiceLevel(tier.removeprefix("SERVICE_TIER_").lower(), message.denoise_steps)


def constraint_reached(message: session_pb2.ConstraintReached, offset: int = 0) -> ConstraintReached:
    """What became of a constraint. offset: as for `frame`."""
    return ConstraintReached(
        constraint_id=message.constraint_id,
        met=message.met,
        frame=frame(message.frame, offset),
        position_error_m=message.position_error_m if message.HasField("position_error_m") else None,
        rotation_error_rad=message.rotation_error_rad if message.HasField("rotation_error_rad") else None,
    )


def session_end(message: session_pb2.SessionClosed) -> SessionEnd:
    reason = session_pb2.CloseReason.Name(message.reason) if message.reason in _CLOSE_REASONS else "UNSPECIFIED"
    return SessionEnd(
        reason=reason.removeprefix("CLOSE_REASON_").lower(),
        message=text(message.message),
        frames=message.frames,
        late_frames=message.late_frames,
    )


_CLOSE_REASONS = frozenset(session_pb2.CloseReason.values())


_SERVICE_TIERS = frozenset(session_pb2.ServiceTier.values())


def residual(message: service_pb2.ConstraintResidual) -> Residual:
    """By how much a clip misses a constraint."""

    def deviation(name: str) -> Deviation | None:
        value: service_pb2.Deviation = getattr(message, name)
        return Deviation(value.mean, value.worst) if message.HasField(name) else None

    return Residual(
        num_frames=message.frame_count,
        position_m=deviation("position_m"),
        heading_rad=deviation("heading_rad"),
        rotation_rad=deviation("rotation_rad"),
        met=message.met,
    )


def seconds(duration: Duration) -> float:
    return duration.seconds + duration.nanos / 1e9


# google.rpc.Code, whose numbers EditOutcome.code and SessionClosed.code use
_CODE_NAMES = (
    "OK", "CANCELLED", "UNKNOWN", "INVALID_ARGUMENT", "DEADLINE_EXCEEDED", "NOT_FOUND", "ALREADY_EXISTS",
    "PERMISSION_DENIED", "RESOURCE_EXHAUSTED", "FAILED_PRECONDITION", "ABORTED", "OUT_OF_RANGE", "UNIMPLEMENTED",
    "INTERNAL", "UNAVAILABLE", "DATA_LOSS", "UNAUTHENTICATED",
)  # fmt: skip


def code_name(code: int) -> str:
    """The name of a google.rpc.Code; the number itself if it is unknown."""
    return _CODE_NAMES[code] if 0 <= code < len(_CODE_NAMES) else str(code)
