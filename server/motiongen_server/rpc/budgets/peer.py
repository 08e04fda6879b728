"""Peer: what all streams and calls of one tenant, or of one address if there is no tenant, may have together."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from contextlib import AbstractContextManager

from motiongen_server.engine.types import Owner, Priority
from motiongen_server.rpc.budgets.held_requests import HeldRequests, Holder
from motiongen_server.rpc.budgets.loop_time import LoopTime
from motiongen_server.rpc.budgets.token_bucket import Share, TokenBucket
from motiongen_server.rpc.errors.events import peer_class, peer_clips, peer_sessions, peer_steps, peer_waiting
from motiongen_server.rpc.errors.too_many_calls import too_many_calls
from motiongen_server.rpc.limits import PeerLimits

SESSION_WEIGHTS = {Priority.HERO: 4, Priority.NEAR: 2, Priority.CROWD: 1, Priority.BATCH: 1}
"""What a session of each class counts for: a hero is replanned far more often."""
CLASS_QUOTAS = {
    Priority.HERO: "heroes",
    Priority.NEAR: "nears",
    Priority.CROWD: "crowds",
    Priority.BATCH: "batches",
}
"""The field of `PeerLimits` that limits the sessions of each class."""
_Held = tuple[Priority, float]
_Asked = tuple[Priority | None, float | None]


class Peer:
    """One address, or one tenant. tenant: its name, "" for an address. name: unique among peers.

    loop: the time of the event loop that serves it; unlimited by default. loop_part: the peer's share of it.
    """

    def __init__(
        self, limits: PeerLimits, now: float, tenant: str = "", name: str = "", loop: LoopTime | None = None
    ) -> None:
        self.tenant = tenant
        self.name = name
        self.num_streams = 0
        self._num_calls = 0  # that take one request, from their beginning on
        self._sessions: Counter[Priority] = Counter()
        self._clip_samples = 0
        self.waiting_bytes = 0  # of events that wait for prompts to be encoded, or for the store
        self.held = HeldRequests()
        self._steps_hz = 0.0
        self.limits = limits
        self.events = TokenBucket(limits.events_per_second, now)
        self.bytes = TokenBucket(limits.bytes_per_second, now)
        self.prompts = TokenBucket(limits.prompts_per_second, now)
        self.calls = TokenBucket(limits.calls_per_second, now)
        self.loop = loop or LoopTime(now=now)
        self.loop_part = Share(self.loop.bucket, lambda: self.loop.num_peers, now)

    def begin_stream(self) -> None:
        """A stream of the peer begins."""
        self.num_streams += 1
        self.loop.enter(self)

    def end_stream(self) -> None:
        """A stream of the peer has ended."""
        self.num_streams -= 1
        self.loop.leave(self)

    def begin_call(self) -> Callable[[], None]:
        """A call that takes one request begins; returns the function to be called when it is over."""
        self._num_calls += 1
        return self._end_call

    def _end_call(self) -> None:
        self._num_calls -= 1

    def adopt(self, limits: PeerLimits, now: float) -> None:
        """Apply these limits from now on; what is open stays open, and debts remain."""
        if limits != self.limits:
            self.limits = limits
            self.events.set_rate(limits.events_per_second, now)
            self.bytes.set_rate(limits.bytes_per_second, now)
            self.prompts.set_rate(limits.prompts_per_second, now)
            self.calls.set_rate(limits.calls_per_second, now)

    @property
    def kind(self) -> str:
        """What the peer is called in messages."""
        return "tenant" if self.tenant else "address"

    @property
    def owner(self) -> Owner:
        """What engines know of the peer."""
        return Owner(self.name, self.limits.share, self.limits.steps_per_second)

    @property
    def session_weight(self) -> int:
        """The weight of the peer's sessions together."""
        return sum(SESSION_WEIGHTS[priority] * count for priority, count in self._sessions.items())

    def is_idle(self, now: float) -> bool:
        """Whether the peer can be forgotten: it has nothing open, and its budgets are full again."""
        is_open = self.loop.serves(self) or self._num_calls or self._clip_samples or self._sessions.total()
        buckets = (self.events, self.bytes, self.prompts, self.calls, self.loop_part)
        return not is_open and all(each.is_full(now) for each in buckets)

    @property
    def num_sessions(self) -> int:
        """Open sessions of all classes."""
        return self._sessions.total()

    def charge_call(self, cost: float, now: float) -> None:
        """Charge a call. Raises StreamRefused while the peer owes for calls: a call cannot be delayed like a stream."""
        if (owed_s := self.calls.owed_s(now)) > 0:
            raise too_many_calls(owed_s, self.kind)
        self.calls.charge(cost, now)

    def prompts_share(self, now: float) -> Share:
        """A session's share of the peer's prompts."""
        return Share(self.prompts, lambda: self.num_sessions, now)

    def place(self, priority: Priority, now: float) -> Place:
        """Take a place for a session, held until it is released. Raises EventRefused if none is free."""
        limits = self.limits
        quota = CLASS_QUOTAS[priority]
        if self._sessions[priority] >= getattr(limits, quota):
            raise peer_class(quota, getattr(limits, quota), priority, self.kind)
        if self.session_weight + SESSION_WEIGHTS[priority] > limits.session_weight:
            raise peer_sessions(limits.session_weight, self.kind)
        self._sessions[priority] += 1
        return Place(self, priority, now)

    def leave(self, priority: Priority, steps_hz: float) -> None:
        """A session of that class, which needed that many denoising steps per second to keep playing, is over."""
        self._sessions[priority] -= 1
        # The last session takes the rounding error with it.
        self._steps_hz = self._steps_hz - steps_hz if self.num_sessions else 0.0

    def begin_steps(self, steps_hz: float, field: str = "open.denoise_steps") -> None:
        """Note the denoising steps that a session needs to keep playing. Raises EventRefused beyond the quota.

        field: the field that asks for them.
        """
        most, asked = self.limits.steps_per_second, self._steps_hz + steps_hz
        if asked > most:
            raise peer_steps(asked, most, self.kind, field)
        self._steps_hz = asked

    def change(self, before: Priority, after: Priority, steps_hz: float) -> None:
        """Change a session's class, and add that many steps per second. Raises EventRefused beyond a quota.

        A change that asks for no more than before is never refused, even if a smaller quota is exceeded already.
        """
        limits, quota = self.limits, CLASS_QUOTAS[after]
        if after is not before and self._sessions[after] >= getattr(limits, quota):
            raise peer_class(quota, getattr(limits, quota), after, self.kind, "set_options.priority")
        more = SESSION_WEIGHTS[after] - SESSION_WEIGHTS[before]
        if more > 0 and self.session_weight + more > limits.session_weight:
            raise peer_sessions(limits.session_weight, self.kind, "set_options.priority")
        if steps_hz > 0:
            self.begin_steps(steps_hz, "set_options.denoise_steps")
            steps_hz = 0.0
        self.take_back(before, after, steps_hz)

    def take_back(self, before: Priority, after: Priority, steps_hz: float) -> None:
        """Change a session back to its earlier class, or to one that asks for no more. Never refused."""
        self._steps_hz += steps_hz
        self._sessions[before] -= 1
        self._sessions[after] += 1

    def check_waiting(self, num_bytes: int) -> None:
        """Raises EventRefused if an event of that size may not wait in addition to those that do."""
        most = self.limits.waiting_bytes
        if self.waiting_bytes + num_bytes > most:
            raise peer_waiting(most, self.kind)

    def holding(self, stream: Holder, num_bytes: int) -> AbstractContextManager[None]:
        """Count a message of one of the peer's streams for a block; see `HeldRequests.holding`. Raises Ended."""
        return self.held.holding(stream, num_bytes, self.limits.held_bytes, self.kind)

    def bound_held(self) -> None:
        """See `HeldRequests.bound`."""
        self.held.bound(self.limits.held_bytes, self.kind)

    def begin_clip(self, num_samples: int) -> None:
        """Note samples that are about to be generated. Raises EventRefused beyond the quota."""
        if self._clip_samples + num_samples > self.limits.clip_samples:
            raise peer_clips(self.limits.clip_samples, self.kind)
        self._clip_samples += num_samples

    def end_clip(self, num_samples: int) -> None:
        """The samples are finished or abandoned."""
        self._clip_samples -= num_samples


