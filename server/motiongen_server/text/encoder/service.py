"""The servicer: checks what is asked, and asks the encoder for what is not remembered."""

from __future__ import annotations

import asyncio
import logging
import secrets
from typing import TypeAlias

import grpc
import grpc.aio

from motiongen.v1 import encoder_pb2, encoder_pb2_grpc, motion_pb2
from motiongen_server.errors import EventRefused, StreamRefused
from motiongen_server.identity.caller import Role
from motiongen_server.identity.callers import Callers
from motiongen_server.rpc.issuer_keys import keys_for
from motiongen_server.text.prompts import Embedding, PromptEncoder

_log = logging.getLogger(__name__)

SERVICE_NAME = encoder_pb2.DESCRIPTOR.services_by_name["TextEncoderService"].full_name

Described: TypeAlias = "grpc.aio.ServicerContext[encoder_pb2.GetTextEncoderRequest, encoder_pb2.GetTextEncoderResponse]"
Encoded: TypeAlias = "grpc.aio.ServicerContext[encoder_pb2.EncodeTextsRequest, encoder_pb2.EncodeTextsResponse]"


class TextEncoderService(encoder_pb2_grpc.TextEncoderServiceServicer):
    """Answers with vectors of one encoder. Lives on one event loop."""

    def __init__(
        self, prompts: PromptEncoder, width: int, max_texts: int, max_characters: int, callers: Callers | None = None
    ) -> None:
        """width: numbers in a vector. max_texts, max_characters: of one request, of one text. callers: who may call;
        everybody where it is left out.
        """
        self._callers = callers or Callers()
        self._prompts = prompts
        self._width = width
        self._max_texts = max_texts
        self._max_characters = max_characters

    async def GetTextEncoder(
        self, request: encoder_pb2.GetTextEncoderRequest, context: Described
    ) -> encoder_pb2.GetTextEncoderResponse:
        """Which encoder it is."""
        try:
            await self._check_caller(context)
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
            await self._check_caller(context)
            self._check(request)
            vectors = await asyncio.gather(*(self._prompts.encode(text) for text in request.texts))
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

    async def _check_caller(self, context: Described | Encoded) -> None:
        metadata = context.invocation_metadata() or ()
        await keys_for(self._callers, metadata)
        self._callers.identify(metadata, context.auth_context(), Role.TEXT)

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
