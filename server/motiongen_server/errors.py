"""The error family: what a caller can act on, and how each is told to a client."""

from __future__ import annotations

import grpc
from google.protobuf.any_pb2 import Any
from google.protobuf.message import Message
from google.rpc import code_pb2, error_details_pb2, status_pb2  # type: ignore[import-untyped]
from grpc_status import rpc_status

from motiongen_server.engine.types import Code

ERROR_DOMAIN = "motiongen"


class EventRefused(Exception):
    """One event that is answered with an outcome; the stream and its other sessions go on.

    reason: an UPPER_SNAKE word a program can act on; field: the path of the field at fault; allowed: what may be there;
    retry_after_s: when the same would be taken, None where waiting does not help.
    """

    def __init__(
        self,
        code: Code,
        reason: str,
        message: str,
        field: str = "",
        allowed: str = "",
        retry_after_s: float | None = None,
    ) -> None:
        super().__init__(message)
        self.code = code
        self.reason = reason
        self.field = field
        self.allowed = allowed
        self.retry_after_s = retry_after_s


class StreamRefused(Exception):
    """What ends a whole call with a status and details.

    retry_after_s: when to try again, 0 where it is of no use; allowed: what may stand in the field.
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

    def status(self) -> grpc.Status:
        """With ErrorInfo; BadRequest where a field is at fault, RetryInfo where waiting helps (google.rpc model)."""
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
