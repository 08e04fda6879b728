"""Client of the encoder service: a text encoder that runs elsewhere."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import grpc
import numpy as np

from motiongen.v1 import encoder_pb2, motion_pb2
from motiongen_ardy.text import TextEncoderChanged, TextEncoderUnavailable, TextRefused, UnknownTextEncoder, Vectors
from motiongen_ardy.text.encoder import NamedTextEncoder, checked_vector, is_blank
from motiongen_server.addresses import host_of, proxy_options

OPTIONS = (
    # An encoder that comes back is found within two seconds, not within gRPC's two minutes.
    ("grpc.initial_reconnect_backoff_ms", 200),
    ("grpc.min_reconnect_backoff_ms", 200),
    ("grpc.max_reconnect_backoff_ms", 2_000),
    ("grpc.keepalive_time_ms", 30_000),
    ("grpc.keepalive_timeout_ms", 5_000),
    ("grpc.max_receive_message_length", 64 << 20),
)
PATH = "/motiongen.v1.TextEncoderService/"
NO_ANSWER = "the text encoder does not answer"


class RemoteEncoder(NamedTextEncoder):
    """The encoder at an address. Its identity at the start must not change: answers with another one are errors.

    May be used from several threads.
    """

    def __init__(
        self,
        address: str,
        timeout_s: float = 10.0,
        known: tuple[str, int] | None = None,
        credentials: grpc.ChannelCredentials | None = None,
        token: Callable[[], str] | None = None,
    ) -> None:
        """address: host:port. timeout_s: of a call; at the start, how long to wait for the service to come up.

        known: identity and width to assume instead of asking the service at the start. credentials: for TLS; None:
        plain text. token: returns the caller's token, called before every call. Raises UnknownTextEncoder for an
        invalid address, or a service that does not say what it is; TextEncoderUnavailable if it does not answer or
        refuses the call.
        """
        port = address.rpartition(":")[2]
        if not host_of(address) or not port.isdecimal() or len(port) > 5 or not 0 < int(port) <= 65535:
            raise UnknownTextEncoder(f"{address!r} is not the address of an encoder service, such as localhost:50052")
        self._timeout_s = timeout_s
        self._token = token
        options = (*OPTIONS, *proxy_options(address))
        if credentials is None:
            self._channel = grpc.insecure_channel(address, options)
        else:
            self._channel = grpc.secure_channel(address, credentials, options)
        describe = self._channel.unary_unary(
            PATH + "GetTextEncoder",
            request_serializer=encoder_pb2.GetTextEncoderRequest.SerializeToString,
            response_deserializer=encoder_pb2.GetTextEncoderResponse.FromString,
        )
        self._encode = self._channel.unary_unary(
            PATH + "EncodeTexts",
            request_serializer=encoder_pb2.EncodeTextsRequest.SerializeToString,
            response_deserializer=encoder_pb2.EncodeTextsResponse.FromString,
        )
        if known is not None:
            super().__init__(*known)
            self._max_texts = 1
            return
        try:
            found = describe(encoder_pb2.GetTextEncoderRequest(), timeout=timeout_s, wait_for_ready=True,
                             metadata=self._metadata())  # fmt: skip
        except grpc.RpcError as error:
            self._channel.close()
            raise TextEncoderUnavailable(f"{NO_ANSWER} ({_reason(error)})") from error
        if not found.text_encoder or not found.width:
            self._channel.close()
            raise UnknownTextEncoder(f"the service at {address} does not tell its text encoder's identity and width")
        super().__init__(str(found.text_encoder), int(found.width))
        self._max_texts = max(1, int(found.max_texts))

    def encode(self, texts: Sequence[str]) -> Vectors:
        vectors = np.zeros((len(texts), self._width), np.float32)
        rows = [row for row, text in enumerate(texts) if not is_blank(text)]
        for first in range(0, len(rows), self._max_texts):
            part = rows[first : first + self._max_texts]
            for row, embedding in zip(part, self._call([texts[row] for row in part]), strict=True):
                vectors[row] = self._vector(embedding)
        return vectors

    def _metadata(self) -> tuple[tuple[str, str], ...]:
        return () if self._token is None else (("authorization", f"Bearer {self._token()}"),)

    def _call(self, texts: list[str]) -> Sequence[motion_pb2.TextEmbedding]:
        request = encoder_pb2.EncodeTextsRequest(texts=texts, text_encoder=self._identity)
        try:
            response = self._encode(request, timeout=self._timeout_s, metadata=self._metadata())
        except grpc.RpcError as error:
            if error.code() is grpc.StatusCode.FAILED_PRECONDITION:
                raise TextEncoderChanged(
                    f"{error.details()}; this server began with {self._identity!r} and must be restarted to change"
                ) from error
            if error.code() is grpc.StatusCode.INVALID_ARGUMENT:
                raise TextRefused(f"the text encoder refuses it: {error.details()!s:.200}") from error
            raise TextEncoderUnavailable(f"{NO_ANSWER} ({_reason(error)})") from error
        except ValueError as error:  # the channel has been closed
            raise TextEncoderUnavailable(f"{NO_ANSWER}: the server is shutting down") from error
        if len(response.embeddings) != len(texts):
            raise TextEncoderChanged(f"the text encoder answered {len(texts)} texts with {len(response.embeddings)}")
        return response.embeddings

    def _vector(self, embedding: motion_pb2.TextEmbedding) -> Vectors:
        if embedding.text_encoder != self._identity:
            raise TextEncoderChanged(
                f"the text encoder answered as {embedding.text_encoder!r}, and was asked as {self._identity!r}"
            )
        return checked_vector(np.array(embedding.values, np.float32), self._width)

    def close(self) -> None:
        """Cancel calls in progress."""
        self._channel.close()


def _reason(error: grpc.RpcError) -> str:
    """Why a call failed, without the address that gRPC's own message contains."""
    code: grpc.StatusCode = error.code()
    if code is grpc.StatusCode.DEADLINE_EXCEEDED:
        return "it takes too long"
    return str(code.name)
