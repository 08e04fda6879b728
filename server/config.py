"""ServerConfig: a field, a flag, an environment name, a meaning; checked once."""

from __future__ import annotations

import argparse
import os
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from typing import Any

from server.errors import SettingError

ENVIRONMENT_PREFIX = "MOTIONGEN_"
DEFAULT_LOOKAHEAD_FRAMES = 40
PRECISIONS = ("float32", "bfloat16", "auto")
_LINK_NAME = re.compile(r"_SERVICE_HOST$|_SERVICE_PORT(_\w+)?$|_PORT_\d+_(TCP|UDP|SCTP)(_PROTO|_PORT|_ADDR)?$")
_LINK_ADDRESS = re.compile(r"(tcp|udp|sctp)://")
LOG_LEVELS = ("DEBUG", "INFO", "WARNING", "ERROR")


def setting(default: Any, meaning: str, least: float | None = None, most: float | None = None, **more: Any) -> Any:
    """A field of ServerConfig: its default, what it means, and what it may be (a range, or `choices`)."""
    return field(default=default, metadata={"meaning": meaning, "least": least, "most": most, **more})


@dataclass(frozen=True)
class ServerConfig:
    """Every setting of the server. A flag wins over the environment, the environment over the default."""

    host: str = setting("127.0.0.1", "address to serve gRPC on")
    port: int = setting(50051, "port to serve gRPC on; 0 picks a free one", 0, 65535)
    ops_host: str = setting("127.0.0.1", "address of health checks and metrics (HTTP)")
    ops_port: int = setting(9464, "port of health checks and metrics; 0 picks a free one", 0, 65535)
    print_ports: bool = setting(False, "print one JSON line with both ports on standard output once ready")
    model: str = setting("motiongen-mini", "motiongen-mini, core, core8, g1, g18, a folder, or a hub's owner/name")
    text_encoder: str = setting("static", "static (built in), hashed (knows no meaning; for tests), or a folder")
    device: str = setting("cpu", "device the model runs on", choices=("cpu", "cuda"))
    precision: str = setting("float32", "of the model's products; auto = bfloat16 where it is fast", choices=PRECISIONS)
    threads: int = setting(0, "CPU threads of the model; 0 = one for each core", 0, 1024)
    engine_process: bool = setting(False, "run the engine in a process of its own, started anew when it is lost")
    denoise_steps: int = setting(4, "denoising steps of a window when a session does not say", 2, 1000)
    text_guidance: float = setting(1.5, "weight of the prompt when a session does not say", 0, 10)
    constraint_guidance: float = setting(2.5, "weight of constraints when a session does not say", 0, 10)
    history_frames: int = setting(16, "decided frames that a new window starts with; a multiple of 4", 4, 400)
    max_rows: int = setting(32, "most windows in one denoising step", 1, 4096)
    profile_s: float = setting(8.0, "longest time that measuring the model takes at the start", 0, 600)
    admit_load: float = setting(0.9, "share of the measured capacity up to which sessions are let in", 0.01, 1e6)
    degrade: bool = setting(True, "give sessions less, and tell them, where the machine cannot keep up")
    max_sessions: int = setting(256, "open sessions on this server", 1, 100_000)
    max_sessions_per_stream: int = setting(512, "open sessions on one stream", 1, 100_000)
    max_streams: int = setting(2048, "streams open at once", 1, 100_000)
    lookahead_frames: int = setting(0, "frames sent beyond the playhead; 0 = 40, or the horizon if longer", 0, 10_000)
    max_lookahead_frames: int = setting(80, "most that a session may ask for", 1, 10_000)
    max_prompt_characters: int = setting(1000, "length of a prompt", 1, 100_000)
    max_request_bytes: int = setting(1 << 20, "size of one message from a client", 1024, 1 << 30)
    events_per_second: float = setting(50.0, "events of one session a second", 1, 1e6)
    stream_events_per_second: float = setting(5000.0, "events of one stream a second", 1, 1e7)
    flush_ms: float = setting(20.0, "how long updates are gathered into one message", 1, 1000)
    idle_timeout_s: float = setting(300.0, "silence after which a session is closed", 1, 1e6)
    prompt_cache: int = setting(4096, "prompts whose embeddings are remembered", 1, 10_000_000)
    drain_wait_s: float = setting(0.5, "after SIGTERM: not ready for so long, before clients are told", 0, 600)
    drain_grace_s: float = setting(5.0, "after SIGTERM: time clients get to end their sessions", 0, 3600)
    reflection: bool = setting(True, "answer gRPC server reflection")
    log_level: str = setting("INFO", "least severity that is logged", choices=LOG_LEVELS)
    log_format: str = setting("text", "form of log lines on standard error", choices=("text", "json"))

    def __post_init__(self) -> None:
        """Raises SettingError for a value outside its range, or values that contradict each other."""
        for each in fields(self):
            check_setting(each.name, getattr(self, each.name), each.metadata)
        if self.history_frames % 4:
            raise SettingError(f"history_frames is {self.history_frames}; it must be a multiple of 4")
        if self.max_lookahead_frames < self.lookahead_frames:
            raise SettingError(
                f"max_lookahead_frames is {self.max_lookahead_frames}; it must be at least lookahead_frames, "
                f"which is {self.lookahead_frames}"
            )

    def lookahead_for(self, horizon: int) -> int:
        """Frames sent beyond the playhead of a session that does not say, of a model with that horizon."""
        return self.lookahead_frames or max(DEFAULT_LOOKAHEAD_FRAMES, horizon)


