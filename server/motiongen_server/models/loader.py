"""Loads what serving a model needs besides its engine: the text encoder, presets, and the store of prompts."""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from motiongen_server.config import ServerConfig
from motiongen_server.engine.types import ModelFacts
from motiongen_server.models.repertoire import Repertoire, encoded
from motiongen_server.rpc.abilities import Abilities
from motiongen_server.settings import SettingError
from motiongen_server.text.ports import Store, TextEncoder
from motiongen_server.text.presets import Preset

if TYPE_CHECKING:
    from motiongen_server.text.encoder.client import RemoteEncoder

_log = logging.getLogger(__name__)

REMOTE_ENCODERS = ("grpc:", "grpcs:")
WITH_TORCH = ("llm2vec",)
"""Encoders that need torch, which the gateway never loads: they run in an engine process."""

LoadText = Callable[[ModelFacts], TextEncoder]
"""Loads the text encoder for a model. Raises SettingError if there is none or it does not fit."""


def load_encoder(
    config: ServerConfig, facts: ModelFacts, with_torch: Callable[[int, float], TextEncoder] | None = None
) -> TextEncoder:
    """The configured text encoder. Raises SettingError if there is none or it does not fit the model.

    with_torch: makes one that needs torch, given the width of its vectors and the time limit of a call in seconds.
    """
    from motiongen_ardy.text import check_width, load_text_encoder

    name, width = config.text_encoder, facts.embedding_dim
    timeout_s = 2 * config.prompt_timeout_s  # longer than any event waits: the result is cached for the next one
    try:
        if name.startswith(REMOTE_ENCODERS):
            remote = _remote_encoder(config, timeout_s)
            check_width(name, remote.width, width)
            return remote
        if name in WITH_TORCH and with_torch is not None:
            return with_torch(width, timeout_s)
        return load_text_encoder(name, width, config.text_device, config.text_precision, timeout_s)
    except SettingError:
        raise
    except (ValueError, RuntimeError, OSError) as error:
        raise SettingError(f"cannot serve {facts.model_id} with text encoder {name!r}: {error}") from error


def _remote_encoder(config: ServerConfig, timeout_s: float) -> RemoteEncoder:
    """The encoder at an address. If it does not answer, its identity and width are taken from the prompt store."""
    from motiongen_ardy.text import TextEncoderUnavailable
    from motiongen_ardy.text.store import known_encoder
    from motiongen_server.text.encoder.access import encoder_credentials, encoder_token
    from motiongen_server.text.encoder.client import RemoteEncoder

    kind, _, address = config.text_encoder.partition(":")
    credentials = encoder_credentials(config) if kind == "grpcs" else None
    token = encoder_token(config, address, credentials is not None)
    try:
        return RemoteEncoder(address, timeout_s, None, credentials, token)
    except TextEncoderUnavailable as error:
        known = known_encoder(Path(config.prompt_store), config.text_encoder) if config.prompt_store else None
        if known is None:
            raise
        _log.warning("%s; until it does, only prompts stored in %s are served", error, config.prompt_store)
        return RemoteEncoder(address, timeout_s, known, credentials, token)


def load_presets(config: ServerConfig, text_encoder: str, facts: ModelFacts) -> tuple[Preset, ...]:
    """The configured presets. Raises SettingError if they cannot be read, or are from another encoder."""
    if not config.presets:
        return ()
    from motiongen_ardy.text.prompt_file import PromptFileError, read_prompt_file

    try:
        prompts = read_prompt_file(Path(config.presets))
    except PromptFileError as error:
        raise SettingError(f"cannot use presets: {error}") from error
    if prompts.text_encoder != text_encoder or prompts.vectors.shape[1] != facts.embedding_dim:
        raise SettingError(
            f"the presets of {config.presets} are {prompts.vectors.shape[1]} numbers each, from the text encoder "
            f"{prompts.text_encoder!r}; {facts.model_id} takes {facts.embedding_dim}, here from {text_encoder!r}"
        )
    return tuple(map(Preset, prompts.ids, prompts.texts, prompts.vectors))


def load_repertoire(config: ServerConfig, encoder: TextEncoder, facts: ModelFacts, abilities: Abilities) -> Repertoire:
    """The prompts of the checkpoint and the configured presets, which replace those with the same id.

    Raises SettingError as `load_presets` does.
    """
    own = load_presets(config, encoder.identity, facts)
    repertoire = encoded(abilities, encoder, facts.model_id)
    named = {preset.preset_id: preset for preset in (*repertoire.presets, *own)}
    return replace(repertoire, presets=tuple(named.values()))


def open_store(config: ServerConfig, text_encoder: str, facts: ModelFacts) -> Store | None:
    """The store in which embeddings outlive the process; None if none is configured."""
    if not config.prompt_store:
        return None
    from motiongen_ardy.text.store import VectorStore

    store = VectorStore(Path(config.prompt_store), text_encoder, facts.embedding_dim, config.prompt_store_size)
    store.note_encoder(config.text_encoder)
    return store
