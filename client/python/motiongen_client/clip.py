"""Clips: motion of a fixed length in one call, several samples at once, as fast as the server generates it."""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import grpc
import grpc.aio
import numpy as np

from motiongen.v1 import service_pb2
from motiongen.v1.service_pb2_grpc import MotionServiceStub
from motiongen_client import convert
from motiongen_client.catalogs import model_of
from motiongen_client.errors import DeadlineExceeded, InvalidInput, ProtocolViolation
from motiongen_client.motion import Float32, Motion, Rig
from motiongen_client.prompts import Prompt
from motiongen_client.status import MOST_TIMEOUT_S, answer_of, error_of
from motiongen_client.types import (
    Catalog,
    Clip,
    Constraint,
    Opened,
    Priority,
    Residual,
    SessionOptions,
    as_tuple,
    check_frame,
    check_number,
    check_type,
    check_whole,
)

_log = logging.getLogger(__name__)


@dataclass(eq=False)
class _Sample:
    """What has arrived of one sample. num_constraints: of the request."""

    num_constraints: int
    rows: list[Float32] = field(default_factory=list)
    num_frames: int = 0
    opened: Opened | None = None
    residuals: tuple[Residual, ...] | None = None

    def take(self, response: service_pb2.GenerateClipResponse, reader: convert.FrameReader, num_frames: int) -> None:
        """num_frames: as requested. Raises ProtocolViolation for a part out of order, and for excess frames."""
        if self.residuals is not None:
            raise ProtocolViolation("a part of a clip came after its summary")
        match response.WhichOneof("part"):
            case "opened":
                if self.opened is not None:
                    raise ProtocolViolation("a clip was opened twice")
                self.opened = convert.opened(response.opened)
                convert.check_outputs(self.opened.outputs, list(reader.rig.outputs), reader.rig.with_outputs({}))
                if self.opened.outputs != reader.rig.outputs:
                    raise ProtocolViolation(
                        f"a clip has the outputs {self.opened.outputs}, its model {reader.rig.outputs}"
                    )
            case "chunk":
                if self.opened is None:
                    raise ProtocolViolation("a chunk of a clip came before it was opened")
                if response.chunk.first_frame != self.num_frames:
                    given = f"frame {response.chunk.first_frame} of a clip came after {self.num_frames} frames"
                    raise ProtocolViolation(given)
                if response.chunk.frame_count > num_frames - self.num_frames:
                    given = f"{response.chunk.frame_count} frames of a clip came after {self.num_frames}"
                    raise ProtocolViolation(f"{given}; {num_frames} were asked for")
                self.rows.append(reader.rows(response.chunk, self.rows[-1][-1] if self.rows else None))
                self.num_frames += len(self.rows[-1])
            case "summary":
                came = response.summary.residuals
                if len(came) != self.num_constraints:
                    raise ProtocolViolation(f"{len(came)} residuals came for {self.num_constraints} constraints")
                self.residuals = tuple(convert.residual(one) for one in came)

    def clip(self, rig: Rig, num_frames: int) -> Clip:
        """The complete sample, once the call has ended. Raises ProtocolViolation if a part is missing."""
        if self.opened is None or self.residuals is None or self.num_frames != num_frames:
            raise ProtocolViolation(f"a clip of {num_frames} frames ended after {self.num_frames}")
        motion = Motion(rig, 0, np.concatenate(self.rows))
        opened = self.opened
        return Clip(opened.model_id, opened.seed, opened.denoise_steps, motion, self.residuals, opened.warnings)


async def generate_clip(
    stub: MotionServiceStub,
    address: str,
    catalog: Catalog,
    prompt: Prompt | None,
    *,
    num_frames: int,
    num_samples: int,
    later_prompts: Mapping[int, Prompt],
    options: SessionOptions,
    constraints: Sequence[Constraint],
    timeout_s: float | None,
) -> list[Clip]:
    """See `MotionClient.generate_clip`. Raises UnknownName for a model that the catalogue lacks."""
    model = model_of(catalog, options)
    options = replace(options, model_id=model.model_id)  # name the default: the rig is looked up by it
    asked = {name: model.outputs[name] for name in options.outputs if name in model.outputs}
    rig = catalog.rig(model.rig_id).with_outputs(asked)  # the server refuses unknown ones
    check_type("later_prompts", later_prompts, Mapping, "a mapping of frames to prompts, such as {40: 'a text'}")
    constraints = as_tuple("constraints", constraints, "several constraints, such as [Waypoint(...)]")
    if timeout_s is not None:
        check_number("timeout_s", timeout_s, "seconds, or None", lambda s: s == s)  # any but NaN
    for frame in later_prompts:
        check_frame("later_prompts", frame)
    check_request(catalog, num_frames, num_samples, options)
    timeline = dict(later_prompts) if prompt is None else {0: prompt, **later_prompts}
    spans = [convert.prompt_span(number, timeline[frame], frame) for number, frame in enumerate(sorted(timeline), 1)]
    targets = [convert.constraint(number, target) for number, target in enumerate(constraints, 1)]
    request = convert.generate_clip(convert.open_session(options, spans, targets), num_frames, num_samples)
    samples, reader = (
        [_Sample(len(constraints)) for _ in range(num_samples)],
        convert.FrameReader(rig, options.frame_format),
    )
    call = stub.GenerateClip(request, timeout=None if timeout_s is None else min(timeout_s, MOST_TIMEOUT_S))
    try:
        while isinstance(response := await answer_of(call.read()), service_pb2.GenerateClipResponse):
            if response.sample >= num_samples:
                raise ProtocolViolation(f"sample {response.sample} came; samples asked for: {num_samples}")
            samples[response.sample].take(response, reader, num_frames)
    except grpc.aio.AioRpcError as failure:
        if failure.code() is grpc.StatusCode.DEADLINE_EXCEEDED:
            raise DeadlineExceeded("the clip", timeout_s) from None
        raise error_of(failure, "the clip", address) from None
    finally:
        call.cancel()  # a server that broke a rule would go on sending; no effect if the call has ended
    clips = [sample.clip(rig, num_frames) for sample in samples]
    for warning in clips[0].warnings:  # the other samples have the same
        _log.warning("%s", warning.message)
    return clips


def check_request(catalog: Catalog, num_frames: int, num_samples: int, options: SessionOptions) -> None:
    """Raise InvalidInput for a request that the server would refuse anyway."""
    limits = catalog.limits
    most_frames, most_samples = limits.max_clip_frames, limits.max_clip_samples
    check_whole("num_frames", num_frames, f"1 to {most_frames} frames", least=1, most=most_frames)
    check_whole("num_samples", num_samples, f"1 to {most_samples} samples", least=1, most=most_samples)
    if options.priority is not Priority.NEAR or options.lookahead_frames is not None:
        raise InvalidInput("options", options, "a clip without priority and lookahead_frames, which sessions have")
