"""The simulation: bookkeeping, reproducibility by seed, placement policies, and results computed by hand."""

from __future__ import annotations

import random
from dataclasses import replace

import pytest

from tests.scale.simulation.assumptions import Assumptions, Day
from tests.scale.simulation.day import USUAL, Outcome, Simulation
from tests.scale.simulation.fleet import Client, Fleet, Placement

SHORT = Day(ends_at=1900.0, warm_until=100.0, wave_at=200.0, zone_fails_at=500.0, zone_back_at=700.0, upgrade_at=800.0)
CALM = replace(SHORT, wave=1.0, zone_fails_at=1e9, upgrade_at=1e9)


def fleet_of(servers: int, placement: Placement, given: Assumptions = USUAL) -> Fleet:
    fleet = Fleet(given, placement, random.Random(3))
    for _ in range(servers):
        fleet.add()
    return fleet


def run(placement: Placement, day: Day = SHORT, seed: int = 1, **given: object) -> tuple[Simulation, Outcome]:
    simulation = Simulation(9, placement, Assumptions(**given), day, seed)  # type: ignore[arg-type]
    return simulation, simulation.run()


@pytest.mark.parametrize("placement", Placement)
def test_every_character_is_on_at_most_one_server(placement: Placement) -> None:
    fleet = run(placement)[0].fleet
    assert len(fleet.servers) >= 6
    for server in fleet.servers:
        assert server.characters == sum(client.characters for client in server.clients)
        assert all(client.server is server for client in server.clients)
        assert server.characters <= fleet.given.admitted * fleet.given.capacity
    everybody = [client for server in fleet.servers for client in server.clients]
    assert len(set(everybody)) == len(everybody)


def test_same_seed_gives_the_same_day() -> None:
    assert run(Placement.HINT, seed=5)[1] == run(Placement.HINT, seed=5)[1]
    assert run(Placement.HINT, seed=5)[1] != run(Placement.HINT, seed=6)[1]


def test_calm_day_has_the_number_of_characters_of_littles_law() -> None:
    """Computed independently: arrivals a second, times characters each, times seconds that they stay."""
    simulation, outcome = run(Placement.LEAST, CALM)
    expected = 9 * simulation.given.capacity * simulation.given.target
    mean = sum(sample.characters for sample in outcome.samples) / len(outcome.samples)
    assert mean == pytest.approx(expected, rel=0.15)
    assert outcome.moved == 0


def test_key_leads_to_one_server_and_after_its_removal_to_another() -> None:
    fleet = fleet_of(5, Placement.KEY)
    client = Client(0.4, 1, 1e9)
    first = fleet.place(client)
    assert first is not None
    fleet.leave(client)
    assert fleet.place(client) is first
    fleet.leave(client)
    fleet.remove(first)
    assert fleet.place(client) not in (None, first)


def test_bounded_placement_gives_no_server_more_than_its_share() -> None:
    fleet = fleet_of(5, Placement.BOUNDED)
    for number in range(40):
        assert fleet.place(Client(0.4 + number / 1e6, 1, 1e9)) is not None
    assert max(len(server.clients) for server in fleet.servers) <= 1.5 * 41 / 5


def test_full_server_refuses_unless_it_can_name_another() -> None:
    for placement, is_placed in ((Placement.KEY, False), (Placement.HINT, True)):
        fleet = fleet_of(5, placement)
        server = fleet.place(Client(0.4, 1, 1e9))
        assert server is not None
        server.characters = fleet.given.capacity
        assert (fleet.place(Client(0.4, 1, 1e9)) is not None) == is_placed


def test_windows_use_the_capacity_that_playing_characters_leave() -> None:
    """A server for 200 characters with 100 on it generates 50 more windows a second; a second later, 50 fewer wait."""
    given = Assumptions(capacity=200, window_s=2.0)
    server = fleet_of(1, Placement.KEY, given).servers[0]
    server.characters = 100
    assert server.wait_s(100, 10.0, given) == pytest.approx(2.0)
    assert server.wait_s(0, 11.0, given) == pytest.approx(1.0)
    assert server.wait_s(50, 100.0, given) == pytest.approx(1.0)


def test_loss_of_one_zone_of_three_is_absorbed_at_half_load_and_not_at_0_8() -> None:
    """The rest get half as much again: at a load of 0.5 all find room, and windows within seconds; at 0.8 not."""
    day = replace(CALM, zone_fails_at=500.0, ends_at=560.0)
    borne = run(Placement.LEAST, day, target=0.5, characters=2.0, admitted=1.0)[1]
    not_borne = run(Placement.LEAST, day, target=0.8, characters=2.0, admitted=1.0)[1]
    assert max(borne.away) < 4.0
    assert len(borne.away) > 0.95 * borne.moved, "except clients that left by themselves"
    assert max(not_borne.away, default=0.0) > 10.0 or len(not_borne.away) < 0.9 * not_borne.moved


def test_upgrade_replaces_every_server() -> None:
    simulation, outcome = run(Placement.HINT, replace(SHORT, zone_fails_at=1e9))
    assert outcome.upgraded_s > 0
    assert min(server.number for server in simulation.fleet.servers) > 9
