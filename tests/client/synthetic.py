"""The fake server's data: a rig of nine joints, a catalogue, and frames that show which plan they are from.

The root's x is the number of the plan; its z moves 5 cm per frame. The left arm swings.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from motiongen.v1 import motion_pb2, service_pb2, session_pb2

JOINTS = ("Hips", "Spine", "Head", "LeftArm", "LeftHand", "RightArm", "RightHand", "LeftFoot", "RightFoot")
PARENTS = (-1, 0, 1, 1, 3, 1, 5, 0, 0)
OFFSETS = (
    (0, 0, 0), (0, 0.3, 0), (0, 0.3, 0), (0.2, 0.2, 0), (0.5, 0, 0),
    (-0.2, 0.2, 0), (-0.5, 0, 0), (0.1, -0.9, 0), (-0.1, -0.9, 0),
)  # fmt: skip
ROW_WIDTH = 3 + 4 * len(JOINTS) + 4
HORIZON = 40
LOOKAHEAD = 80  # longer than the playback between two reports


def rig(frame_rate: int) -> motion_pb2.Rig:
    widths = {"root_translation_m": 3, "joint_rotation_quat_wxyz": 4 * len(JOINTS), "foot_contact": 4}
    return motion_pb2.Rig(
        rig_id="stick9",
        joints=JOINTS,
        parents=PARENTS,
        frame_rate=frame_rate,
        blocks=[motion_pb2.ChannelBlock(name=name, width=width) for name, width in widths.items()],
        neutral_offsets_m=np.array(OFFSETS, np.float32).ravel().tolist(),
    )


def catalog(frame_rate: int) -> service_pb2.GetCatalogResponse:
    return service_pb2.GetCatalogResponse(
        catalog_etag="1",
        rigs=[rig(frame_rate)],
        limits=service_pb2.Limits(
            max_sessions_per_stream=64,
            max_constraints=16,
            max_prompts=4,
            max_prompt_characters=100,
            max_request_bytes=4096,
            default_lookahead_frames=LOOKAHEAD,
            max_lookahead_frames=2 * LOOKAHEAD,
            max_trajectory_frames=100,
        ),
        models=[
            service_pb2.Model(
                model_id="synthetic",
                rig_id="stick9",
                licence="CC0-1.0",
                horizon_frames=HORIZON,
                patch_frames=4,
                default_denoise_steps=4,
                min_denoise_steps=1,
                max_denoise_steps=10,
                default_guidance=session_pb2.Guidance(text=2.5, constraint=1.5),
                default_history_frames=4,
                text_encoder="none",
                num_parameters=2_500_000,
            )
        ],
    )


def synthetic_rows(plan: int, first_frame: int, num_frames: int) -> NDArray[np.float32]:
    """(T, ROW_WIDTH) float32."""
    frames = np.arange(first_frame, first_frame + num_frames)
    rows = np.zeros((num_frames, ROW_WIDTH), np.float32)
    rows[:, 0], rows[:, 1], rows[:, 2] = plan, 0.9, 0.05 * frames
    rotations = rows[:, 3:-4].reshape(num_frames, len(JOINTS), 4)
    rotations[:, :, 0] = 1
    swing = 0.5 * np.sin(frames / 5)
    rotations[:, 3, 0], rotations[:, 3, 3] = np.cos(swing), np.sin(swing)
    return rows
