"""Serializes items of a send queue as one StreamMotionResponse."""

from __future__ import annotations

from collections.abc import Iterable
from contextlib import AbstractContextManager, nullcontext

from motiongen.v1 import session_pb2
from motiongen_server.engine.types import PlanNotice
from motiongen_server.rpc.convert import Parts, append_frames, append_plan, append_update, write_update
from motiongen_server.rpc.convert.frames import PLAIN, FrameCoding
from motiongen_server.rpc.send_queue import Run, Said

_NOT_COUNTED = nullcontext()


def response_of(waiting: Iterable[Run | Said], work: AbstractContextManager[None] = _NOT_COUNTED) -> bytes:
    """The bytes of one message with all these items, in their order. work: encloses the work for answers."""
    response: Parts = []
    for item in waiting:
        if isinstance(item, Run):
            append_frames(response, item, item.coding if isinstance(item.coding, FrameCoding) else PLAIN)
            continue
        # applied_seq as of then: later events may have been answered since, in later updates.
        output, applied_seq = item
        if isinstance(output, PlanNotice):
            append_plan(response, applied_seq, output)
        else:
            with work:
                update = session_pb2.SessionUpdate(session=output.session.handle, applied_seq=applied_seq)
                write_update(update, output)
                append_update(response, update)
    return b"".join(response)