class Place:
    """A session's place among those of its peer.

    Changes of options may be requested before the engine has answered earlier ones; it answers them in order.
    """

    __slots__ = ("_asked", "_is_held", "_settled", "peer", "prompts")

    def __init__(self, peer: Peer, priority: Priority, now: float) -> None:
        self.prompts = peer.prompts_share(now)
        self.peer = peer
        self._settled = priority, 0.0  # class, and denoising steps a second
        self._asked: list[_Asked] = []
        self._is_held = True

    def begin_steps(self, steps_hz: float) -> None:
        """The session begins, and needs that many denoising steps per second to keep playing. Raises EventRefused."""
        if self._is_held:
            self.peer.begin_steps(steps_hz)
            self._settled = self._settled[0], steps_hz

    def change(self, priority: Priority | None, steps_hz: float | None) -> Callable[[bool], None]:
        """Request another class or number of steps per second for the session; None: as before.

        Returns a function to be told whether the engine took the change. Raises EventRefused beyond the peer's quotas.
        """
        asked = priority, steps_hz
        if self._is_held:
            (before, before_hz), (after, after_hz) = self._present, _changed(self._present, asked)
            self.peer.change(before, after, after_hz - before_hz)
            self._asked.append(asked)
        return lambda is_taken: self._settle(asked, is_taken)

    @property
    def _present(self) -> _Held:
        """What the session counts for, including changes that the engine has not answered yet."""
        held = self._settled
        for asked in self._asked:
            held = _changed(held, asked)
        return held

    def _settle(self, asked: _Asked, is_taken: bool) -> None:
        if not self._is_held or asked not in self._asked:
            return
        before, before_hz = self._present
        self._asked.remove(asked)
        if is_taken:
            self._settled = _changed(self._settled, asked)
        after, after_hz = self._present
        self.peer.take_back(before, after, after_hz - before_hz)

    def release(self) -> None:
        """The session is over. May be called more than once."""
        if self._is_held:
            self._is_held = False
            self.peer.leave(*self._present)


def _changed(held: _Held, asked: _Asked) -> _Held:
    return held[0] if asked[0] is None else asked[0], held[1] if asked[1] is None else asked[1]
