"""The client of an encoder service that refuses a text, or does not give its name."""

from __future__ import annotations

from collections.abc import Iterator
from concurrent import futures
from contextlib import contextmanager
from typing import Any

import grpc
import numpy as np
import pytest

from motiongen.v1 import encoder_pb2, motion_pb2
from motiongen_ardy.text import TextEncoderChanged, TextEncoderUnavailable, TextRefused, UnknownTextEncoder
from motiongen_server.text.encoder.client import RemoteEncoder
from motiongen_server.text.ports import answers_to
from tests.waiting import LIMIT_S

MOST_CHARACTERS = 8
TOO_LONG = "the text has 9 characters; at most 8 are allowed"


@contextmanager
def service(
    name: str = "ones", width: int = 4, most_texts: int = 8, refusal: grpc.StatusCode | None = None
) -> Iterator[str]:
    """The address of a service that takes only short texts, and at most two a request whatever it says.

    refusal: the status with which it refuses every text.
    """

    def describe(request: Any, call: grpc.ServicerContext) -> encoder_pb2.GetTextEncoderResponse:
        return encoder_pb2.GetTextEncoderResponse(text_encoder=name, width=width, max_texts=most_texts)

    def encode(request: Any, call: grpc.ServicerContext) -> encoder_pb2.EncodeTextsResponse:
        if refusal is not None:
            call.abort(refusal, "not now")
        if len(request.texts) > 2:
            call.abort(grpc.StatusCode.INVALID_ARGUMENT, f"there are {len(request.texts)} texts; it must be 1 to 2")
        if any(len(text) > MOST_CHARACTERS for text in request.texts):
            call.abort(grpc.StatusCode.INVALID_ARGUMENT, TOO_LONG)
        vector = motion_pb2.TextEmbedding(text_encoder=name, values=[1.0] * width)
        return encoder_pb2.EncodeTextsResponse(embeddings=[vector] * len(request.texts))

    server = grpc.server(futures.ThreadPoolExecutor(2))
    handlers = {
        "GetTextEncoder": grpc.unary_unary_rpc_method_handler(
            describe, encoder_pb2.GetTextEncoderRequest.FromString, encoder_pb2.GetTextEncoderResponse.SerializeToString
        ),
        "EncodeTexts": grpc.unary_unary_rpc_method_handler(
            encode, encoder_pb2.EncodeTextsRequest.FromString, encoder_pb2.EncodeTextsResponse.SerializeToString
        ),
    }
    server.add_generic_rpc_handlers(
        (grpc.method_handlers_generic_handler("motiongen.v1.TextEncoderService", handlers),)
    )
    port = server.add_insecure_port("127.0.0.1:0")
    server.start()
    try:
        yield f"127.0.0.1:{port}"
    finally:
        server.stop(None).wait()


def test_refused_text_gets_the_reason_and_the_other_texts_their_vectors() -> None:
    with service() as address:
        encoder = RemoteEncoder(address, LIMIT_S)
        said = answers_to(["walk", "x" * 9], encoder)
        encoder.close()
    np.testing.assert_array_equal(said["walk"], [1] * 4)  # type: ignore[arg-type]
    refused = said["x" * 9]
    assert isinstance(refused, TextRefused)
    assert TOO_LONG in str(refused)
    assert refused.retry_after_s is None


def test_texts_are_sent_singly_when_the_service_takes_fewer_than_it_said() -> None:
    with service() as address:
        encoder = RemoteEncoder(address, LIMIT_S)
        said = answers_to(["walk", "wave", "jump"], encoder)
        encoder.close()
    assert [isinstance(answer, Exception) for answer in said.values()] == [False] * 3


def test_service_without_a_name_or_width_is_refused() -> None:
    for name, width in (("", 4), ("ones", 0)):
        with service(name, width) as address, pytest.raises(UnknownTextEncoder, match="does not tell"):
            RemoteEncoder(address, LIMIT_S)


def test_closed_service_is_unavailable_with_a_time_to_retry() -> None:
    with service() as address:
        encoder = RemoteEncoder(address, LIMIT_S)
    with pytest.raises(TextEncoderUnavailable) as away:
        encoder.encode(["walk"])
    encoder.close()
    assert not isinstance(away.value, TextRefused)
    assert away.value.retry_after_s is not None


@pytest.mark.parametrize("code", [code for code in grpc.StatusCode if code.name not in ("OK", "INVALID_ARGUMENT")])
def test_refusal_that_is_not_of_the_text_has_a_time_to_retry(code: grpc.StatusCode) -> None:
    with service(refusal=code) as address:
        encoder = RemoteEncoder(address, LIMIT_S)
        with pytest.raises(TextEncoderUnavailable) as refused:
            encoder.encode(["walk"])
        encoder.close()
    assert refused.value.retry_after_s is not None
    assert not isinstance(refused.value, TextRefused)
    assert isinstance(refused.value, TextEncoderChanged) == (code is grpc.StatusCode.FAILED_PRECONDITION)


@pytest.mark.parametrize("host", ["127.0.0.1", "localhost"])
def test_service_on_this_machine_is_called_without_the_proxy(host: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("http_proxy", "http://127.0.0.1:9")
    monkeypatch.delenv("no_proxy", raising=False)
    with service() as address:
        encoder = RemoteEncoder(address.replace("127.0.0.1", host), LIMIT_S)
        np.testing.assert_array_equal(encoder.encode(["walk"]), [[1] * 4])
        encoder.close()
