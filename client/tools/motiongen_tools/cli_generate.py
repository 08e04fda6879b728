"""`motiongen generate`: generate clips in one call, and write them to files in any format."""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import json
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from motiongen_client.errors import InvalidInput, MotiongenError
from motiongen_client.motion import Motion, Rig
from motiongen_client.types import (
    Clip,
    Constraint,
    Deviation,
    Flexible,
    Keyframe,
    Model,
    RootPath,
    RootTrajectory,
    SessionOptions,
)
from motiongen_tools.ardy_npz import read_ardy_npz, write_ardy_npz
from motiongen_tools.arguments import MOST_SEED, add_start_timeout, check_file_to_read, whole_number
from motiongen_tools.bvh import write_bvh
from motiongen_tools.cli_stream import parse_seconds, parse_waypoint
from motiongen_tools.connection import client_of
from motiongen_tools.console import make_console, make_table, starting
from motiongen_tools.constraint_file import read_constraints
from motiongen_tools.conversion import convert_file, convert_to_npz
from motiongen_tools.out_files import check_out, is_without_clock, out_path, sample_paths
from motiongen_tools.server_process import ServerProcess
from motiongen_tools.whole_file import whole_file


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of the command, except prompts and those that choose the server."""
    parser.add_argument("--seconds", type=_positive, default=6.0, help="how long (default: %(default)s)")
    parser.add_argument(
        "--samples", type=whole_number(1), default=1, metavar="N", help="how many (default: %(default)s)"
    )
    parser.add_argument(
        "--out",
        type=out_path,
        action="append",
        metavar="FILE",
        help="repeat for more: .npz, .bvh; .glb, and for a G1 .csv and .controller.csv, by the converter of "
        "motiongen-ardy; .json says how near the constraints were met (default: motion.npz)",
    )
    parser.add_argument("--constraints", type=Path, metavar="FILE", help="JSON constraint list, as ARDY's tools write")
    parser.add_argument(
        "--waypoint", action="append", default=[], type=parse_waypoint, metavar="X,Z@SECONDS",
        help="be at world x, z (metres) at a time; again for more. X,Z,HEADING@SECONDS gives the heading too (radians)",
    )  # fmt: skip
    parser.add_argument(
        "--history", type=Path, metavar="FILE", help="motion that the clip continues: NPZ, BVH, or CSV of a G1"
    )
    parser.add_argument("--history-hz", type=_positive, metavar="N", help="rows a second of a CSV (default: the rig's)")
    parser.add_argument(
        "--history-frames", type=whole_number(1), metavar="N", help="frames of history that a window sees"
    )
    parser.add_argument(
        "--seed", type=whole_number(0, MOST_SEED), help="seed of the first sample; each next has one more"
    )
    parser.add_argument("--steps", type=whole_number(1), metavar="N", help="denoising steps (default: the server's)")
    parser.add_argument("--text-guidance", type=float, metavar="W", help="weight of prompts (default: the server's)")
    parser.add_argument("--constraint-guidance", type=float, metavar="W", help="weight of constraints (the server's)")
    parser.add_argument("--keep-prompts", action="store_true", help="keep prompts even against constraints")
    parser.add_argument("--rate-hz", type=_positive, metavar="N", help="rows a second of .controller.csv")
    parser.add_argument("--timeout", type=_positive, metavar="SECONDS", help="give up after this time")
    parser.add_argument("--model", default="", metavar="NAME", help="model of the catalogue (default: its first)")
    add_start_timeout(parser)


async def generate(options: argparse.Namespace) -> int:
    """Generate the clips, write the files, print a summary."""
    console = make_console()
    outs = options.out or [Path("motion.npz")]
    for out in outs:
        check_out(out, options.samples)
    for option, path in (("--constraints", options.constraints), ("--history", options.history)):
        if path is not None:
            check_file_to_read(option, path)
    with contextlib.ExitStack() as stack:
        address = options.server
        if options.start_server:
            with starting(console, "starting a server") as tell:
                server = ServerProcess(options.server_arguments, ready_timeout_s=options.start_timeout, tell=tell)
                address = stack.enter_context(server).address
        async with client_of(options, address) as client:
            catalog = client.catalog
            model = catalog.model(options.model) if options.model else catalog.models[0]
            rig = catalog.rig(model.rig_id)
            num_frames = max(1, rig.frames_in(options.seconds))
            longest_s = catalog.limits.max_clip_frames / rig.frame_rate_hz
            if options.seconds > longest_s:
                raise InvalidInput("--seconds", options.seconds, f"at most {longest_s:g}")
            constraints: list[Constraint] = [waypoint.in_frames(rig, num_frames) for waypoint in options.waypoint]
            if options.constraints is not None:
                longest = catalog.limits.max_trajectory_frames
                constraints += read_constraints(options.constraints, rig, num_frames, longest)
            prompts = options.script.in_frames(rig, num_frames)
            opening = await asyncio.to_thread(session_options, options, model, rig)
            begun_s = time.monotonic()
            clips = await client.generate_clip(
                num_frames=num_frames,
                num_samples=options.samples,
                later_prompts=prompts,
                options=opening,
                constraints=constraints,
                timeout_s=options.timeout,
            )
            took_s = time.monotonic() - begun_s
    text = "; then ".join(prompts[frame] for frame in sorted(prompts))
    failures: list[Exception] = []
    for out in outs:
        try:
            for path, lines in write_clips(out, clips, constraints, text, options.rate_hz):
                console.print("; ".join([f"wrote {path}", *lines]), soft_wrap=True)
        except (MotiongenError, OSError) as failure:  # still write the other files
            failures.append(failure)
    samples = f"{options.samples} samples" if options.samples > 1 else "1 sample"
    console.print(
        f"{samples} of {num_frames / rig.frame_rate_hz:g} s in {took_s:.2f} s, seed {clips[0].seed}, "
        f"{clips[0].denoise_steps} denoising steps",
        soft_wrap=True,
    )
    if constraints:
        console.print(residual_table(clips, constraints))
    console.print(f"The weights of {model.model_id} are licensed {model.licence}.", soft_wrap=True)
    for one in failures:
        print(f"error: {one}", file=sys.stderr)
    return 1 if failures else 0


def session_options(options: argparse.Namespace, model: Model, rig: Rig) -> SessionOptions:
    """The session options that the samples are generated with. Raises InvalidInput, ConversionFailed."""
    prior = None
    if options.history is not None:
        prior = read_prior(options.history, rig, options.history_hz)
        longest = model.max_history_frames if options.history_frames is None else options.history_frames
        length = min(len(prior), longest) // model.patch_frames * model.patch_frames
        if not length:
            raise InvalidInput("--history", f"{len(prior)} frames", f"{model.patch_frames} frames or more")
        prior = Motion(rig, 0, prior.rows[-length:])
    return SessionOptions(
        model_id=model.model_id,
        seed=options.seed,
        denoise_steps=options.steps,
        text_guidance=options.text_guidance,
        constraint_guidance=options.constraint_guidance,
        history_frames=options.history_frames,
        prior=prior,
        keep_prompts=options.keep_prompts,
    )


def read_prior(path: Path, rig: Rig, rate_hz: float | None) -> Motion:
    """Motion of the rig from a file of any format, by the converter. Raises ConversionFailed, InvalidInput."""
    with tempfile.TemporaryDirectory() as folder:
        converted = Path(folder) / "history.npz"
        rate = ("--fps", str(rate_hz or rig.frame_rate_hz)) if is_without_clock(path) else ()
        convert_to_npz(path, converted, *rate)
        try:
            return read_ardy_npz(converted, rig)
        except InvalidInput as error:  # it names the converted file, which is temporary
            raise InvalidInput("--history", f"{path}, {error.given}", error.allowed) from None


def write_clips(
    out: Path, clips: Sequence[Clip], constraints: Sequence[Constraint], text: str, rate_hz: float | None
) -> Iterator[tuple[Path, list[str]]]:
    """Write every sample; yields each file once it is written, with what its format could not keep."""
    if out.name.endswith(".json"):
        out.parent.mkdir(parents=True, exist_ok=True)
        report = [clip_report(clip, constraints) for clip in clips]
        with whole_file(out) as part:
            part.write_text(json.dumps({"prompt": text, "samples": report}, indent=2) + "\n", encoding="utf-8")
        yield out, []
        return
    for path, clip in zip(sample_paths(out, len(clips)), clips, strict=True):
        path.parent.mkdir(parents=True, exist_ok=True)
        yield path, write_motion(path, clip.motion, text, rate_hz)


def write_motion(path: Path, motion: Motion, text: str, rate_hz: float | None) -> list[str]:
    """Write a motion in the format of the path's suffix; returns what the format could not keep."""
    if path.suffix == ".npz":
        write_ardy_npz(path, motion, text)
    elif path.suffix == ".bvh":
        write_bvh(path, motion)
    else:
        with tempfile.TemporaryDirectory() as folder:
            source = Path(folder) / "motion.npz"
            write_ardy_npz(source, motion, text)  # the client's own NPZ form cannot hold the prompt
            is_controller = path.name.endswith(".controller.csv") and rate_hz is not None
            rate = ("--rate-hz", str(rate_hz)) if is_controller else ()
            return convert_file(source, path, *rate, source_name="the motion")
    return []


