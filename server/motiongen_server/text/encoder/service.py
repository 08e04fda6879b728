"""The servicer: checks what is asked, and asks the encoder for what is not remembered."""

from __future__ import annotations

import asyncio
import logging
import secrets
import time
from typing import TypeAlias

import grpc
import grpc.aio

from motiongen.v1 import encoder_pb2, encoder_pb2_grpc, motion_pb2
from motiongen_server.errors import EventRefused, StreamRefused
from motiongen_server.identity.caller import Role
from motiongen_server.identity.callers import Callers
from motiongen_server.rpc.budget import BYTES_A_CALL, CALL_COST
from motiongen_server.rpc.issuer_keys import keys_for
from motiongen_server.rpc.limits import PeerLimits
from motiongen_server.rpc.peers import Peer, Peers
from motiongen_server.text.event_errors import too_many_texts
from motiongen_server.text.prompts import Embedding, PromptEncoder

_log = logging.getLogger(__name__)

SERVICE_NAME = encoder_pb2.DESCRIPTOR.services_by_name["TextEncoderService"].full_name

Described: TypeAlias = "grpc.aio.ServicerContext[encoder_pb2.GetTextEncoderRequest, encoder_pb2.GetTextEncoderResponse]"
Encoded: TypeAlias = "grpc.aio.ServicerContext[encoder_pb2.EncodeTextsRequest, encoder_pb2.EncodeTextsResponse]"


class TextEncoderService(encoder_pb2_grpc.TextEncoderServiceServicer):
    """Answers with vectors of one encoder. Lives on one event loop.

    Every call is charged to its tenant, or its address, before it is looked at; texts that are not known take turns.
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
        everybody where it is left out. limits: of one address, and of a tenant whose quota says nothing else.
        """
        self._callers = callers or Callers()
        self._peers = Peers(limits)
        self._prompts = prompts
        self._width = width
        self._max_texts = max_texts
        self._max_characters = max_characters

    async def GetTextEncoder(
        self, request: encoder_pb2.GetTextEncoderRequest, context: Described
    ) -> encoder_pb2.GetTextEncoderResponse:
        """Which encoder it is."""
        try:
            await self._charged(context, CALL_COST)
        except StreamRefused as refused:
            await context.abort_with_status(refused.status())
        return encoder_pb2.GetTextEncoderResponse(
            text_encoder=self._prompts.identity,
            width=self._width,
            max_texts=self._max_texts,
            max_characters=self._max_characters,
        )

    async def EncodeTexts(
        self, request: encoder_pb2.EncodeTextsRequest, context: Encoded
    ) -> encoder_pb2.EncodeTextsResponse:
        """Vectors of the texts. What is known is not encoded again, and those who ask for the same text share it."""
        try:
            peer = await self._charged(context, CALL_COST + request.ByteSize() / BYTES_A_CALL)
            self._check(request)
            self._charge_unknown(request, peer)
            vectors = await asyncio.gather(*(self._prompts.encode(text, peer.number) for text in request.texts))
        except EventRefused as refusal:
            await context.abort_with_status(StreamRefused.of(refusal).status())
        except StreamRefused as refused:
            await context.abort_with_status(refused.status())
        except Exception as error:
            error_id = secrets.token_hex(4)
            _log.error("encoding failed, error id %s", error_id, exc_info=error)
            message = f"the text encoder failed, error id {error_id}"
            await context.abort_with_status(StreamRefused(grpc.StatusCode.INTERNAL, "INTERNAL", message).status())
        return encoder_pb2.EncodeTextsResponse(embeddings=[self._message(vector) for vector in vectors])

    def _message(self, vector: Embedding) -> motion_pb2.TextEmbedding:
        return motion_pb2.TextEmbedding(text_encoder=self._prompts.identity, values=vector.tolist())

    async def _charged(self, context: Described | Encoded, cost: float) -> Peer:
        """Find out who calls, and charge the call. Raises StreamRefused for who may not call, and while he owes."""
        metadata, now = context.invocation_metadata() or (), time.monotonic()
        address = self._peers.find(context.peer(), now)
        if self._callers.is_dear(metadata):
            address.check_paid(now)  # signatures are checked, and keys waited for, on credit of nobody
        await keys_for(self._callers, metadata)
        now = time.monotonic()
        try:
            caller = self._callers.identify(metadata, context.auth_context(), Role.TEXT)
        except StreamRefused:
            address.charge_call(cost, now)
            raise
        peer = self._peers.of(caller, address, now)
        peer.charge_call(cost, now)
        return peer

    def _charge_unknown(self, request: encoder_pb2.EncodeTextsRequest, peer: Peer) -> None:
        """Charge the texts that are not known. Raises EventRefused while such are owed for: nothing waits for that."""
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
