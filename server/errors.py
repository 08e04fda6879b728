"""The error family: what a caller can act on, and how each is told to a client."""

from __future__ import annotations

import grpc
from google.protobuf.any_pb2 import Any
from google.rpc import code_pb2, error_details_pb2, status_pb2  # type: ignore[import-untyped]
from grpc_status import rpc_status

from server.engine.types import Code

ERROR_DOMAIN = "motiongen"


class SettingError(ValueError):
    """A setting with a value it cannot have; the message names setting, value and allowed range."""


class EventRefused(Exception):
    """One event that is answered with an outcome; the stream and its other sessions go on.

    reason: an UPPER_SNAKE word a program can act on; field: the path of the field at fault; allowed: what may be there.
    """

    def __init__(self, code: Code, reason: str, message: str, field: str = "", allowed: str = "") -> None:
        super().__init__(message)
        self.code = code
        self.reason = reason
        self.field = field
        self.allowed = allowed


class StreamRefused(Exception):
    """A mistake that ends the whole stream with a status and details."""

    def __init__(self, code: grpc.StatusCode, reason: str, message: str, field: str = "") -> None:
        super().__init__(message)
        self.code = code
        self.reason = reason
        self.field = field

    def status(self) -> grpc.Status:
        """The status with ErrorInfo, and BadRequest where a field is at fault (google.rpc error model)."""
        details = [error_details_pb2.ErrorInfo(reason=self.reason, domain=ERROR_DOMAIN)]
        packed = [_pack(detail) for detail in details]
        if self.field:
            violation = error_details_pb2.BadRequest.FieldViolation(
                field=self.field, description=str(self), reason=self.reason
            )
            packed.append(_pack(error_details_pb2.BadRequest(field_violations=[violation])))
        code = code_pb2.Code.Value(self.code.name)
        return rpc_status.to_status(status_pb2.Status(code=code, message=str(self), details=packed))


def _pack(detail: error_details_pb2.ErrorInfo | error_details_pb2.BadRequest) -> Any:
    packed = Any()
    packed.Pack(detail)
    return packed
