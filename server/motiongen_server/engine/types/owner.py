"""Owner: the party that sessions belong to, for the scheduler's shares."""

from __future__ import annotations

from dataclasses import dataclass
from math import inf
from typing import TypeAlias


@dataclass(frozen=True, slots=True)
class Owner:
    """A tenant, or, without tenants, the address that a client calls from.

    name: the same for all of its sessions. weight: its share of denoising steps relative to other owners', when they
    ask for more than there is time for. steps_per_s: rows of denoising steps that it may use per second, on all engines
    together.
    """

    name: str = ""
    weight: float = 1.0
    steps_per_s: float = inf


NOBODY = Owner()
StepsOf: TypeAlias = tuple[tuple[Owner, int], ...]
"""Rows of denoising steps that each owner has used."""
