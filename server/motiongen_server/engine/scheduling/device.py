"""Device: what the engines of one process share. They take turns on it, and each knows what the others use of it."""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Sequence
from math import inf
from types import TracebackType

from motiongen_server.engine.ports import Runner
from motiongen_server.engine.scheduling.quota_share import QuotaAccount
from motiongen_server.engine.types import Float32Array, ModelFacts, RowStatus, WindowJob, WindowResult

BACKGROUND_SHARE = 0.2
"""What an engine whose windows are all in the background may take of the device beside others: such a share of what the
turns of those take that have windows somebody waits for. In one engine the background makes a step as much longer.
"""
MOST_OWED_S = 1.0
"""The most that the background makes up for, however long a call of it stood still."""


class Device:
    """Gives turns in the order in which they were asked for: an engine waits for one step of each other at most.

    The background of one engine takes what is left by the windows of all others that somebody waits for, not of its own
    engine only. It is told by its lease how much that is; where it took more, as a step takes that cannot be smaller,
    it has none until that is made up for.
    """

    def __init__(self, quota: QuotaAccount | None = None, *, counts_own: bool = False) -> None:
        """quota: of the processor, None where there is none or nobody tells what is used of it. counts_own: what
        engines do themselves counts as use of it, for it stands still meanwhile; on a processor it is a thirtieth.
        """
        self.quota = quota
        self.counts_own = counts_own
        self._lock = threading.Lock()
        self._taken = False
        self._waiting: deque[threading.Lock] = deque()
        self._seats: list[DeviceLease] = []
        self._spare_s = 0.0  # of the background beside others; only who has the turn touches it

    def lease(self) -> DeviceLease:
        """A place for one more engine, to be left at its end."""
        lease = DeviceLease(self)
        with self._lock:
            self._seats.append(lease)
        return lease

    @property
    def load(self) -> float:
        """The share of the device that all engines together use."""
        return sum(lease.load for lease in tuple(self._seats))

    @property
    def num_seats(self) -> int:
        return len(self._seats)

    @property
    def num_waiting(self) -> int:
        """How many wait for a turn."""
        return len(self._waiting)

    def is_waited_for(self, but: DeviceLease) -> bool:
        """Whether another engine has windows under way that somebody waits for."""
        return any(seat.num_waited_for and seat is not but for seat in tuple(self._seats))

    def has_background(self, but: DeviceLease) -> bool:
        """Whether another engine has windows in the background under way."""
        return any(seat.num_background and seat is not but for seat in tuple(self._seats))

    def spare_s(self, lease: DeviceLease) -> float:
        """As `DeviceLease.spare_s`."""
        return max(0.0, self._spare_s) if self.is_waited_for(lease) else inf

    def settle(self, lease: DeviceLease, waited_for_s: float, background_s: float) -> None:
        """At the end of a turn: note what calls in it took, by whom they were for."""
        if waited_for_s:
            share_s = BACKGROUND_SHARE * (waited_for_s + background_s)
            self._spare_s = min(self._spare_s + share_s, share_s)  # what was not taken is not kept
        elif background_s and self.is_waited_for(lease):
            self._spare_s = max(self._spare_s - background_s, -MOST_OWED_S)
        elif background_s:
            self._spare_s = 0.0  # nobody waits for anything: what was owed is forgotten

    def leave(self, lease: DeviceLease) -> None:
        """Give up a place."""
        with self._lock:
            if lease in self._seats:
                self._seats.remove(lease)

    def take(self) -> float:
        """Wait for a turn. Returns the seconds that it took."""
        with self._lock:
            if not self._taken:
                self._taken = True
                return 0.0
            called = threading.Lock()
            called.acquire()
            self._waiting.append(called)
        asked_at = time.monotonic()
        called.acquire()
        return time.monotonic() - asked_at

    def pass_on(self) -> None:
        """End a turn; the next begins at once, for whoever has waited longest."""
        with self._lock:
            if self._waiting:
                self._waiting.popleft().release()
            else:
                self._taken = False


class DeviceLease:
    """One engine's place at the device. `with lease:` is a turn.

    load: the share of the device that this engine uses; num_waited_for, num_background: its windows under way. It tells
    these itself. waited_s: how long it has waited for its turns.
    """

    def __init__(self, device: Device) -> None:
        self._device = device
        self.load = self.waited_s = 0.0
        self.num_waited_for = self.num_background = 0
        self._waited_for_s = self._background_s = 0.0  # in this turn

    def __enter__(self) -> DeviceLease:
        self.waited_s += self._device.take()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._device.settle(self, self._waited_for_s, self._background_s)
        self._waited_for_s = self._background_s = 0.0
        self._device.pass_on()

    def note_call(self, seconds: float, background: float) -> None:
        """A call of the runner in this turn took so long. background: the share of it that is the background's."""
        self._waited_for_s += (1.0 - background) * seconds
        self._background_s += background * seconds

    @property
    def spare_s(self) -> float:
        """How long a step may take now that is for the background alone; 0 where there is to be none.

        Infinity where no other engine has windows under way that somebody waits for. Asked in a turn.
        """
        return self._device.spare_s(self)

    @property
    def quota(self) -> QuotaAccount | None:
        """As of the device."""
        return self._device.quota

    @property
    def counts_own(self) -> bool:
        """As of the device."""
        return self._device.counts_own

    @property
    def elsewhere(self) -> float:
        """The share of the device that the other engines use."""
        return max(0.0, self._device.load - self.load)

    @property
    def stretch(self) -> float:
        """How many times longer than its own steps a window takes: turns of the others come between them.

        1 where nobody else is busy; at most the number of engines, since the turns go round.
        """
        most = max(1, self._device.num_seats)
        beside = BACKGROUND_SHARE if self._device.has_background(self) else 0.0
        return min(most, beside + 1.0 / max(1.0 - self.elsewhere, 1.0 / most))

    def leave(self) -> None:
        """The engine has ended."""
        self.load = 0.0
        self.num_waited_for = self.num_background = 0
        self._device.leave(self)


class InTurns:
    """A runner each of whose calls takes a turn, for calls that are made outside of an engine's steps."""

    def __init__(self, runner: Runner, lease: DeviceLease) -> None:
        self._runner = runner
        self._lease = lease

    @property
    def facts(self) -> ModelFacts:
        """As the runner's."""
        return self._runner.facts

    def num_passes(self, job: WindowJob) -> int:
        """As the runner's."""
        return self._runner.num_passes(job)

    def features(self, rows: Float32Array) -> Float32Array:
        """As the runner's."""
        with self._lease:
            return self._runner.features(rows)

    def outputs(self, names: Sequence[str], rows: Float32Array) -> Float32Array:
        """As the runner's."""
        with self._lease:
            return self._runner.outputs(names, rows)

    def prepare(self, jobs: Sequence[WindowJob]) -> None:
        """As the runner's."""
        with self._lease:
            self._runner.prepare(jobs)

    def denoise(self, job_ids: Sequence[int]) -> list[RowStatus]:
        """As the runner's."""
        with self._lease:
            return self._runner.denoise(job_ids)

    def decode(self, job_ids: Sequence[int]) -> list[WindowResult]:
        """As the runner's."""
        with self._lease:
            return self._runner.decode(job_ids)

    def discard(self, job_ids: Sequence[int]) -> None:
        """As the runner's."""
        with self._lease:
            self._runner.discard(job_ids)
