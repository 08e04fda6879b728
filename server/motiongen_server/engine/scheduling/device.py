"""Device: shared by the engines of one process. They take turns on it, and each knows how much the others use."""

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
"""The share of the device that an engine with background windows only may use beside engines with others.

It is a share of the time of turns with windows that somebody waits for. Within one engine, the background lengthens a
step by as much.
"""
MOST_OWED_S = 1.0
"""The most time that the background makes up for, however long one of its calls was delayed."""


class Device:
    """Gives turns in the order in which they were asked for, so an engine waits for at most one step of each other.

    The background of an engine takes what is left by the windows that somebody waits for in all engines, not only its
    own. Its lease says how much that is. If it took more, as a step that cannot be smaller may, it gets nothing until
    that is made up for.
    """

    def __init__(self, quota: QuotaAccount | None = None, *, counts_own: bool = False) -> None:
        """quota: the processor's, None if there is none or its use is not known.

        counts_own: engines' own work counts as use of the device, which stands still meanwhile. On a processor it does
        not count: there it is only a thirtieth of all.
        """
        self.quota = quota
        self.counts_own = counts_own
        self._lock = threading.Lock()
        self._taken = False
        self._waiting: deque[threading.Lock] = deque()
        self._seats: list[DeviceLease] = []
        self._spare_s = 0.0  # left for the background beside others; only changed by the engine whose turn it is

    def lease(self) -> DeviceLease:
        """A place for one more engine, which must give it up when it ends."""
        lease = DeviceLease(self)
        with self._lock:
            self._seats.append(lease)
        return lease

    @property
    def load(self) -> float:
        """The share of the device that all engines use together."""
        return sum(lease.load for lease in tuple(self._seats))

    @property
    def num_seats(self) -> int:
        return len(self._seats)

    @property
    def num_waiting(self) -> int:
        """How many engines wait for a turn."""
        return len(self._waiting)

    def is_waited_for(self, but: DeviceLease) -> bool:
        """Whether another engine than `but` is working on windows that somebody waits for."""
        return any(seat.num_waited_for and seat is not but for seat in tuple(self._seats))

    def has_background(self, but: DeviceLease) -> bool:
        """Whether another engine than `but` is working on background windows."""
        return any(seat.num_background and seat is not but for seat in tuple(self._seats))

    def spare_s(self, lease: DeviceLease) -> float:
        """As `DeviceLease.spare_s`."""
        return max(0.0, self._spare_s) if self.is_waited_for(lease) else inf

    def settle(self, lease: DeviceLease, waited_for_s: float, background_s: float) -> None:
        """End of a turn: account for the time of its calls, by the kind of window they were for."""
        if waited_for_s:
            share_s = BACKGROUND_SHARE * (waited_for_s + background_s)
            self._spare_s = min(self._spare_s + share_s, share_s)  # unused time is not saved up
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
        """Wait for a turn. Returns the seconds that this took."""
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
        """End a turn; the engine that has waited longest gets the next one at once."""
        with self._lock:
            if self._waiting:
                self._waiting.popleft().release()
            else:
                self._taken = False


class DeviceLease:
    """One engine's place at the device. `with lease:` is a turn.

    load: the share of the device that this engine uses; num_waited_for, num_background: its windows under way; the
    engine sets these itself. waited_s: how long it has waited for its turns in total.
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
        """A call of the runner in this turn took this long. background: the background's share of it."""
        self._waited_for_s += (1.0 - background) * seconds
        self._background_s += background * seconds

    @property
    def spare_s(self) -> float:
        """How long a step for the background alone may take now; 0: there must be none.

        Infinity if no other engine is working on windows that somebody waits for. To be asked during a turn.
        """
        return self._device.spare_s(self)

    @property
    def quota(self) -> QuotaAccount | None:
        """The device's."""
        return self._device.quota

    @property
    def counts_own(self) -> bool:
        """The device's."""
        return self._device.counts_own

    @property
    def elsewhere(self) -> float:
        """The share of the device that the other engines use."""
        return max(0.0, self._device.load - self.load)

    @property
    def stretch(self) -> float:
        """By what factor turns of the other engines lengthen a window beyond its own steps.

        1 if the others are idle; at most the number of engines, since the turns go round.
        """
        most = max(1, self._device.num_seats)
        beside = BACKGROUND_SHARE if self._device.has_background(self) else 0.0
        return min(most, beside + 1.0 / max(1.0 - self.elsewhere, 1.0 / most))

    def leave(self) -> None:
        """Give up the place, as the engine has ended."""
        self.load = 0.0
        self.num_waited_for = self.num_background = 0
        self._device.leave(self)


class InTurns:
    """A runner each of whose calls takes a turn, for calls outside of an engine's steps."""

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
