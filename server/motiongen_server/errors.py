"""Errors that a client can act on, and how a refused call is reported to it."""

from __future__ import annotations

import grpc
from google.protobuf.any_pb2 import Any
from google.protobuf.message import Message
from google.rpc import code_pb2, error_details_pb2, status_pb2  # type: ignore[import-untyped]
from grpc_status import rpc_status

from motiongen_server.engine.types import EventRefused

__all__ = ["EventRefused", "StreamRefused"]

ERROR_DOMAIN = "motiongen"


class StreamRefused(Exception):
    """Ends a whole call with a status and details.

    retry_after_s: when to try again; 0: trying again is of no use. allowed: what `field` may contain.
    """

    def __init__(
        self,
        code: grpc.StatusCode,
        reason: str,
        message: str,
        field: str = "",
        retry_after_s: float = 0.0,
        allowed: str = "",
    ) -> None:
        super().__init__(message)
        self.code = code
        self.reason = reason
        self.field = field
        self.retry_after_s = retry_after_s
        self.allowed = allowed

    @classmethod
    def of(cls, refusal: EventRefused) -> StreamRefused:
        """The refusal of an event, for a call that consists of just this event."""
        message = f"{refusal}; allowed is {refusal.allowed}" if refusal.allowed else str(refusal)
        code, retry_after_s = grpc.StatusCode[refusal.code.name], refusal.retry_after_s or 0.0
        return cls(code, refusal.reason, message, refusal.field, retry_after_s, refusal.allowed)

    def status(self) -> grpc.Status:
        """With ErrorInfo; BadRequest if a field is invalid; RetryInfo if waiting helps (google.rpc model)."""
        metadata = {"allowed": self.allowed} if self.allowed else {}
        packed = [_pack(error_details_pb2.ErrorInfo(reason=self.reason, domain=ERROR_DOMAIN, metadata=metadata))]
        if self.field:
            violation = error_details_pb2.BadRequest.FieldViolation(
                field=self.field, description=str(self), reason=self.reason
            )
            packed.append(_pack(error_details_pb2.BadRequest(field_violations=[violation])))
        if self.retry_after_s:
            retry = error_details_pb2.RetryInfo()
            retry.retry_delay.FromMilliseconds(round(1000 * self.retry_after_s))
            packed.append(_pack(retry))
        code = code_pb2.Code.Value(self.code.name)
        return rpc_status.to_status(status_pb2.Status(code=code, message=str(self), details=packed))


def _pack(detail: Message) -> Any:
    packed = Any()
    packed.Pack(detail)
    return packed
