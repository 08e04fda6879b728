"""One clip call: its samples, and the responses to its client for the engine's output."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from motiongen.v1 import motion_pb2, service_pb2, session_pb2
from motiongen_server.engine.types import (
    Asked,
    Chunk,
    Closed,
    CloseReason,
    Code,
    ConstraintReached,
    Opened,
    Outcome,
    Output,
    SessionKey,
    SessionSpec,
    Unplaced,
    Warned,
)
from motiongen_server.errors import EventRefused
from motiongen_server.models.registry import LoadedModel
from motiongen_server.rpc.convert import residual_of, write_update
from motiongen_server.rpc.convert.frames import FrameCoding
from motiongen_server.rpc.sessions.entry import session_name

OPEN_SEQ = 1


class Call:
    """under_way: the samples that are not complete.

    The engine knows constraints by their positions in the request, counted from 1: in a clip, several may have one id.
    """

    def __init__(
        self, specs: Sequence[SessionSpec], model: LoadedModel, coding: FrameCoding, warnings: tuple[Warned, ...] = ()
    ) -> None:
        asked = specs[0].constraints if specs else ()
        self._ids = [each.constraint_id for each in asked]
        numbered = tuple(_with_id(number, each) for number, each in enumerate(asked, 1))
        self.specs = [replace(spec, constraints=numbered) for spec in specs]
        self.model = model
        self._coding = coding
        self._warnings = warnings
        self.under_way: set[SessionKey] = set()
        self._reached: list[list[ConstraintReached]] = [[] for _ in specs]

    def responses(self, output: Output) -> list[service_pb2.GenerateClipResponse]:
        """The responses for an output. Raises EventRefused if it ends the call."""
        sample = output.session.handle
        if isinstance(output, Chunk):
            return [service_pb2.GenerateClipResponse(sample=sample, chunk=_frames(output, self._coding))]
        if isinstance(output, Opened):
            update = session_pb2.SessionUpdate()
            write_update(
                update,
                replace(
                    output,
                    warnings=self._warnings,
                    session_id=session_name(output.session),
                    scalar_type=self._coding.scalar_type,
                    outputs=self._coding.outputs,
                    placements=tuple(
                        replace(each, constraint_id=self._ids[each.constraint_id - 1]) for each in output.placements
                    ),
                ),
            )
            update.opened.lookahead_frames = update.opened.committed_horizon_frames = 0
            return [service_pb2.GenerateClipResponse(sample=sample, opened=update.opened)]
        if isinstance(output, ConstraintReached):
            self._reached[sample].append(output)
            return []
        if isinstance(output, Outcome):
            if output.event_seq != OPEN_SEQ:  # the answer to a Close that came after the sample's own end
                return []
            self.under_way.discard(output.session)
            raise refused(output)
        if isinstance(output, Closed):
            self.under_way.discard(output.session)
            if output.reason is not CloseReason.CLIENT:
                raise _lost(output)
            summary = service_pb2.ClipSummary(residuals=self._measured(sample))
            return [service_pb2.GenerateClipResponse(sample=sample, summary=summary)]
        return []

    def _measured(self, sample: int) -> list[service_pb2.ConstraintResidual]:
        """The residuals of a complete sample, in the order of its constraints."""
        told = {reached.constraint_id: reached for reached in self._reached[sample]}
        return [
            residual_of(replace(told[number], constraint_id=asked_id)) for number, asked_id in enumerate(self._ids, 1)
        ]


def _with_id(constraint_id: int, asked: Asked) -> Asked:
    if isinstance(asked, Unplaced):
        return replace(asked, target=replace(asked.target, constraint_id=constraint_id))
    return replace(asked, constraint_id=constraint_id)


def _frames(chunk: Chunk, coding: FrameCoding) -> motion_pb2.FrameChunk:
    data, origin = coding.encode(chunk.rows)
    return motion_pb2.FrameChunk(
        plan=chunk.plan,
        first_frame=chunk.first_frame,
        frame_count=len(chunk.rows),
        committed_to=chunk.first_frame + len(chunk.rows),
        data=data.tobytes(),
        scalar_type=coding.scalar_type,  # type: ignore[arg-type]  # a number of the contract
        root_origin_m=() if origin is None else origin.tolist(),
    )


def refused(outcome: Outcome) -> EventRefused:
    """The engine's refusal of a sample."""
    return EventRefused(
        outcome.code, outcome.reason, outcome.message, outcome.field, outcome.allowed, outcome.retry_after_s
    )


def _lost(closed: Closed) -> EventRefused:
    """The error for a sample that the engine gave up."""
    code = closed.code if closed.code is not Code.OK else Code.UNAVAILABLE
    message = closed.message or f"the server ended the clip ({closed.reason.name.lower()}); ask for it again"
    return EventRefused(code, "CLIP_LOST", message)
