"""The tools are tested against the client's fake server and with its motion."""

from __future__ import annotations

from tests.client.conftest import server, stick_motion, stick_rig

__all__ = ["server", "stick_motion", "stick_rig"]
