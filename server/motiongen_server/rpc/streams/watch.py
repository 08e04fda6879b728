"""StreamWatch: ends streams that occupy a place or memory without use, or whose credentials have lapsed."""

from __future__ import annotations

import asyncio
import logging
import time
from collections.abc import Callable, Mapping

from motiongen_server.errors import StreamRefused
from motiongen_server.identity.caller import ANYBODY, CREDENTIALS_EXPIRED
from motiongen_server.identity.callers import Callers
from motiongen_server.rpc.budgets.waiting_memory import WaitingMemory, alone
from motiongen_server.rpc.errors.streams import client_silent, hello_late, reader_stuck, stream_empty
from motiongen_server.rpc.limits import ServiceLimits
from motiongen_server.rpc.sparing_log import SparingLog
from motiongen_server.rpc.streams.goodbye import EXPIRY_NOTICE_S, say_expiring
from motiongen_server.rpc.streams.stream import Stream

_log = logging.getLogger(__name__)

LOOK_EVERY_S = 0.25


class StreamWatch:
    """Looks at all streams and the memory held, a few times a second while there are any. Lives on the event loop."""

    def __init__(
        self,
        limits: ServiceLimits,
        streams: Mapping[int, Stream],
        callers: Callers | None = None,
        memory: WaitingMemory | None = None,
        renew_quotas: Callable[[], object] = lambda: None,
    ) -> None:
        """memory: accounts for what is held, by streams and others; by default for streams only.

        renew_quotas: applies tenants' quotas as they are known now.
        """
        self._renew_quotas = renew_quotas
        self._limits = limits
        self._memory = memory or WaitingMemory(limits.max_waiting_bytes, streams)
        self._memory.on_begin = self.begin
        self._callers = callers or Callers()
        self._streams = streams
        self._timer: asyncio.TimerHandle | None = None
        self._faults = SparingLog(_log)

    def begin(self) -> None:
        """A stream has begun, or a call that holds memory."""
        if self._timer is None:
            self._timer = asyncio.get_running_loop().call_later(LOOK_EVERY_S, self._look)

    def _look(self) -> None:
        self._timer = None
        try:
            self.look(time.monotonic())
        finally:  # otherwise a fault would leave all streams unwatched until another begins
            if not self._memory.is_idle:
                self.begin()

    def look(self, now: float) -> None:
        """End the streams that are due at `now`, in monotonic seconds."""
        try:
            self._callers.look()
            self._renew_quotas()
        except Exception as error:  # the streams and the memory must be watched all the same
            self._faults.error("the files of tenants and keys could not be checked", fault=error)
        for stream in [stream for stream in self._streams.values() if stream.refusal is None]:
            with alone(stream):
                self._look_at(stream, now)
        self._memory.bound()

    def _look_at(self, stream: Stream, now: float) -> None:
        if (refusal := self.refusal(stream, now)) is not None:
            stream.refuse(refusal)
        elif self.is_silent(stream, now):
            # Its machine may have stopped behind a proxy that still answers gRPC's keepalives.
            stream.expire(client_silent(self._limits.silent_timeout_s))
        else:
            self._check_caller(stream)

    def _check_caller(self, stream: Stream) -> None:
        """Tell a client whose credentials are about to expire, and end its stream when they have."""
        caller = stream.caller
        if caller is ANYBODY:
            return
        lapse, remaining_s = self._callers.lapse(caller), self._callers.remaining_s(caller)
        if lapse is not None and lapse.reason == CREDENTIALS_EXPIRED:
            stream.expire(lapse)  # its sessions wait for new credentials as they wait after a lost connection
        elif lapse is not None:
            stream.refuse(lapse)
        elif remaining_s is not None and remaining_s < EXPIRY_NOTICE_S and stream.greeted:
            say_expiring(stream, remaining_s)

    def is_silent(self, stream: Stream, now: float) -> bool:
        """Whether the stream has waited for its client for too long."""
        since = stream.listening_since
        return stream.greeted and since is not None and now - since > self._limits.silent_timeout_s

    def refusal(self, stream: Stream, now: float) -> StreamRefused | None:
        """Why a stream is to be ended now, if it is."""
        limits = self._limits
        if not stream.greeted:
            late = now - stream.began_at > limits.hello_timeout_s
            return hello_late(limits.hello_timeout_s) if late and not stream.ended else None
        if stream.writing_since is not None and now - stream.writing_since > limits.stuck_timeout_s:
            return reader_stuck(limits.stuck_timeout_s)
        is_empty = not stream.num_sessions and now - stream.empty_since > limits.empty_timeout_s
        return stream_empty(limits.empty_timeout_s) if is_empty and not stream.ended else None
