"""TorchRunner: runs jobs on one model and one device, a step at a time, however much their rows differ."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager, nullcontext

import torch

from motiongen_ardy.model.fingerprint import fingerprint
from motiongen_ardy.model.model import Model
from motiongen_ardy.model.packed import PackedDenoiser
from motiongen_ardy.model.packed.codec import packed_codec
from motiongen_ardy.model.packed.graph_cache import GraphCache
from motiongen_server.engine.types import Float32Array, ModelFacts, RowStatus, WindowJob, WindowResult
from motiongen_server.runner.decoding import Decoding
from motiongen_server.runner.device_errors import device_errors
from motiongen_server.runner.facts import model_facts
from motiongen_server.runner.frames import features_of_rows
from motiongen_server.runner.outputs import outputs_of_rows
from motiongen_server.runner.preparation import Preparation
from motiongen_server.runner.row import Row
from motiongen_server.runner.stepping import Stepping


class TorchRunner:
    """Runs one model; a `motiongen_server.engine.ports.Runner`. weights: the model's fingerprint."""

    def __init__(
        self,
        model: Model,
        model_id: str,
        default_steps: int = 4,
        precision: torch.dtype = torch.float32,
        owns_model: bool = False,
        graphs: GraphCache | None = None,
    ) -> None:
        """precision: of the denoiser's layers, float32 or bfloat16; everything else is float32.

        owns_model: nobody else needs the model, so weights that are packed need not be kept in their original form too.
        graphs: the cache from which work is replayed; None: kernels are called each time.
        """
        config = model.config
        self._model = model
        self._device = model.representation.stats.mean.device
        options = model.sampling
        self._graphs = graphs
        self.weights = fingerprint(model)  # before any weights are released
        self._denoiser = PackedDenoiser(
            model.denoiser,
            config.num_base_steps,
            config.horizon,
            precision,
            graphs,
            keeps_roots=options.project_root and options.projection.led_steps < config.num_base_steps,
        )
        if owns_model:
            self._denoiser.release_originals()
        self._codec = packed_codec(model.codec)
        self._preparation = Preparation(model, self._codec, self._denoiser, graphs)
        self._decoding = Decoding(model, self._codec, graphs)
        self._stepping = Stepping(model, self._denoiser, graphs)
        self._rows: dict[int, Row] = {}
        self._facts = model_facts(model, model_id, default_steps)

    @property
    def facts(self) -> ModelFacts:
        return self._facts

    def row(self, job_id: int) -> Row:
        """A prepared job in its current state. Raises KeyError."""
        return self._rows[job_id]

    def num_passes(self, job: WindowJob) -> int:
        """Evaluations of the denoiser that one step of this job costs."""
        return len(self._preparation.passes(job))

    @contextmanager
    def recording_at_once(self) -> Iterator[None]:
        """Inside, graphs of all work are recorded and kept; outside, only of work that is frequent."""
        with nullcontext() if self._graphs is None else self._graphs.at_once():
            yield

    def _let_go(self) -> None:
        """Free graphs, which can be made again, as there is no memory for rows."""
        if self._graphs is not None:
            self._graphs.clear()

    @torch.inference_mode()
    def features(self, rows: Float32Array) -> Float32Array:
        """Normalised features (H, D) of wire rows (H, row width). Raises OutOfMemory or DeviceLost."""
        with device_errors(self._let_go):
            features = features_of_rows(self._model.representation, torch.from_numpy(rows).to(self._device)[None])
            return features[0].cpu().numpy()

    @torch.inference_mode()
    def outputs(self, names: Sequence[str], rows: Float32Array) -> Float32Array:
        """(T - 1, W) for rows (T, row_width), of which the first precedes the others; see `runner.outputs`."""
        return outputs_of_rows(self._model.skeleton, self._facts.fps, names, rows)

    @torch.inference_mode()
    def prepare(self, jobs: Sequence[WindowJob]) -> None:
        """Take in new jobs. Raises OutOfMemory or DeviceLost."""
        with device_errors(self._let_go):
            rows = self._preparation.rows(jobs)
        self._rows.update((row.job.job_id, row) for row in rows)

    @torch.inference_mode()
    def denoise(self, job_ids: Sequence[int]) -> list[RowStatus]:
        """Advance each job by one denoising step. Raises OutOfMemory or DeviceLost."""
        rows = {job_id: self._rows[job_id] for job_id in sorted(job_ids)}
        with device_errors(self._let_go):
            finite = self._stepping(rows)
        statuses = {
            job_id: RowStatus(job_id, row.steps_done, is_finite)
            for (job_id, row), is_finite in zip(rows.items(), finite, strict=True)
        }
        return [statuses[job_id] for job_id in job_ids]

    @torch.inference_mode()
    def decode(self, job_ids: Sequence[int]) -> list[WindowResult]:
        """Frames, features and tokens of finished jobs, which are forgotten. Raises OutOfMemory or DeviceLost."""
        rows = [self._rows[job_id] for job_id in job_ids]
        with device_errors(self._let_go):
            decoded = self._decoding(rows)
        self.discard(job_ids)
        return [
            WindowResult(row.job.job_id, one.frames[: row.num_frames], one.features[: row.num_frames], one.tokens)
            for row, one in zip(rows, decoded, strict=True)
        ]

    def discard(self, job_ids: Sequence[int]) -> None:
        """Forget jobs at any stage."""
        for job_id in job_ids:
            self._rows.pop(job_id, None)
        if not self._rows:
            self._stepping.forget()
