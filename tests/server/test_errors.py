"""Errors as clients receive them: status, details, fields."""

from __future__ import annotations

import grpc
import pytest
from google.rpc import error_details_pb2, status_pb2

from motiongen_server.engine.types import Code, Outcome, SessionKey
from motiongen_server.errors import EventRefused, StreamRefused


def decoded(refusal: StreamRefused) -> status_pb2.Status:
    """The status as a client reads it from the trailing metadata."""
    trailing = dict(refusal.status().trailing_metadata)
    return status_pb2.Status.FromString(trailing["grpc-status-details-bin"])


def test_refused_stream_gives_reason_and_field() -> None:
    refusal = StreamRefused(grpc.StatusCode.INVALID_ARGUMENT, "HELLO_EXPECTED", "say hello first", field="hello")
    status = decoded(refusal)
    assert (status.code, status.message) == (3, "say hello first")
    info, request = error_details_pb2.ErrorInfo(), error_details_pb2.BadRequest()
    assert [detail.Unpack(into) for detail, into in zip(status.details, (info, request), strict=True)] == [True, True]
    assert (info.reason, info.domain) == ("HELLO_EXPECTED", "motiongen")
    (violation,) = request.field_violations
    assert (violation.field, violation.description, violation.reason) == ("hello", "say hello first", "HELLO_EXPECTED")


def test_error_without_a_field_has_no_bad_request_detail() -> None:
    status = decoded(StreamRefused(grpc.StatusCode.RESOURCE_EXHAUSTED, "TOO_MANY_STREAMS", "too many"))
    assert status.code == 8
    assert len(status.details) == 1


def test_temporary_error_has_a_retry_delay() -> None:
    status = decoded(StreamRefused(grpc.StatusCode.UNAVAILABLE, "STARTING", "wait", retry_after_s=1.5))
    retry = error_details_pb2.RetryInfo()
    assert status.details[1].Unpack(retry)
    assert retry.retry_delay.ToMilliseconds() == 1500


@pytest.mark.parametrize("code", list(Code))
def test_engine_codes_equal_those_of_grpc(code: Code) -> None:
    assert grpc.StatusCode[code.name].value[0] == code


def test_refused_event_becomes_an_outcome_with_all_its_details() -> None:
    refusal = EventRefused(Code.NOT_FOUND, "UNKNOWN_RIG", "no rig 'x'", field="open.rig_id", allowed="core27")
    said = refusal.outcome(SessionKey(4, 5), 6)
    assert said == Outcome(
        SessionKey(4, 5), 6, Code.NOT_FOUND, None, "UNKNOWN_RIG", "no rig 'x'", "open.rig_id", "core27"
    )
    slow = EventRefused(Code.UNAVAILABLE, "TEXT_ENCODER_SLOW", "slow", retry_after_s=2.5)
    assert slow.outcome(SessionKey(4, 5), 7).retry_after_s == 2.5


def test_refused_event_can_become_the_status_of_its_call() -> None:
    refusal = EventRefused(Code.UNAVAILABLE, "DRAINING", "the server leaves", "open", "another server", 1.5)
    status = decoded(StreamRefused.of(refusal))
    assert (status.code, status.message) == (14, "the server leaves; allowed is another server")
    info, request, retry = error_details_pb2.ErrorInfo(), error_details_pb2.BadRequest(), error_details_pb2.RetryInfo()
    assert all(detail.Unpack(into) for detail, into in zip(status.details, (info, request, retry), strict=True))
    assert (info.reason, info.metadata["allowed"]) == ("DRAINING", "another server")
    assert request.field_violations[0].field == "open"
    assert retry.retry_delay.ToMilliseconds() == 1500
