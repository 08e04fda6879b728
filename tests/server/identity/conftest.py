"""Fixtures of the tests of identity."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.server.identity.files import TenantsFile


@pytest.fixture
def tenants(tmp_path: Path) -> TenantsFile:
    return TenantsFile(tmp_path)
