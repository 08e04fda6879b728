"""The encoder service's servicer: checks and charges requests, and has new texts encoded."""

from __future__ import annotations

import asyncio
import logging
import secrets
import time

import grpc
import grpc.aio

from motiongen.v1 import encoder_pb2, motion_pb2
from motiongen_server.errors import EventRefused, StreamRefused
from motiongen_server.identity.caller import Role
from motiongen_server.identity.callers import Callers
from motiongen_server.rpc.budgets.peer import Peer
from motiongen_server.rpc.budgets.peers import Peers
from motiongen_server.rpc.calls.admission import CallAdmission
from motiongen_server.rpc.calls.context import CallContext, unary_method
from motiongen_server.rpc.calls.requests import Requests, parsed_as
from motiongen_server.rpc.grpc_server import serve_methods
from motiongen_server.rpc.limits import PeerLimits
from motiongen_server.text.event_errors import too_many_texts
from motiongen_server.text.ports import Embedding
from motiongen_server.text.prompts import PromptEncoder
from motiongen_server.text.turns import Asker

_log = logging.getLogger(__name__)

SERVICE_NAME = encoder_pb2.DESCRIPTOR.services_by_name["TextEncoderService"].full_name
MOST_CALLS = 4096


class TextEncoderService:
    """Answers with vectors of one encoder. Runs on one event loop.

    Every call is charged to its tenant or address before its request is parsed; new texts take turns at the encoder.
    """

    def __init__(
        self,
        prompts: PromptEncoder,
        width: int,
        max_texts: int,
        max_characters: int,
        callers: Callers | None = None,
        limits: PeerLimits | None = None,
    ) -> None:
        """width: numbers in a vector. max_texts, max_characters: of one request, of one text. callers: who may call;
        None: everybody. limits: of one address, and of a tenant as far as its quota does not set others.
        """
        self._admission = CallAdmission(callers or Callers(), Peers(limits), MOST_CALLS, Role.TEXT)
        self._prompts = prompts
        self._width = width
        self._max_texts = max_texts
        self._max_characters = max_characters

    async def GetTextEncoder(self, call: CallContext) -> encoder_pb2.GetTextEncoderResponse:
        """The encoder's identity and limits. Raises StreamRefused."""
        _, data = await self._admission.request(call)
        parsed_as(encoder_pb2.GetTextEncoderRequest, data)
        return encoder_pb2.GetTextEncoderResponse(
            text_encoder=self._prompts.identity,
            width=self._width,
            max_texts=self._max_texts,
            max_characters=self._max_characters,
        )

    async def EncodeTexts(self, call: CallContext) -> encoder_pb2.EncodeTextsResponse:
        """Vectors of the texts. Cached texts are not encoded again; calls with the same new text share its result.

        Raises StreamRefused.
        """
        peer, data = await self._admission.request(call, most_bytes=None)
        request = parsed_as(encoder_pb2.EncodeTextsRequest, data)
        try:
            self._check(request)
            self._charge_unknown(request, peer)
            asker = Asker(peer.name)
            vectors = await asyncio.gather(*(self._prompts.encode(text, asker) for text in request.texts))
        except EventRefused as refusal:
            raise StreamRefused.of(refusal) from refusal
        except StreamRefused:
            raise
        except Exception as error:
            error_id = secrets.token_hex(4)
            _log.error("encoding failed, error id %s", error_id, exc_info=error)
            message = f"the text encoder failed, error id {error_id}"
            raise StreamRefused(grpc.StatusCode.INTERNAL, "INTERNAL", message) from error
        return encoder_pb2.EncodeTextsResponse(embeddings=[self._message(vector) for vector in vectors])

    def _message(self, vector: Embedding) -> motion_pb2.TextEmbedding:
        return motion_pb2.TextEmbedding(text_encoder=self._prompts.identity, values=vector.tolist())

    def _charge_unknown(self, request: encoder_pb2.EncodeTextsRequest, peer: Peer) -> None:
        """Charge the texts that are not cached. Raises EventRefused while the peer is in debt: calls do not wait."""
        num_unknown = sum(self._prompts.cached(text) is None for text in request.texts)
        if num_unknown:
            now = time.monotonic()
            if (owed_s := peer.prompts.owed_s(now)) > 0:
                raise too_many_texts(peer.limits.prompts_per_second, peer.kind, owed_s)
            peer.prompts.charge(num_unknown, now)

    def _check(self, request: encoder_pb2.EncodeTextsRequest) -> None:
        if request.text_encoder not in ("", self._prompts.identity):
            raise StreamRefused(
                grpc.StatusCode.FAILED_PRECONDITION,
                "WRONG_TEXT_ENCODER",
                f"the text encoder is {self._prompts.identity!r}, not {request.text_encoder[:80]!r}",
                "text_encoder",
            )
        if not 1 <= len(request.texts) <= self._max_texts:
            raise StreamRefused(
                grpc.StatusCode.INVALID_ARGUMENT,
                "WRONG_NUMBER_OF_TEXTS",
                f"there are {len(request.texts)} texts; it must be 1 to {self._max_texts}",
                "texts",
            )
        for index, text in enumerate(request.texts):
            if len(text) > self._max_characters:
                raise StreamRefused(
                    grpc.StatusCode.INVALID_ARGUMENT,
                    "TEXT_TOO_LONG",
                    f"the text has {len(text)} characters; at most {self._max_characters} are allowed",
                    f"texts[{index}]",
                )


def add_text_encoder(service: TextEncoderService, server: grpc.aio.Server, requests: Requests | None = None) -> None:
    """Register the service with a server. requests: those of all calls of that server."""
    requests = requests or Requests()
    handlers = {
        "GetTextEncoder": unary_method(service.GetTextEncoder, requests),
        "EncodeTexts": unary_method(service.EncodeTexts, requests),
    }
    serve_methods(server, SERVICE_NAME, handlers)
