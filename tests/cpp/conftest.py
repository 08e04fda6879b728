"""The C++ client for tests: built once, with its unit tests and the programs that tests control."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from tests.cpp.building import build

BUILD_TIMEOUT_S = 1500  # for the first test, which builds: compiling gRPC's headers takes long on a small machine


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    for item in items:
        if Path(__file__).parent in item.path.parents and item.get_closest_marker("timeout") is None:
            item.add_marker(pytest.mark.timeout(BUILD_TIMEOUT_S))


@pytest.fixture(scope="session")
def program() -> Callable[[str], Path]:
    """The path of a program of client/cpp by its target's name; all are built at the first request."""
    folder = build("test", "-DMOTIONGEN_TESTS=ON", "-DMOTIONGEN_EXAMPLES=ON")

    def find(name: str) -> Path:
        found = [path for path in (folder / part / name for part in ("tests", "examples", "load")) if path.is_file()]
        assert found, f"client/cpp builds no program called {name}"
        return found[0]

    return find
