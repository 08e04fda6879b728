"""Tests that several processes share: whole files, and folders whose tests share what is built once."""

import pytest

from tests.scheduling import TOGETHER, scope_of


@pytest.mark.parametrize(
    ("nodeid", "scope"),
    [
        ("tests/client/test_axes.py::test_a", "tests/client/test_axes.py"),
        ("tests/client/test_axes.py::test_a[x::y/z]", "tests/client/test_axes.py"),
        ("tests/cpp/test_core.py::test_a", "tests/cpp"),
        ("tests/cpp/deeper/test_core.py::test_a", "tests/cpp"),
    ],
)
def test_what_stays_together(nodeid: str, scope: str) -> None:
    assert scope_of(nodeid) == scope


def test_folders_that_stay_together_exist(pytestconfig: pytest.Config) -> None:
    assert [folder for folder in TOGETHER if not (pytestconfig.rootpath / folder).is_dir()] == []
