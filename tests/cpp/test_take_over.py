"""The C++ client and two servers that share a store: one continues the sessions of the other, at another address."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from pathlib import Path

import pytest

from motiongen_server.replicas.directory import Replica
from motiongen_server.replicas.other_servers import OtherServers
from motiongen_server.snapshots import writer
from motiongen_server.snapshots.sqlite_store import SqliteStore
from tests.contract.local import LocalServer
from tests.cpp.test_client import Character, character
from tests.e2e.lost_line import FACTS_AS_SERVED
from tests.e2e.tcp_proxy import TcpProxy
from tests.server.replicas.told import Told
from tests.waiting import LIMIT_S, until

Program = Callable[[str], Path]
KEY = "0123456789abcdef"


@pytest.fixture(autouse=True)
def short_delays(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(writer, "RETRY_S", 0.02)
    monkeypatch.setattr(writer, "RENEW_EVERY_S", 0.1)


class Pair:
    """A server behind a proxy that can cut its connections, and a second server."""

    def __init__(self, servers: tuple[LocalServer, LocalServer], proxy: TcpProxy) -> None:
        self.servers, self.proxy = servers, proxy
        self._loop = asyncio.get_running_loop()

    def disconnect_the_first(self) -> None:
        """Make the first server unreachable. It keeps running, and does not notice. May be called from any thread."""

        def shut() -> None:
            self.proxy.is_shut = True
            self.proxy.cut()

        self._loop.call_soon_threadsafe(shut)

    def cut(self) -> None:
        """Cut every connection. May be called from any thread."""
        self._loop.call_soon_threadsafe(self.proxy.cut)

    def drain_the_first(self, to: LocalServer | None = None) -> None:
        """Have the first server say goodbye and end its sessions. May be called from any thread.

        to: the server that new connections reach from then on.
        """

        def drain() -> None:
            if to is not None:
                self.proxy.behind = to.address
            self.servers[0].service.goodbye(1.0)
            self.servers[0].service.close_all()

        self._loop.call_soon_threadsafe(drain)


@asynccontextmanager
async def pair(path: Path) -> AsyncIterator[Pair]:
    stores = (SqliteStore(path / "one.sqlite", 60), SqliteStore(path / "one.sqlite", 60))
    first, second = (LocalServer(facts=FACTS_AS_SERVED, snapshots=store) for store in stores)
    async with asyncio.timeout(LIMIT_S), first, second, TcpProxy(first.address) as proxy:
        yield Pair((first, second), proxy)


def begin(walker: Character) -> None:
    """Play until the session is stored, and make an edit."""
    while walker.hear("durability")[1] != "1":
        pass
    walker.tell("wait 60")
    assert walker.hear("frame")[2] == "OK"
    walker.tell("prompt second one")
    assert walker.hear("edit")[2] == "OK"


def check_all_there(walker: Character, to: int) -> None:
    """Check that every frame up to `to` has come."""
    walker.tell(f"wait {to}")
    assert walker.hear("frame")[2] == "OK"


async def test_session_is_continued_exactly_at_another_address(program: Program, tmp_path: Path) -> None:
    def play(two: Pair) -> None:
        address, other = two.proxy.address, two.servers[1].address
        with character(program, address, MOTIONGEN_OTHER=other, MOTIONGEN_LOOKAHEAD="80") as walker:
            begin(walker)
            walker.tell("waypoint 400 1 2")
            assert walker.hear("edit")[2] == "OK"
            before = walker.place(40)
            two.disconnect_the_first()
            assert walker.hear("lost")[1] == "UNAVAILABLE"
            walker.tell("prompt while there is no line")
            _, first, exact = walker.hear("recovered")
            assert exact == "1"
            assert walker.hear("edit")[2] == "OK", "an edit unanswered by the first server is answered by the second"
            assert walker.place(40) == before
            check_all_there(walker, int(first) + 40)
            walker.tell("stats")
            assert walker.hear("stats")[4] == "1", "one recovery"
            walker.tell("close")
            until(
                lambda: two.servers[1].engine.num_sessions == 0
            )  # while the connection stays: the session is closed, not kept

    async with pair(tmp_path) as two:
        await asyncio.to_thread(play, two)


async def test_session_of_a_draining_server_is_continued_at_the_next_address(program: Program, tmp_path: Path) -> None:
    def play(two: Pair) -> None:
        address, other = two.proxy.address, two.servers[1].address
        with character(program, address, MOTIONGEN_OTHER=other, MOTIONGEN_LOOKAHEAD="80") as walker:
            begin(walker)
            two.drain_the_first()
            walker.hear("draining")
            two.disconnect_the_first()
            _, first, exact = walker.hear("recovered")
            assert exact == "1"
            check_all_there(walker, int(first) + 40)

    async with pair(tmp_path) as two:
        await asyncio.to_thread(play, two)


async def test_session_is_continued_with_the_routing_key_named_in_a_goodbye(program: Program, tmp_path: Path) -> None:
    """As behind a proxy: the address stays the same, and the next calls carry the named key."""
    stores = (SqliteStore(tmp_path / "one.sqlite", 60), SqliteStore(tmp_path / "one.sqlite", 60))
    directories = Told(), Told()
    others = [OtherServers(each, clock=lambda: 0.0) for each in directories]  # so that its knowledge does not expire
    first, second = (
        LocalServer(facts=FACTS_AS_SERVED, snapshots=store, other_servers=known)
        for store, known in zip(stores, others, strict=True)
    )
    async with asyncio.timeout(LIMIT_S), first, second, TcpProxy(first.address) as proxy:
        two = Pair((first, second), proxy)
        directories[0].others = [Replica("second", "elsewhere:1", KEY, {first.model.model_id: 0.5})]
        await asyncio.to_thread(others[0].exchange)

        def play() -> None:
            with character(program, proxy.address, MOTIONGEN_LOOKAHEAD="80") as walker:
                begin(walker)
                two.drain_the_first(to=second)
                walker.hear("draining")
                two.cut()  # a real proxy can lead calls of one connection to several servers
                _, at, exact = walker.hear("recovered")
                assert exact == "1"
                check_all_there(walker, int(at) + 40)

        await asyncio.to_thread(play)
        await asyncio.to_thread(others[1].exchange)
        assert directories[1].own[-1].routing_key == KEY


async def test_session_without_a_store_is_reopened_at_the_next_address(program: Program) -> None:
    def play(two: Pair) -> None:
        address, other = two.proxy.address, two.servers[1].address
        with character(program, address, MOTIONGEN_OTHER=other, MOTIONGEN_LOOKAHEAD="80") as walker:
            walker.tell("wait 60")
            walker.hear("frame")
            walker.tell("go 1 30")
            walker.hear("edit")
            placed = walker.hear("placed")
            walker.tell("velocity 0 1 seconds=1")
            assert walker.hear("edit")[2] == "OK"
            two.disconnect_the_first()
            _, first, exact = walker.hear("recovered")
            assert exact == "0"
            assert int(first) <= int(placed[4])
            check_all_there(walker, int(first) + 40)

    first, second = LocalServer(facts=FACTS_AS_SERVED), LocalServer(facts=FACTS_AS_SERVED)
    async with asyncio.timeout(LIMIT_S), first, second, TcpProxy(first.address) as proxy:
        await asyncio.to_thread(play, Pair((first, second), proxy))
