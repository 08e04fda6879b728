"""Bytes that are not a message of the protocol, or too many: the call ends with a status, others are unaffected."""

from __future__ import annotations

import grpc
import pytest
from google.rpc import error_details_pb2
from grpc_status import rpc_status

from motiongen.v1 import service_pb2
from motiongen_compliance.messages import addressed, edit_prompts, span
from motiongen_compliance.mistakes import Status
from motiongen_compliance.target import Scene, Target

SERVICE = "/motiongen.v1.MotionService"
NO_MESSAGE = b"\x0a\xff"  # a field longer than the message
HELLO = service_pb2.StreamMotionRequest(hello=service_pb2.ClientHello()).SerializeToString()


async def end_of(target: Target, method: str, messages: list[bytes]) -> tuple[grpc.StatusCode, str]:
    """Code and reason that a call ends with after it has sent these messages."""
    call = target.raw(f"{SERVICE}/{method}")
    try:
        for message in messages:
            await call.write(message)
        await call.done_writing()
        while await call.read() is not grpc.aio.EOF:
            pass
    except (grpc.aio.AioRpcError, grpc.aio.UsageError, grpc.aio.InternalError):
        pass  # the call ended while the messages were being sent
    code, status = await call.code(), await rpc_status.aio.from_call(call)
    info = error_details_pb2.ErrorInfo()
    reasons = [info.reason for detail in (status.details if status else ()) if detail.Unpack(info)]
    return code, "".join(reasons)


@pytest.mark.parametrize("before", [[], [HELLO]], ids=["first", "later"])
async def test_malformed_message_ends_only_its_own_stream(scene: Scene, target: Target, before: list[bytes]) -> None:
    ended = await end_of(target, "StreamMotion", [*before, NO_MESSAGE])
    assert ended == (Status.INVALID_ARGUMENT, "MALFORMED_REQUEST")
    await scene.others_play_on()


@pytest.mark.parametrize(
    ("method", "messages", "code", "reason"),
    [
        ("GetCatalog", [NO_MESSAGE], Status.INVALID_ARGUMENT, "MALFORMED_REQUEST"),
        ("GenerateClip", [NO_MESSAGE], Status.INVALID_ARGUMENT, "MALFORMED_REQUEST"),
        ("GetCatalog", [b"\x0a\xff\x7f" + b"x" * 16383], Status.INVALID_ARGUMENT, "REQUEST_TOO_LONG"),
        ("GetCatalog", [], Status.UNIMPLEMENTED, "ONE_REQUEST_EXPECTED"),
        ("GetCatalog", [b"", b""], Status.UNIMPLEMENTED, "ONE_REQUEST_EXPECTED"),
        ("GenerateClip", [], Status.UNIMPLEMENTED, "ONE_REQUEST_EXPECTED"),
    ],
)
async def test_call_takes_exactly_one_valid_request(
    scene: Scene, target: Target, method: str, messages: list[bytes], code: grpc.StatusCode, reason: str
) -> None:
    assert await end_of(target, method, messages) == (code, reason)
    await scene.others_play_on()


def message_of(num_bytes: int) -> service_pb2.StreamMotionRequest:
    """An edit whose message has that many bytes; its prompt is too long for any server."""

    def of(num_characters: int) -> service_pb2.StreamMotionRequest:
        return service_pb2.StreamMotionRequest(events=[addressed(edit_prompts(span("x" * num_characters)), 1, 2)])

    return of(num_bytes - (of(num_bytes).ByteSize() - num_bytes))


async def test_message_up_to_the_size_limit_is_accepted_and_a_longer_one_ends_the_stream(scene: Scene) -> None:
    most = scene.talk.catalog.limits.max_request_bytes
    longest = message_of(most)
    assert longest.ByteSize() == most
    await scene.talk.say(longest)
    assert (await scene.talk.answer(1, 2)).reason == "PROMPT_TOO_LONG"
    await scene.talk.plays_on(1)
    await scene.talk.say(message_of(most + 1))
    assert await scene.talk.to_the_end() is Status.RESOURCE_EXHAUSTED
    await scene.other.plays_on(1)
