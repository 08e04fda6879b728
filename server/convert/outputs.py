"""The engine's outputs -> messages."""

from __future__ import annotations

import secrets

import numpy as np

from motiongen.v1 import motion_pb2, session_pb2
from server.catalog import Catalog
from server.engine.types import Chunk, Closed, Opened, Outcome, Output, PlanNotice


def session_update(output: Output, catalog: Catalog) -> session_pb2.SessionUpdate:
    """What the client is told of one output of the engine; `applied_seq` is the stream's to fill in."""
    update = session_pb2.SessionUpdate(session=output.session.handle)
    if isinstance(output, Chunk):
        update.chunk.plan = output.plan
        update.chunk.first_frame = output.first_frame
        update.chunk.frame_count = len(output.rows)
        update.chunk.committed_to = output.committed_to
        update.chunk.data = np.ascontiguousarray(output.rows, dtype="<f4").tobytes()
        update.chunk.scalar_type = motion_pb2.SCALAR_TYPE_F32_LE
    elif isinstance(output, PlanNotice):
        update.plan.plan = output.plan
        update.plan.valid_from = output.valid_from
        update.plan.cause = output.cause.value  # type: ignore[assignment]  # the engine's numbers are the protocol's
        update.plan.event_seqs.extend(output.event_seqs)
    elif isinstance(output, Outcome):
        update.outcome.CopyFrom(outcome_message(output))
    elif isinstance(output, Opened):
        # Stream and handle find it in the logs; the rest tells it from sessions of other servers and of a used handle.
        update.opened.session_id = f"{output.session.stream}-{output.session.handle}-{secrets.token_hex(6)}"
        update.opened.seed = output.seed
        update.opened.start_frame = output.start_frame
        update.opened.rig_id = catalog.facts.rig.rig_id
        update.opened.model_id = catalog.facts.model_id
        update.opened.frame_rate = catalog.facts.fps
        update.opened.lookahead_frames = output.lookahead
        update.opened.committed_horizon_frames = output.committed_horizon
        update.opened.denoise_steps = output.denoise_steps
        update.opened.scalar_type = motion_pb2.SCALAR_TYPE_F32_LE
    elif isinstance(output, Closed):
        update.closed.reason = output.reason.value  # type: ignore[assignment]
        update.closed.code = output.code
        update.closed.message = output.message
        update.closed.frames = output.num_frames
        update.closed.late_frames = output.late_frames
    return update


def outcome_message(outcome: Outcome) -> session_pb2.EditOutcome:
    """The message for an engine's or the service's own outcome."""
    message = session_pb2.EditOutcome(
        event_seq=outcome.event_seq,
        code=outcome.code,
        reason=outcome.reason,
        message=outcome.message,
        field=outcome.field,
        allowed=outcome.allowed,
    )
    if outcome.effective_frame is not None:
        message.effective_frame = outcome.effective_frame
    return message
