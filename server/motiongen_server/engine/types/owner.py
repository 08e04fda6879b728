"""Owner: whose a session is, for the shares that the scheduler gives out."""

from __future__ import annotations

from dataclasses import dataclass
from math import inf
from typing import TypeAlias


@dataclass(frozen=True, slots=True)
class Owner:
    """A tenant, or the address that a client calls from where nobody is asked who calls.

    name: equal for all of its sessions. weight: of its share in denoising steps beside other owners, where they ask for
    more than there is time for. steps_per_s: rows of denoising steps that it may have a second, of all engines.
    """

    name: str = ""
    weight: float = 1.0
    steps_per_s: float = inf


NOBODY = Owner()
StepsOf: TypeAlias = tuple[tuple[Owner, int], ...]
"""Owners, and rows of denoising steps that each has had."""
