"""Repertoire: what a checkpoint says about its training, with its prompts encoded by the server's text encoder."""

from __future__ import annotations

import logging
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from motiongen_server.engine.types import Direction, Gait
from motiongen_server.rpc.abilities import NOTHING_CLAIMED, Abilities, FormSupport, GaitText, PresetText, PromptDomain
from motiongen_server.text.presets import Preset

if TYPE_CHECKING:
    from motiongen_ardy.capabilities import Capabilities
    from motiongen_server.text.ports import TextEncoder

_log = logging.getLogger(__name__)

_SUPPORT = {"trained": FormSupport.TRAINED, "warn": FormSupport.UNTRAINED, "refuse": FormSupport.REFUSED}


@dataclass(frozen=True)
class Repertoire:
    """presets, gaits: with their embeddings. abilities: those that are valid with the server's text encoder."""

    presets: tuple[Preset, ...]
    gaits: tuple[Gait, ...]
    abilities: Abilities


NOTHING_SAID = Repertoire((), (), NOTHING_CLAIMED)


def as_abilities(capabilities: Capabilities) -> Abilities:
    """What was read from a checkpoint, in the server's own types, which are sent to the gateway."""
    domain = capabilities.domain
    return Abilities(
        forms={form: _SUPPORT[support] for form, support in capabilities.forms.items()},
        presets=tuple(PresetText(preset.name, preset.text, preset.what) for preset in capabilities.presets),
        gaits=tuple(
            GaitText(gait.name, gait.text, gait.from_mps, Direction[gait.direction.upper()], gait.to_mps)
            for gait in capabilities.locomotion
        ),
        known_motions=capabilities.knows,
        domain=None
        if domain is None
        else PromptDomain(domain.text_encoder, domain.mean, domain.directions, domain.threshold),
    )


def encoded(abilities: Abilities, encoder: TextEncoder, model_id: str) -> Repertoire:
    """The prompts of a checkpoint, encoded. What this encoder cannot encode is left out, and logged."""
    domain = abilities.domain
    if domain is not None and domain.text_encoder != encoder.identity:
        _log.warning(
            "%s was trained with the text encoder %s, not %s: its presets are not offered, velocities keep the prompts "
            "of their sessions, and prompts far from its training are not warned of",
            model_id,
            domain.text_encoder,
            encoder.identity,
        )
        return _bare(abilities)
    texts = [preset.text for preset in abilities.presets] + [gait.text for gait in abilities.gaits]
    try:
        vectors = encoder.encode(texts) if texts else np.zeros((0, 0), np.float32)
    except ConnectionError as error:
        _log.warning("no presets of %s are offered, and velocities keep the sessions' prompts: %s", model_id, error)
        return replace(_bare(abilities), abilities=abilities)
    num_presets = len(abilities.presets)
    presets = tuple(
        Preset(preset.preset_id, preset.text, vector, preset.description)
        for preset, vector in zip(abilities.presets, vectors[:num_presets], strict=True)
    )
    gaits = tuple(
        Gait(gait.name, gait.text, gait.from_mps, gait.direction, vector)
        for gait, vector in zip(abilities.gaits, vectors[num_presets:], strict=True)
    )
    return Repertoire(presets, gaits, abilities)


def _bare(abilities: Abilities) -> Repertoire:
    return Repertoire((), (), replace(abilities, domain=None))
