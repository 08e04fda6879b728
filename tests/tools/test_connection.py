"""How commands reach a server: what its files must be."""

from __future__ import annotations

from pathlib import Path

import pytest

from motiongen_client import InvalidInput
from motiongen_tools.connection import Connection


@pytest.mark.parametrize("content", [b"", b"not PEM", b"\x30\x82\x01"])
@pytest.mark.parametrize("name", ["authorities", "certificate", "key"])
def test_a_file_that_is_no_pem_is_named(name: str, content: bytes, tmp_path: Path) -> None:
    (tmp_path / "given").write_bytes(content)
    connection = Connection(tls=True, **{name: tmp_path / "given"})
    with pytest.raises(InvalidInput, match=r"tls-.*given' was given; allowed is a PEM file"):
        connection.client("localhost:1")
