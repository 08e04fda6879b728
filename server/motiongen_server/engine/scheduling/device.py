"""Device: what the engines of one process share. They take turns on it, and each knows what the others use of it."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Sequence
from types import TracebackType

from motiongen_server.engine.ports import Runner
from motiongen_server.engine.scheduling.quota_share import QuotaAccount
from motiongen_server.engine.types import Float32Array, ModelFacts, RowStatus, WindowJob, WindowResult


class Device:
    """Gives turns in the order in which they were asked for: an engine waits for one step of each other at most."""

    def __init__(self, quota: QuotaAccount | None = None) -> None:
        """quota: of the processor, None where there is none or nobody tells what is used of it."""
        self.quota = quota
        self._lock = threading.Lock()
        self._taken = False
        self._waiting: deque[threading.Lock] = deque()
        self._seats: list[DeviceLease] = []

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

    def leave(self, lease: DeviceLease) -> None:
        """Give up a place."""
        with self._lock:
            if lease in self._seats:
                self._seats.remove(lease)

    def take(self) -> None:
        """Wait for a turn."""
        with self._lock:
            if not self._taken:
                self._taken = True
                return
            called = threading.Lock()
            called.acquire()
            self._waiting.append(called)
        called.acquire()

    def pass_on(self) -> None:
        """End a turn; the next begins at once, for whoever has waited longest."""
        with self._lock:
            if self._waiting:
                self._waiting.popleft().release()
            else:
                self._taken = False


class DeviceLease:
    """One engine's place at the device. `with lease:` is a turn.

    load: the share of the device that this engine uses; it tells it itself.
    """

    def __init__(self, device: Device) -> None:
        self._device = device
        self.load = 0.0

    def __enter__(self) -> DeviceLease:
        self._device.take()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._device.pass_on()

    @property
    def quota(self) -> QuotaAccount | None:
        """As of the device."""
        return self._device.quota

    @property
    def elsewhere(self) -> float:
        """The share of the device that the other engines use."""
        return max(0.0, self._device.load - self.load)

    @property
    def stretch(self) -> float:
        """How many times longer than its own steps a window takes: turns of the others come between them.

        1 where nobody else is busy; at most the number of engines, since the turns go round.
        """
        return 1.0 / max(1.0 - self.elsewhere, 1.0 / max(1, self._device.num_seats))

    def leave(self) -> None:
        """The engine has ended."""
        self.load = 0.0
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
