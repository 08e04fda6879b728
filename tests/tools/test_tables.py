"""The tables of the command line: names are shown in full, however narrow the terminal."""

from __future__ import annotations

import asyncio

import pytest

from motiongen_tools.cli import run
from motiongen_tools.console import make_console, make_table
from tests.client.fake_server import FakeServer
from tests.client.synthetic import catalog


async def test_names_of_the_catalogue_are_shown_in_full_in_80_columns(
    server: FakeServer, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    offered = catalog(100)
    names = ("motiongen-mini", "static-b8a02ae25cd7", "CC-BY-NC-4.0")
    offered.models[0].model_id, offered.models[0].text_encoder, offered.models[0].licence = names
    monkeypatch.setattr("tests.client.fake_server.catalog", lambda _: offered)
    monkeypatch.setenv("COLUMNS", "80")
    assert await asyncio.to_thread(run, ["catalog", "--server", server.address]) == 0
    printed = capsys.readouterr().out
    assert [name for name in names if name not in printed] == []


def test_a_name_wider_than_the_terminal_is_shown_in_full(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "30")
    table = make_table("", "model", "licence")
    table.add_row(60 * "x", 20 * "y")
    make_console().print(table)
    printed = capsys.readouterr().out
    assert (printed.count("x"), printed.count("y")) == (60, 20)
