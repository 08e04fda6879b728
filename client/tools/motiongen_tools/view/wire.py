"""Messages to a browser: catalogues and rigs as JSON, frames as binary messages.

A binary message consists of the length of its header (uint32, little endian), the header (JSON, padded with spaces to a
multiple of four bytes), and rows of float32, little endian, in the order and number that the header gives.
"""

from __future__ import annotations

import json
import math
import struct
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from motiongen_client.motion import Float32, Motion, Rig
from motiongen_client.types import Catalog, Model


@dataclass(frozen=True, eq=False)
class Head:
    """Where one character is, and the frames of it that a browser lacks.

    playhead: including the fraction of the way to the next frame. pace: frames a second at which it moves at present.
    committed_to, buffered_to: the first frame that may change, the first that is missing. first_frame: of `rows`.
    """

    character: int
    playhead: float
    pace: float
    committed_to: int
    buffered_to: int
    first_frame: int
    rows: Sequence[Float32]


def pack_frames(heads: Sequence[Head]) -> bytes:
    """One binary message for all characters with news. widths: numbers in a row of each, 0 if it has no rows."""
    listed = [
        [h.character, round(h.playhead, 3), round(h.pace, 3), h.committed_to, h.buffered_to, h.first_frame, len(h.rows)]
        for h in heads
    ]
    widths = [len(h.rows[0]) if h.rows else 0 for h in heads]
    return _pack({"type": "frames", "heads": listed, "widths": widths}, [row for h in heads for row in h.rows])


def pack_motion(name: str, motion: Motion) -> bytes:
    """A whole motion that was read from a file, with its rig."""
    header = {"type": "motion", "name": name, "rig": rig_json(motion.rig), "num_frames": len(motion)}
    return _pack(header, [motion.rows])


def pack_history(character: int, first_frame: int, rows: Sequence[Float32]) -> bytes:
    """Frames that were shown before."""
    header = {"type": "history", "character": character, "first_frame": first_frame, "num_frames": len(rows)}
    return _pack(header, rows)


def to_json(message: Any) -> str:
    """A message as JSON. JSON only has finite numbers: others, which a server may send, become null."""
    try:
        return json.dumps(message, separators=(",", ":"), allow_nan=False)
    except ValueError:
        return json.dumps(_finite(message), separators=(",", ":"), allow_nan=False)


def _finite(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _finite(each) for key, each in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(each) for each in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _pack(header: dict[str, Any], rows: Sequence[Float32]) -> bytes:
    text = to_json(header).encode()
    text += b" " * (-len(text) % 4)
    return b"".join([struct.pack("<I", len(text)), text, *(row.astype("<f4", copy=False).tobytes() for row in rows)])


def rig_json(rig: Rig) -> dict[str, Any]:
    """What a browser needs to pose and draw a skeleton. columns: first column and width of each block of a row."""
    return {
        "id": rig.rig_id,
        "joints": list(rig.joint_names),
        "parents": list(rig.parents),
        "offsets_m": np.asarray(rig.offsets_m).round(6).tolist(),
        "frame_rate_hz": rig.frame_rate_hz,
        "row_width": rig.row_width,
        "columns": {name: [columns.start, columns.stop] for name, columns in rig.block_columns.items()},
        "limbs": {name: list(joints) for name, joints in rig.limbs.items()},
        "hip_joints": None if rig.hip_joints is None else list(rig.hip_joints),
    }


def catalog_json(catalog: Catalog) -> dict[str, Any]:
    """What the server offers, as far as the page shows it."""
    return {
        "rigs": [rig_json(rig) for rig in catalog.rigs],
        "models": [model_json(model) for model in catalog.models],
        "limits": asdict(catalog.limits),
    }


def model_json(model: Model) -> dict[str, Any]:
    return {
        "id": model.model_id,
        "rig": model.rig_id,
        "licence": model.licence,
        "presets": [
            {"id": key, "text": text, "expect": model.preset_descriptions.get(key, "")}
            for key, text in model.presets.items()
        ],
        "steps": [model.min_denoise_steps, model.default_denoise_steps, model.max_denoise_steps],
        "constraint_forms": dict(model.constraint_forms),
        "known_motions": list(model.known_motions),
        "tolerance_m": model.default_tolerance_m,
        "tolerance_rad": model.default_tolerance_rad,
    }
