"""Synthetic motion of a figure with hands and feet that walks along +Z at 1 m/s."""

from __future__ import annotations

from tests.client.conftest import stick_motion, stick_rig

__all__ = ["stick_motion", "stick_rig"]
