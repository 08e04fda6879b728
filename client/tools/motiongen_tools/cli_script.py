"""Prompts with times on the command line, and checks that options fit together."""

from __future__ import annotations

import argparse
from dataclasses import dataclass, field
from typing import Any

from motiongen_client.errors import InvalidInput
from motiongen_client.motion import Rig
from motiongen_tools.cli_stream import parse_seconds
from motiongen_tools.out_files import is_without_clock


@dataclass
class Script:
    """Prompts with their start times in seconds, in the order given, and an `--at` that still waits for its prompt."""

    prompts: list[tuple[float, str]] = field(default_factory=list)
    waiting_at_s: float | None = None

    def in_frames(self, rig: Rig, num_frames: int) -> dict[int, str]:
        """The prompts by frame, for num_frames frames. A time just before the end counts as the last frame.

        Raises InvalidInput if two have the same frame, because one of them would have no effect.
        """
        prompts: dict[int, str] = {}
        for at_s, text in self.prompts:
            frame = min(rig.frames_in(at_s), num_frames - 1)
            if frame in prompts:
                frame_s = 1 / rig.frame_rate_hz
                allowed = f"a time of another frame than the prompt before it: a frame is {frame_s:g} s long"
                raise InvalidInput("--at", f"{at_s:g} s", allowed)
            prompts[frame] = text
        return prompts


class PromptAction(argparse.Action):
    """`--prompt TEXT`: a prompt from the time of the preceding `--at` on."""

    def __call__(self, parser: argparse.ArgumentParser, namespace: argparse.Namespace, values: Any, *_: Any) -> None:
        script: Script = namespace.script
        if script.waiting_at_s is None and script.prompts:
            parser.error(f"--prompt {values!r}: a second prompt needs --at SECONDS before it")
        at_s = script.waiting_at_s or 0.0
        if script.prompts and at_s <= script.prompts[-1][0]:
            parser.error(f"--at {at_s:g}: times must rise; the prompt before it is at {script.prompts[-1][0]:g} s")
        namespace.script = Script([*script.prompts, (at_s, values)])


class AtAction(argparse.Action):
    """`--at SECONDS`: the time of the `--prompt` that follows."""

    def __call__(self, parser: argparse.ArgumentParser, namespace: argparse.Namespace, values: Any, *_: Any) -> None:
        script: Script = namespace.script
        if script.waiting_at_s is not None:
            parser.error(f"--at {script.waiting_at_s:g} has no --prompt after it")
        try:
            namespace.script = Script(script.prompts, parse_seconds(values))
        except argparse.ArgumentTypeError as error:
            parser.error(f"argument --at: {error}")


def check_generate(parser: argparse.ArgumentParser, options: argparse.Namespace) -> None:
    """Add PROMPT to the script, and exit with an error if options of `generate` do not fit together."""
    script: Script = options.script
    if options.prompt is not None:
        if script.prompts and script.prompts[0][0] == 0:
            parser.error("PROMPT and a --prompt without --at before it are both for the start; give one")
        options.script = script = Script([(0.0, options.prompt), *script.prompts], script.waiting_at_s)
    if script.waiting_at_s is not None:
        parser.error(f"--at {script.waiting_at_s:g} has no --prompt after it")
    if not script.prompts and not options.waypoint and options.constraints is None and options.history is None:
        parser.error("nothing to do: give a PROMPT, --waypoint, --constraints or --history")
    if options.server_arguments and not options.start_server:
        parser.error(f"{options.server_arguments[0]!r} is for a server that this starts: give --start-server too")
    if options.rate_hz is not None and not any(out.name.endswith(".controller.csv") for out in options.out or ()):
        parser.error("--rate-hz is for .controller.csv: give --out NAME.controller.csv too")
    if options.history_hz is not None and (options.history is None or not is_without_clock(options.history)):
        parser.error("--history-hz is for the CSV of a G1 without a clock: give --history FILE.csv too")
    _check_times(parser, options)


def check_stream(parser: argparse.ArgumentParser, options: argparse.Namespace) -> None:
    """Exit with an error if options of `stream` do not fit together."""
    script: Script = options.script
    if script.waiting_at_s is not None:
        parser.error(f"--at {script.waiting_at_s:g} has no --prompt after it")
    if not script.prompts and not options.waypoint:
        parser.error("nothing to do: give a --prompt, a --waypoint or both")
    _check_times(parser, options)


def _check_times(parser: argparse.ArgumentParser, options: argparse.Namespace) -> None:
    script: Script = options.script
    for name, at_s in [
        *(("--at", at_s) for at_s, _ in script.prompts),
        *(("--waypoint", waypoint.at_s) for waypoint in options.waypoint),
    ]:
        if at_s >= options.seconds:
            parser.error(f"{name}: {at_s:g} s is not before the end, which is at --seconds {options.seconds:g}")
