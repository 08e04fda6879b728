"""Motions by formula, of a figure with hands and feet that walks 1 m/s along +Z."""

from __future__ import annotations

from tests.client.conftest import stick_motion, stick_rig

__all__ = ["stick_motion", "stick_rig"]
