"""Checks which fields an OpenSession may set that resumes a session, and which only such a one may set."""

from __future__ import annotations

from motiongen.v1 import session_pb2
from motiongen_server.rpc.convert.checks import refuse

OF_A_RESUME = ("request_id", "resume_token", "resume_point")


def check_resume(message: session_pb2.OpenSession) -> None:
    """Raise EventRefused if an OpenSession that resumes a session sets anything else."""
    for descriptor, _ in message.ListFields():
        if descriptor.name not in OF_A_RESUME:
            given = f"{descriptor.name} is set, but the session has been opened already"
            raise refuse("NOT_FOR_RESUMING", f"open.{descriptor.name}", given, "to leave it out")


def check_no_resume(message: session_pb2.OpenSession) -> None:
    """Raise EventRefused if a new session has a resume point."""
    if message.HasField("resume_point"):
        given = "there is a resume point, but no token of the session that is to be resumed"
        raise refuse("RESUME_TOKEN_MISSING", "open.resume_point", given, "together with open.resume_token")
