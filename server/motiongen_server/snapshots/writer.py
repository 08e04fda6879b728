"""SnapshotWriter: writes sessions' records to the store, on a thread of its own. Callers never wait for it.

The thread writes the newest record of each session; a record that is replaced by a newer one before its turn is never
written. So the records that wait are no more than the sessions, however slow the store is.
"""

from __future__ import annotations

import contextlib
import logging
import os
import sys
import threading
import time
from collections.abc import Callable

from motiongen_server.snapshots.listener import Listener, Written
from motiongen_server.snapshots.record import RecordRefused, SessionRecord, write_record
from motiongen_server.snapshots.refused_records import RefusedRecords
from motiongen_server.snapshots.store import Lease, Renewal, SnapshotStore, StoreFailed

_log = logging.getLogger(__name__)

MOST_AT_ONCE = 64
"""Records per call of the store; limited, so that the first of many is durable soon."""
RENEW_EVERY_S = 5.0
RETRY_S = 1.0
"""The wait after a call that failed."""
MAX_LAG_S = 2.0
"""If a record waits longer than this for its turn, the store is not to be relied upon."""
MOST_DROPPED = 4096
LAST_WRITES_S = 2.0
NO_SESSION = "none"
"""A name that no record has: those of sessions are hashes."""
NICENESS = 5
"""Added to the process's for the writer's thread: if all cores are busy, threads that answer clients come first."""


