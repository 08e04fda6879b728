"""The targets of `tests.bench.fuzz_edge`: `python -m tests.bench.fuzz_targets NAME SECONDS FOLDER`.

libFuzzer ends the process: with code 0 after so many seconds, with another if a target raises what its reader does not
promise. FOLDER: where inputs that have reached new code are kept.
"""

from __future__ import annotations

import asyncio
import contextlib
import sys
from collections.abc import Callable
from pathlib import Path

import atheris

with atheris.instrument_imports(include=["motiongen_server.rpc", "motiongen_server.engine_process.codec"]):
    import grpc.aio

    from motiongen.v1 import motion_pb2, service_pb2, session_pb2
    from motiongen_server.engine_process.codec import Codec, CodecError
    from motiongen_server.errors import EventRefused, StreamRefused
    from motiongen_server.models.registry import LoadedModel, ModelRegistry
    from motiongen_server.rpc.clip.request import check_extent, clip_request, clip_specs
    from motiongen_server.rpc.convert import UNENCODED
    from motiongen_server.rpc.streams.reader import StreamReader
    from motiongen_server.rpc.streams.stream import Stream
    from motiongen_server.snapshots.record import SessionRecord

from tests.server.rpc.streams.test_event_order import Engine, Prompts, make_catalog
from tests.server.snapshots.records import a_record

Event = session_pb2.SessionEvent
CATALOG = make_catalog(stream_events_per_second=1e9, events_per_second=1e9, hard_backlog_bytes=1 << 30)
HELLO = service_pb2.StreamMotionRequest(hello=service_pb2.ClientHello()).SerializeToString()
MOST_BYTES = 12_000
"""The longest input. Messages of more than 4,096 bytes are counted and split up."""


class Sender:
    """The client's side of a call: sends a hello, then each message, and ends."""

    def __init__(self, messages: list[bytes]) -> None:
        self._messages = iter([HELLO, *messages])

    async def read(self) -> object:
        return next(self._messages, grpc.aio.EOF)


class StreamTarget:
    """A stream to a server whose engine accepts everything. Two bytes before each message give its length."""

    def __init__(self) -> None:
        self._loop = asyncio.new_event_loop()
        prompts = Prompts()
        prompts.go.set()
        self._model = LoadedModel("fake", Engine(), prompts, CATALOG)  # type: ignore[arg-type]

    def __call__(self, data: bytes) -> None:
        self._loop.run_until_complete(self._read(data))

    async def _read(self, data: bytes) -> None:
        registry = ModelRegistry(self._model)
        stream = Stream(1, registry)
        messages = []
        while len(data) > 2:
            length = data[0] << 8 | data[1]
            messages.append(data[2 : 2 + length])
            data = data[2 + length :]
        try:
            await StreamReader(registry, "fuzz").read(stream, Sender(messages))  # type: ignore[arg-type]
        except StreamRefused:
            return
        while (response := stream.next_response()) is not None:
            for update in service_pb2.StreamMotionResponse.FromString(response).updates:
                if update.HasField("outcome") and update.outcome.reason == "INTERNAL":
                    raise AssertionError(update.outcome.message)
        stream.lose()

    @staticmethod
    def seeds() -> list[bytes]:
        span = motion_pb2.PromptSpan(prompt_id=1, text="walk")
        waypoint = motion_pb2.Constraint(constraint_id=1, frame=40, waypoint=motion_pb2.Waypoint(x=1.0, z=2.0))
        path = motion_pb2.RootTrajectory(positions=[0.0, 0.0, 0.0, 0.5], headings=[0.0, 0.1])
        joints = motion_pb2.JointTargets(joints=[0], positions=[0.0, 1.0, 0.0], rotations=[1.0, 0.0, 0.0, 0.0])
        constraints = [
            waypoint,
            motion_pb2.Constraint(constraint_id=2, frame=9, root_trajectory=path),
            motion_pb2.Constraint(constraint_id=3, frame=9, joint_targets=joints, weight=0.5),
        ]
        edit = session_pb2.EditConstraints(upsert=constraints, remove=[4])
        events = [
            Event(event_seq=1, open=session_pb2.OpenSession(prompts=[span], constraints=[waypoint], seed=1)),
            Event(event_seq=2, edit_constraints=edit),
            Event(event_seq=3, set_velocity=session_pb2.SetVelocity(x=1.0, hold_frames=20)),
            Event(playhead=session_pb2.Playhead(frame=5, buffered_to=9)),
            Event(event_seq=4, edit_prompts=session_pb2.EditPrompts(upsert=[span], remove=[2])),
            Event(event_seq=5, set_options=session_pb2.SetOptions(denoise_steps=3)),
            Event(event_seq=6, close=session_pb2.CloseSession()),
        ]
        request = service_pb2.StreamMotionRequest
        alone = [request(events=[event]).SerializeToString() for event in events]
        long = request(events=[events[0], *[events[3]] * 500, *events[1:]]).SerializeToString()
        return [b"".join(len(each).to_bytes(2, "big") + each for each in message) for message in (alone, [long])]


class ClipTarget:
    """The input as a request for a clip."""

    def __call__(self, data: bytes) -> None:
        with contextlib.suppress(StreamRefused, EventRefused):
            request = clip_request(data, CATALOG.limits.max_event_fields)
            check_extent(request, CATALOG)
            clip_specs(request, 1, UNENCODED, 0.0, CATALOG)

    @staticmethod
    def seeds() -> list[bytes]:
        waypoint = motion_pb2.Constraint(constraint_id=1, frame=30, waypoint=motion_pb2.Waypoint(x=1.0, z=2.0))
        opening = session_pb2.OpenSession(constraints=[waypoint], denoise_steps=4, seed=3)
        return [service_pb2.GenerateClipRequest(frame_count=40, sample_count=2, open=opening).SerializeToString()]


class RecordTarget:
    """The input as a saved session, as if a store had changed it together with its checksum."""

    def __init__(self) -> None:
        self._codec: Codec[SessionRecord] = Codec(SessionRecord)

    def __call__(self, data: bytes) -> None:
        with contextlib.suppress(CodecError):
            self._codec.decode(data)

    @staticmethod
    def seeds() -> list[bytes]:
        return [Codec(SessionRecord).encode(a_record())]


Target = StreamTarget | ClipTarget | RecordTarget
TARGETS: dict[str, Callable[[], Target]] = {"stream": StreamTarget, "clip": ClipTarget, "record": RecordTarget}


def run(name: str, seconds: float, corpus: Path) -> None:
    """Run one target until libFuzzer ends the process."""
    target = TARGETS[name]()
    for number, seed in enumerate(target.seeds()):
        (corpus / f"seed-{number}").write_bytes(seed)
    options = [f"-max_total_time={round(seconds)}", f"-max_len={MOST_BYTES}", "-timeout=5", "-print_final_stats=1"]
    atheris.Setup([sys.argv[0], *options, f"-artifact_prefix={corpus}/", str(corpus)], target)
    atheris.Fuzz()


if __name__ == "__main__":
    run(sys.argv[1], float(sys.argv[2]), Path(sys.argv[3]))
