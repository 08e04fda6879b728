"""A fake server for each test that asks, and motions made by formula."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from motiongen_client import Motion, Rig, convert
from tests.client.fake_server import FakeServer, rig, synthetic_rows


@pytest.fixture
def server() -> Iterator[FakeServer]:
    with FakeServer() as running:
        yield running


@pytest.fixture
def stick_rig() -> Rig:
    return convert.rig(rig(20))


@pytest.fixture
def stick_motion(stick_rig: Rig) -> Motion:
    """Two seconds from frame 0."""
    return Motion(stick_rig, 0, synthetic_rows(1, 0, 40))
