"""Protocol messages <-> engine values: pure functions, and the only room that checks the content of messages."""

from motiongen_server.rpc.convert.events import engine_event, playhead_of, round_trip_s
from motiongen_server.rpc.convert.options import asked_steps, coding_of
from motiongen_server.rpc.convert.outputs import residual_of, write_update
from motiongen_server.rpc.convert.placing import constraints_in, num_paths
from motiongen_server.rpc.convert.prompts import UNENCODED, prompt_texts, with_embeddings
from motiongen_server.rpc.convert.resuming import check_resume
from motiongen_server.rpc.convert.warned import warnings_of
from motiongen_server.rpc.convert.wire import Parts, append_frames, append_plan, append_update

__all__ = [
    "UNENCODED",
    "Parts",
    "append_frames",
    "append_plan",
    "append_update",
    "asked_steps",
    "check_resume",
    "coding_of",
    "constraints_in",
    "engine_event",
    "num_paths",
    "playhead_of",
    "prompt_texts",
    "residual_of",
    "round_trip_s",
    "warnings_of",
    "with_embeddings",
    "write_update",
]
