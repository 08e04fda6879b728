"""LoadMonitor: measures how loaded the machine is, and adapts admission and service levels to it."""

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
    """Measures the load a few times per second, informs the admission, and moves classes from level to level.

    degrade False: levels do not change, and sessions get everything they asked for, late if necessary.
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
        """The share of the machine used lately, other engines included, counted as if all steps had been full.

        Under a quota, only what engines themselves used counts: this says whether they keep up, not whom to admit.
        """
        return self._of_late.work_s + self._lease.elsewhere

    @property
    def spoken_for(self) -> float:
        """The load by which sessions are admitted; under a quota, with what others use because of the sessions."""
        return self._admission.load

    @property
    def shed(self) -> bool:
        """Whether everything that could be given up was, and it did not help."""
        return self._degradation is not None and self._degradation.shed

    def level(self, priority: Priority) -> Level:
        """The level of a class."""
        return self._degradation.level(priority) if self._degradation is not None else FULL

    def note_replan(self, priority: Priority, owner: Owner, share: float) -> None:
        """A window was begun that changes what a session would show.

        share: of a full window's steps; negative for a window that was discarded.
        """
        self._rates.note_replan(priority, share)
        self._edits.note(owner, share)

    def note_windows(self, now: float, windows: int, late: float) -> None:
        """Windows were due, and were late by this much, in windows: see `Degradation.note_windows`."""
        if self._degradation is not None:
            self._degradation.note_windows(now, windows, late)

    def measure(
        self, now: float, use: DeviceUse, prices: Prices, present: Mapping[Priority, int]
    ) -> Iterable[Priority]:
        """Measure the load. Returns the classes whose level changed. use: of the device since the start."""
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
        load = self.load - yielding / times  # both as shares of what the engines themselves use
        return self._degradation.update(now, load, present, self._of_late.busy_s + elsewhere, demand)