def clip_report(clip: Clip, constraints: Sequence[Constraint]) -> dict[str, Any]:
    """One sample as JSON."""
    residuals = [
        {
            "constraint": describe(constraint),
            "frames": residual.num_frames,
            "position_m": _numbers(residual.position_m),
            "heading_rad": _numbers(residual.heading_rad),
            "rotation_rad": _numbers(residual.rotation_rad),
            "met": residual.met,
        }
        for constraint, residual in zip(constraints, clip.residuals, strict=True)
    ]
    return {
        "model": clip.model_id,
        "seed": clip.seed,
        "denoise_steps": clip.denoise_steps,
        "frames": len(clip.motion),
        "frame_rate_hz": clip.motion.rig.frame_rate_hz,
        "warnings": [{"reason": one.reason, "message": one.message} for one in clip.warnings],
        "residuals": residuals,
    }


def _numbers(deviation: Deviation | None) -> dict[str, float] | None:
    return None if deviation is None else {"mean": deviation.mean, "worst": deviation.worst}


def residual_table(clips: Sequence[Clip], constraints: Sequence[Constraint]) -> Any:
    """How near the worst sample came to each constraint, and how many samples met it."""
    table = make_table("", "constraint, worst of all samples", "position", "heading", "rotation", "met")
    for index, constraint in enumerate(constraints):
        residuals = [clip.residuals[index] for clip in clips]
        metres = _worst([one.position_m for one in residuals])
        angles = [_worst([getattr(one, kind) for one in residuals]) for kind in ("heading_rad", "rotation_rad")]
        told = ["-" if metres is None else f"{100 * metres:.1f} cm"]
        told += ["-" if angle is None else f"{angle:.3f} rad" for angle in angles]
        told.append(f"{sum(one.met for one in residuals)} of {len(residuals)}")
        table.add_row(describe(constraint), *told)
    return table


def _worst(deviations: Sequence[Deviation | None]) -> float | None:
    return max((one.worst for one in deviations if one is not None), default=None)


def describe(constraint: Constraint) -> str:
    """A short description of a constraint."""
    if isinstance(constraint, Flexible):
        constraint = constraint.target
    if isinstance(constraint, RootPath):
        return f"path through {len(constraint.corners_m)} corners"
    if isinstance(constraint, RootTrajectory):
        last = constraint.first_frame + len(constraint.positions_m) - 1
        what = "waypoint" if last == constraint.first_frame else "path"
        return f"{what} at frame {constraint.first_frame}" + (f" to {last}" if what == "path" else "")
    what = "keyframe" if isinstance(constraint, Keyframe) else type(constraint).__name__.lower()
    return f"{'joints' if what == 'jointtargets' else what} at frame {constraint.frame}"


def _positive(text: str) -> float:
    seconds = parse_seconds(text)
    if seconds == 0:
        raise argparse.ArgumentTypeError(f"{text!r} was given; allowed is a number above 0")
    return seconds