def check_setting(name: str, value: Any, metadata: Mapping[str, Any]) -> None:
    """Raise SettingError unless the value is in its range and among its choices."""
    choices, least, most = metadata.get("choices"), metadata["least"], metadata["most"]
    if choices is not None and value not in choices:
        raise SettingError(f"{name} is {value!r}; it must be one of {', '.join(choices)}")
    if least is not None and not least <= value <= most:
        raise SettingError(f"{name} is {value}; it must be from {least:.12g} to {most:.12g}")


def environment_name(name: str) -> str:
    """The environment variable of a setting."""
    return ENVIRONMENT_PREFIX + name.upper()


def is_service_link(name: str, value: str) -> bool:
    """Whether a variable is one that Kubernetes sets for each Service, one of the name motiongen or motiongen-... here.

    Such as MOTIONGEN_SERVICE_HOST, and MOTIONGEN_PORT=tcp://10.0.0.7:50051, which has the name of a setting.
    """
    return name.startswith(ENVIRONMENT_PREFIX) and bool(
        _LINK_NAME.search(name) or (name.endswith("_PORT") and _LINK_ADDRESS.match(value))
    )


def parse_config(arguments: Sequence[str], environment: Mapping[str, str] | None = None) -> ServerConfig:
    """The configuration that flags and environment ask for. Raises SettingError; --help exits."""
    environment = os.environ if environment is None else environment
    environment = {name: value for name, value in environment.items() if not is_service_link(name, value)}
    known = {each.name: each for each in fields(ServerConfig)}
    unknown = sorted(
        name
        for name in environment
        if name.startswith(ENVIRONMENT_PREFIX) and name.removeprefix(ENVIRONMENT_PREFIX).lower() not in known
    )
    if unknown:
        raise SettingError(f"unknown environment settings {', '.join(unknown)}; `python -m server --help` lists all")
    flags = vars(_parser().parse_args(list(arguments)))
    values = {}
    for name, each in known.items():
        given = flags.get(name)
        if given is None:
            given = environment.get(environment_name(name))
        if given is not None:
            values[name] = _converted(name, given, type(each.default))
    return ServerConfig(**values)


def _converted(name: str, given: str, kind: type) -> Any:
    if kind is bool:
        words = {"true": True, "1": True, "yes": True, "false": False, "0": False, "no": False}
        if given.lower() not in words:
            raise SettingError(f"{name} is {given!r}; it must be true or false")
        return words[given.lower()]
    try:
        return kind(given)
    except ValueError:
        what = "a whole number" if kind is int else "a number"
        raise SettingError(f"{name} is {given!r}; it must be {what}") from None


class _Parser(argparse.ArgumentParser):
    def error(self, message: str) -> Any:
        raise SettingError(f"{message}; `python -m server --help` lists all settings")


def _parser() -> argparse.ArgumentParser:
    parser = _Parser(
        prog="python -m server",
        description="Serve ARDY motion generation over gRPC.",
        epilog="Every setting also has an environment variable; a flag wins over it.",
    )
    for each in fields(ServerConfig):
        metadata = each.metadata
        allowed = ""
        if metadata.get("choices"):
            allowed = f"; one of {', '.join(metadata['choices'])}"
        elif metadata["least"] is not None:
            allowed = f"; {metadata['least']:.12g} to {metadata['most']:.12g}"
        is_switch = isinstance(each.default, bool)
        parser.add_argument(
            f"--{each.name.replace('_', '-')}",
            metavar="true|false" if is_switch else type(each.default).__name__.upper(),
            nargs="?" if is_switch else None,
            const="true" if is_switch else None,
            help=f"{metadata['meaning']}{allowed} (default {each.default}) [{environment_name(each.name)}]",
        )
    return parser
