"""The encoder service over gRPC: what it answers, shares and refuses."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import AsyncIterator, Sequence
from contextlib import asynccontextmanager
from typing import Any

import grpc
import grpc.aio
import numpy as np
import pytest
from google.rpc import error_details_pb2
from grpc_status import rpc_status
from numpy.typing import NDArray

from motiongen.v1 import encoder_pb2, encoder_pb2_grpc
from motiongen_ardy.text import TextEncoderUnavailable
from motiongen_server.rpc.limits import PeerLimits
from motiongen_server.text.encoder.service import TextEncoderService, add_text_encoder
from motiongen_server.text.prompts import PromptEncoder
from tests.contract.local import LengthEncoder
from tests.waiting import LIMIT_S


class GatedEncoder(LengthEncoder):
    """Answers once the test sets `go`, with `error` if there is one."""

    def __init__(self) -> None:
        self.go = threading.Event()
        self.go.set()
        self.asked: list[str] = []
        self.error: Exception | None = None

    def encode(self, texts: Sequence[str]) -> NDArray[np.float32]:
        self.asked += texts
        assert self.go.wait(LIMIT_S)
        if self.error is not None:
            raise self.error
        return super().encode(texts)


@asynccontextmanager
async def serving(encoder: GatedEncoder, limits: PeerLimits | None = None, **settings: Any) -> AsyncIterator[Any]:
    """A stub of a service that caches 10 texts and takes requests of at most 3 texts with 20 characters each."""
    prompts = PromptEncoder(encoder, 10, **settings)
    server = grpc.aio.server()
    service = TextEncoderService(prompts, 2, 3, 20, limits=limits)
    add_text_encoder(service, server)
    port = server.add_insecure_port("127.0.0.1:0")
    await server.start()
    async with grpc.aio.insecure_channel(f"127.0.0.1:{port}") as channel, asyncio.timeout(LIMIT_S):
        yield encoder_pb2_grpc.TextEncoderServiceStub(channel)
    encoder.go.set()
    await server.stop(None)
    await asyncio.to_thread(prompts.close)


def asking(*texts: str, expected: str = "") -> encoder_pb2.EncodeTextsRequest:
    return encoder_pb2.EncodeTextsRequest(texts=texts, text_encoder=expected)


async def refusal(call: Any) -> tuple[grpc.StatusCode, str, str, float | None]:
    """Status code, reason, message, and seconds after which to retry."""
    with pytest.raises(grpc.aio.AioRpcError) as refused:
        await call
    error, info, retry = refused.value, error_details_pb2.ErrorInfo(), error_details_pb2.RetryInfo()
    after = None
    for detail in rpc_status.from_call(error).details:
        detail.Unpack(info)
        if detail.Unpack(retry):
            after = retry.retry_delay.ToMilliseconds() / 1000
    return error.code(), info.reason, str(error.details()), after


async def test_service_describes_itself_and_answers_in_order() -> None:
    encoder = GatedEncoder()
    async with serving(encoder) as stub:
        told = await stub.GetTextEncoder(encoder_pb2.GetTextEncoderRequest())
        assert (told.text_encoder, told.width, told.max_texts, told.max_characters) == ("length-1", 2, 3, 20)
        response = await stub.EncodeTexts(asking("walk", "", "walk", expected="length-1"))
        assert [list(each.values) for each in response.embeddings] == [[4, 0], [0, 0], [4, 0]]
        assert {each.text_encoder for each in response.embeddings} == {"length-1"}
        assert sorted(encoder.asked) == ["", "walk"]


async def test_calls_for_the_same_text_share_one_encoding() -> None:
    encoder = GatedEncoder()
    encoder.go.clear()
    async with serving(encoder) as stub:
        calls = [asyncio.ensure_future(stub.EncodeTexts(asking("crawl"))) for _ in range(5)]
        leaver = stub.EncodeTexts(asking("crawl"))
        leaver.cancel()
        encoder.go.set()
        for call in calls:
            assert list((await call).embeddings[0].values) == [5, 0]
    assert encoder.asked == ["crawl"]


@pytest.mark.parametrize(
    ("request_message", "code", "reason", "said"),
    [
        (asking(), grpc.StatusCode.INVALID_ARGUMENT, "WRONG_NUMBER_OF_TEXTS", "0 texts; it must be 1 to 3"),
        (asking("a", "b", "c", "d"), grpc.StatusCode.INVALID_ARGUMENT, "WRONG_NUMBER_OF_TEXTS", "1 to 3"),
        (asking("a", "x" * 21), grpc.StatusCode.INVALID_ARGUMENT, "TEXT_TOO_LONG", "21 characters; at most 20"),
        (
            asking("a", expected="llm2vec-1-bfloat16"),
            grpc.StatusCode.FAILED_PRECONDITION,
            "WRONG_TEXT_ENCODER",
            "'length-1', not 'llm2vec-1-bfloat16'",
        ),
    ],
)
async def test_invalid_request_is_refused(
    request_message: encoder_pb2.EncodeTextsRequest, code: grpc.StatusCode, reason: str, said: str
) -> None:
    encoder = GatedEncoder()
    async with serving(encoder) as stub:
        found = await refusal(stub.EncodeTexts(request_message))
    assert found[:2] == (code, reason)
    assert said in found[2]
    assert encoder.asked == []


async def test_full_queue_is_refused_at_once_and_a_slow_encoding_times_out() -> None:
    encoder = GatedEncoder()
    async with serving(encoder, max_waiting=2, timeout_s=0.05) as stub:
        encoder.go.clear()
        busy = await refusal(stub.EncodeTexts(asking("a", "bb", "ccc")))
        assert busy[:2] == (grpc.StatusCode.RESOURCE_EXHAUSTED, "TEXT_ENCODER_BUSY")
        slow = await refusal(stub.EncodeTexts(asking("a")))
        assert slow[:2] == (grpc.StatusCode.UNAVAILABLE, "TEXT_ENCODER_SLOW")
        assert busy[3] is not None
        assert slow[3] is not None


async def test_encoder_errors_are_returned_and_cached_texts_still_answered() -> None:
    encoder = GatedEncoder()
    async with serving(encoder) as stub:
        await stub.EncodeTexts(asking("walk"))
        encoder.error = TextEncoderUnavailable("the one behind it is away")
        away = await refusal(stub.EncodeTexts(asking("jump")))
        encoder.error = ZeroDivisionError("secret")
        broken = await refusal(stub.EncodeTexts(asking("jump")))
        assert list((await stub.EncodeTexts(asking("walk"))).embeddings[0].values) == [4, 0]
    assert away[:2] == (grpc.StatusCode.UNAVAILABLE, "TEXT_ENCODER_UNAVAILABLE")
    assert "the one behind it is away" in away[2]
    assert broken[:2] == (grpc.StatusCode.INTERNAL, "INTERNAL")
    assert "secret" not in broken[2]


async def test_new_texts_of_a_caller_are_rate_limited_and_cached_ones_are_not() -> None:
    encoder = GatedEncoder()
    async with serving(encoder, PeerLimits(prompts_per_second=0.01)) as stub:
        await stub.EncodeTexts(asking("a", "bb", "ccc"))
        code, reason, said, after_s = await refusal(stub.EncodeTexts(asking("dddd")))
        assert (code, reason) == (grpc.StatusCode.RESOURCE_EXHAUSTED, "TEXT_ENCODER_BUSY")
        assert "more than 0.01 new texts a second (quota prompts_per_second)" in said
        assert after_s is not None
        assert 1 < after_s < 300  # three texts are owed
        assert len((await stub.EncodeTexts(asking("ccc", "a"))).embeddings) == 2
    assert sorted(encoder.asked) == ["a", "bb", "ccc"]


async def test_calls_of_a_caller_are_rate_limited_even_invalid_ones() -> None:
    async with serving(GatedEncoder(), PeerLimits(calls_per_second=0.01)) as stub:
        await stub.GetTextEncoder(encoder_pb2.GetTextEncoderRequest())
        code, reason, _, after_s = await refusal(stub.EncodeTexts(asking()))
        assert (code, reason) == (grpc.StatusCode.RESOURCE_EXHAUSTED, "TOO_MANY_CALLS")
        assert after_s is not None
        assert 1 < after_s < 100  # one call is owed
