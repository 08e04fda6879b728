"""LoadMonitor: how loaded the machine is, and what follows from it for those who come in and those who are there."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from motiongen_server.engine.scheduling.admission import Admission
from motiongen_server.engine.scheduling.degradation import Degradation, Demand
from motiongen_server.engine.scheduling.device import DeviceLease
from motiongen_server.engine.scheduling.device_use import DeviceUse
from motiongen_server.engine.scheduling.edit_rates import EditRates
from motiongen_server.engine.scheduling.levels import FULL, Level, levels_of
from motiongen_server.engine.scheduling.prices import Prices
from motiongen_server.engine.scheduling.quota_share import QuotaShare
from motiongen_server.engine.scheduling.window_rates import WindowRates
from motiongen_server.engine.types import ModelFacts, Owner, Priority

EVERY_S = 0.25
_MEASURED_OVER_S = 2.0


class LoadMonitor:
    """Measures the load a few times a second, tells the admission, and moves classes from level to level.

    degrade False: levels stay where they are, and sessions get all they asked for, late if need be.
    """

    def __init__(self, facts: ModelFacts, admission: Admission, now: float, degrade: bool, lease: DeviceLease) -> None:
        self._admission = admission
        self._lease = lease
        self._facts = facts
        self._levels = levels_of(facts)
        self._degradation = Degradation(self._levels, now) if degrade else None
        self._rates = WindowRates(facts.fps / facts.horizon)
        self._edits = EditRates()
        self._quota = None if lease.quota is None else QuotaShare(lease.quota)
        self._use = self._of_late = DeviceUse()
        self._at = now

    @property
    def due_at(self) -> float:
        """When to measure next."""
        return self._at + EVERY_S

    @property
    def load(self) -> float:
        """Share of the machine that was in use of late, counted as if all steps had been full, by other engines too.

        Of a quota, only what engines themselves used counts: this tells whether they keep up, not who may come in.
        """
        return self._of_late.work_s + self._lease.elsewhere

    @property
    def spoken_for(self) -> float:
        """The share of the machine by which sessions are let in or refused: of a quota, all that goes with theirs."""
        return self._admission.load

    @property
    def shed(self) -> bool:
        """Whether all that could be given up was, and it did not help."""
        return self._degradation is not None and self._degradation.shed

    def level(self, priority: Priority) -> Level:
        """Where a class is."""
        return self._degradation.level(priority) if self._degradation is not None else FULL

    def note_replan(self, priority: Priority, owner: Owner, share: float) -> None:
        """A session's window was begun that changes what it would show. share: of a whole window's steps, below 0 for
        one that was let go of."""
        self._rates.note_replan(priority, share)
        self._edits.note(owner, share)

    def note_windows(self, now: float, windows: int, late: float) -> None:
        """So many windows were due, and so late were they, in windows: see `Degradation.note_windows`."""
        if self._degradation is not None:
            self._degradation.note_windows(now, windows, late)

    def measure(
        self, now: float, use: DeviceUse, prices: Prices, present: Mapping[Priority, int]
    ) -> Iterable[Priority]:
        """Take stock; returns the classes that are on another level now. use: of the device since the start."""
        elapsed_s = now - self._at
        if elapsed_s > 0:
            self._rates.update(elapsed_s, present)
            self._edits.update(elapsed_s)
            rates = use.rates(self._use, elapsed_s)
            self._of_late = self._of_late.toward(rates, min(1.0, elapsed_s / _MEASURED_OVER_S))
            if self._quota is not None:
                self._quota.update(elapsed_s, self._of_late.spent_s + self._lease.elsewhere)
        self._use, self._at = use, now
        measured, elsewhere = self._of_late.work_s, self._lease.elsewhere
        self._lease.load = measured
        times = 1.0 if self._quota is None else self._quota.factor
        prices = Prices(times * prices.step_s, times * prices.window_s)
        self._admission.set_prices(prices, times * measured, times * elsewhere, self._rates, self._edits.by_owner)
        if self._degradation is None:
            return ()
        yielding = self._admission.yielding()
        kept = [level.kept(self._facts, prices) for level in self._levels]
        demand = Demand(self._admission.asked_by_class, kept, times * elsewhere - yielding)
        load = self.load - yielding / times  # both of the machine as engines themselves use it
        return self._degradation.update(now, load, present, self._of_late.busy_s + elsewhere, demand)