class SnapshotWriter:
    """Used from any thread."""

    def __init__(self, store: SnapshotStore, listener: Listener, clock: Callable[[], float] = time.monotonic) -> None:
        self._store = store
        self._listener = listener
        self._clock = clock
        self._lock = threading.Lock()
        self._news = threading.Condition(self._lock)
        self._waiting: dict[Lease, tuple[SessionRecord, float]] = {}
        self._dropped: list[Lease] = []
        self._leases: set[Lease] = set()
        self._fresh: set[Lease] = set()  # written since the last renewal
        self._refused = RefusedRecords()
        self._untold: dict[Lease, int] = {}  # the last event of records written while the store was in doubt
        self._is_closing = False
        self._is_failing = False
        self._renewed_at = clock()
        self._renew_at = self._renewed_at + RENEW_EVERY_S
        self._thread = threading.Thread(target=self._run, name="snapshots", daemon=True)
        self._thread.start()

    @property
    def is_failing(self) -> bool:
        """Whether the store has failed or was too slow, and has not been seen to work since."""
        return self._is_failing

    @property
    def lag_s(self) -> float:
        """How long the oldest waiting record has been waiting; 0 if none waits."""
        with self._lock:
            oldest = min((since for _, since in self._waiting.values()), default=None)
        return 0.0 if oldest is None else max(0.0, self._clock() - oldest)

    @property
    def _is_behind(self) -> bool:
        """Whether a record has waited so long that the store is not to be relied upon, although it answers."""
        return bool(self._waiting) and self.lag_s > MAX_LAG_S

    def save(self, lease: Lease, record: SessionRecord) -> None:
        """Write a record soon, in place of one of the same session that still waits."""
        with self._lock:
            since = self._waiting[lease][1] if lease in self._waiting else self._clock()
            self._waiting[lease] = record, since
            self._leases.add(lease)
            self._news.notify()
            _, oldest = next(iter(self._waiting.values()))  # in the order in which they began to wait
        if self._clock() - oldest > 2 * MAX_LAG_S:  # the thread, which would report it, hangs in a call of the store
            self._doubt(f"{self._store} has not answered for more than {2 * MAX_LAG_S:g} s")

    def hold(self, lease: Lease) -> None:
        """A session was taken over and may not be saved for long: renew its record, and notice if another takes it."""
        with self._lock:
            self._leases.add(lease)

    def drop(self, lease: Lease) -> None:
        """The session is over: delete its record."""
        with self._lock:
            self._forget(lease)
            self._dropped.append(lease)
            self._news.notify()

    def release(self, lease: Lease) -> None:
        """The session has ended here, and may continue elsewhere: its record stays, and what waits is still written."""
        with self._lock:
            self._leases.discard(lease)
            self._untold.pop(lease, None)
            self._refused.forget(lease)

    def close(self) -> None:
        """Write what waits, for LAST_WRITES_S at most, end the thread and close the store."""
        with self._lock:
            self._is_closing = True
            self._news.notify()
        self._thread.join(LAST_WRITES_S)
        self._store.close()

    # ---- the writer's thread ----------------------------------------------------------------------------------------

    def _run(self) -> None:
        _yield_to_others()
        while True:
            with self._lock:
                timeout_s = max(0.0, self._renew_at - self._clock())
                self._news.wait_for(lambda: self._is_closing or self._waiting or self._dropped, timeout_s)
                is_closing = self._is_closing
                batch = {lease: self._waiting[lease] for lease in list(self._waiting)[:MOST_AT_ONCE]}
                dropped, self._dropped = self._dropped, []
            try:
                while dropped:  # first, as this makes room in a full store
                    self._store.drop(dropped[:MOST_AT_ONCE])
                    dropped = dropped[MOST_AT_ONCE:]
                self._write(batch)
                if self._clock() >= self._renew_at:
                    self._renew()
            except StoreFailed as error:
                self._fail(str(error), dropped)
                if is_closing:
                    return
            except Exception as error:  # if the thread ended, nothing would be saved any more, unnoticed
                if not self._is_failing:
                    _log.exception("%s failed unexpectedly", self._store)
                self._fail(f"{self._store}: {type(error).__name__}: {error}", dropped)
                if is_closing:
                    return
            if is_closing and not self._waiting:
                return

    def _write(self, batch: dict[Lease, tuple[SessionRecord, float]]) -> None:
        records: list[tuple[Lease, bytes]] = []
        for lease, (record, _) in batch.items():
            try:
                records.append((lease, write_record(record)))
            except RecordRefused as error:
                self._settle(lease, record)
                self._log_refused(lease, error)
                self._listener.lost([lease])
        if not records:
            return
        answers = self._store.save(records)
        if self.lag_s > MAX_LAG_S:  # of all waiting records, not only those of this call: others may wait longer
            self._doubt(f"{self._store} takes more than {MAX_LAG_S:g} s")
        elif self._is_failing:
            self._renew_at = self._clock()
        written, fenced = [], []
        for (lease, _), is_kept in zip(records, answers, strict=True):
            record = batch[lease][0]
            self._settle(lease, record)
            if is_kept:
                self._fresh.add(lease)
                written.append(Written(lease, record.taken_seq))
            else:
                fenced.append(lease)
        with self._lock:
            self._refused.note_kept(each.lease for each in written)
            if self._is_failing:
                self._untold.update(each for each in written if each.lease in self._leases)
        if written and not self._is_failing:
            self._listener.written(written)
        self._give_up(fenced)

    def _log_refused(self, lease: Lease, error: RecordRefused) -> None:
        """Once per session: clients can cause it, and each plan makes another record."""
        with self._lock:
            is_new = lease in self._leases and self._refused.note(lease)
        if is_new:
            _log.warning("a session is not saved: %s", error)

    def _settle(self, lease: Lease, record: SessionRecord) -> None:
        """A record has had its turn. If a newer one has taken its place meanwhile, that goes to the end of the queue.

        Otherwise sessions that are saved often would keep all others from being written.
        """
        with self._lock:
            held = self._waiting.pop(lease, None)
            if held is not None and held[0] is not record:
                self._waiting[lease] = held[0], self._clock()

    def _renew(self) -> None:
        # Writing a record renews it and tells as much, so fresh ones are left out, unless the store has failed.
        fresh, self._fresh = set() if self._is_failing else self._fresh, set()
        with self._lock:
            leases = [lease for lease in self._leases if lease not in self._waiting and lease not in fresh]
        if self._is_failing and not leases:
            self._store.read(NO_SESSION)  # without records to renew, ask for anything to see whether the store works
        of = self._ask_after(leases)
        self._renewed_at = self._clock()
        self._renew_at = self._renewed_at + RENEW_EVERY_S
        if self._is_failing and not self._is_behind:
            self._is_failing = False
            _log.warning("sessions are saved again, in %s", self._store)
            with self._lock:  # the store's records of refused ones are older than what their clients were told
                of[Renewal.KEPT] = [lease for lease in of[Renewal.KEPT] if lease not in self._refused]
            self._listener.renewed(of[Renewal.KEPT])
            with self._lock:
                untold, self._untold = self._untold, {}
            kept = set(of[Renewal.KEPT])
            if written := [Written(lease, seq) for lease, seq in untold.items() if lease in kept]:
                self._listener.written(written)
        self._miss(of[Renewal.GONE])
        self._give_up(of[Renewal.FENCED])

    def _miss(self, leases: list[Lease]) -> None:
        """The store has no record of these; of those whose records were too large, it may never have had one."""
        with self._lock:
            lost = [lease for lease in leases if lease in self._refused]
        if lost:
            self._listener.lost(lost)
        if gone := sorted(set(leases) - set(lost)):
            self._listener.gone(gone)

    def _ask_after(self, leases: list[Lease]) -> dict[Renewal, list[Lease]]:
        """Renew records. Calls the store even if there are none, so that it deletes what has expired."""
        answers: list[Renewal] = []
        for begin in range(0, max(1, len(leases)), MOST_AT_ONCE):
            answers += self._store.renew(leases[begin : begin + MOST_AT_ONCE])
        return {each: [lease for lease, said in zip(leases, answers, strict=True) if said is each] for each in Renewal}

    def _keep_from_expiring(self) -> None:
        """Renew the records in a store that takes no new ones, for example since it is full: clients may need them."""
        if self._clock() < self._renewed_at + RENEW_EVERY_S:
            return
        self._renewed_at = self._clock()
        with self._lock:
            leases = list(self._leases)
        with contextlib.suppress(Exception):  # the failure has been reported already
            self._give_up(self._ask_after(leases)[Renewal.FENCED])

    def _give_up(self, leases: list[Lease]) -> None:
        """Other servers hold these now."""
        if leases:
            with self._lock:
                for lease in leases:
                    self._forget(lease)
            self._listener.fenced(leases)

    def _forget(self, lease: Lease) -> None:
        self._waiting.pop(lease, None)
        self._untold.pop(lease, None)
        self._leases.discard(lease)
        self._refused.forget(lease)

    def _fail(self, why: str, dropped: list[Lease]) -> None:
        self._doubt(why)
        self._keep_from_expiring()
        with self._lock:
            self._dropped = [*dropped, *self._dropped][:MOST_DROPPED]  # records beyond these expire in the store
            self._news.wait_for(lambda: self._is_closing, RETRY_S)
            self._renew_at = self._clock()

    def _doubt(self, why: str) -> None:
        with self._lock:
            is_new, self._is_failing = not self._is_failing, True
        if is_new:
            _log.error("sessions are not saved reliably any more: %s", why)
            self._listener.failed()


def _yield_to_others() -> None:
    """Lower the priority of this thread only, which is possible only on Linux."""
    if sys.platform == "linux":
        own = threading.get_native_id()
        with contextlib.suppress(OSError):
            os.setpriority(os.PRIO_PROCESS, own, os.getpriority(os.PRIO_PROCESS, own) + NICENESS)
