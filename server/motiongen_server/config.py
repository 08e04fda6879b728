"""ServerConfig: a field, a flag, an environment name, a meaning; checked once."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from motiongen_server.addresses import UNIX, is_local, is_port
from motiongen_server.collector import check_collector
from motiongen_server.devices import check_devices
from motiongen_server.protection import check_protection
from motiongen_server.settings import ENVIRONMENT_PREFIX, Program, SettingError, check_settings, setting

DEFAULT_LOOKAHEAD_FRAMES = 40
PRECISIONS = ("float32", "bfloat16", "auto")
TEXT_PRECISIONS = ("float32", "bfloat16")
LOG_LEVELS = ("DEBUG", "INFO", "WARNING", "ERROR")
ENCODER_PREFIX = f"{ENVIRONMENT_PREFIX}ENCODER_"
"""Of the environment of `python -m motiongen_server.text.encoder`, which may be that of this program too."""
ENCODERS = (
    "static (built in), hashed (knows no meaning), llm2vec, grpc:HOST:PORT, grpcs:HOST:PORT (TLS), gradio:URL, "
    "prompts:FILE, a folder"
)


SNAPSHOT_STORES = (
    "where sessions are saved, so that another server goes on with them: auto (a file in the state folder), none, "
    "sqlite:FILE, redis://HOST:PORT/0 (Valkey too), rediss://, unix://PATH"
)


@dataclass(frozen=True)
class ServerConfig:
    """Every setting of the server. A flag wins over the environment, the environment over the default."""

    host: str = setting("127.0.0.1", "address to serve gRPC on, or unix:PATH for a socket of this machine")
    port: int = setting(50051, "port to serve gRPC on; 0 picks a free one", 0, 65535)
    ops_host: str = setting("127.0.0.1", "address of health checks and metrics (HTTP)")
    ops_port: int = setting(9464, "port of health checks and metrics; 0 picks a free one", 0, 65535)
    print_ports: bool = setting(False, "print one JSON line with both ports on standard output once ready")
    admin_listen: str = setting("", "host:port of this machine, or unix:PATH, to serve the admin service on")
    tls_certificate: str = setting(
        "", "PEM file of the certificate to serve gRPC with, and its chain; none: plain text"
    )
    tls_key: str = setting("", "PEM file of its key")
    tls_client_ca: str = setting("", "PEM file of authorities; clients must show a certificate that one of them signed")
    ops_tls: bool = setting(False, "serve health checks and metrics by https, with the same certificate")
    tenants: str = setting("", "TOML file of who may call, by which tokens and certificates; none: everybody")
    insecure: bool = setting(False, "listen where other machines reach it, without TLS or without asking who calls")
    model: str = setting(
        "motiongen-mini",
        "motiongen-mini, core, core8, g1, g18, a folder, a hub's owner/name; again for more",
        many=True,
    )
    text_encoder: str = setting("static", ENCODERS)
    text_encoder_ca: str = setting("", "PEM file of authorities, of an encoder at grpcs:; none: those of the system")
    text_encoder_token: str = setting("", "file with the token that an encoder at grpc: or grpcs: asks for")
    text_device: str = setting("cpu", "device of llm2vec", choices=("cpu", "cuda"))
    text_precision: str = setting("bfloat16", "precision of llm2vec", choices=TEXT_PRECISIONS)
    devices: str = setting(
        "",
        "an engine process for each: cpu:2 (two of a thread each), cpu:2x4 (two of four threads), cuda:0,cuda:1, "
        "cuda:0x3 (three on it), cuda:all; none: cuda:all where there is CUDA, else cpu: and the number of cores, at "
        "most 8",
        many=True,
    )
    precision: str = setting(
        "auto", "of the model's products; auto: bfloat16 where it is 1.5 times faster", choices=PRECISIONS
    )
    denoise_steps: int = setting(4, "denoising steps of a window when a session does not say", 2, 1000)
    text_guidance: float | None = setting(None, "weight of the prompt when a session does not say", 0, 10, kind=float)
    constraint_guidance: float | None = setting(None, "weight of constraints then", 0, 10, kind=float)
    history_frames: int = setting(
        16, "decided frames that a new window starts with, in whole tokens of the model", 1, 400
    )
    max_rows: int = setting(64, "most windows in one denoising step", 1, 4096)
    max_step_ms: int = setting(35, "what a denoising step may be expected to take, where smaller ones pay", 1, 60_000)
    cuda_graphs: bool = setting(
        True, "record work of the usual sizes as CUDA graphs and replay it; has no effect on a processor"
    )
    profile_s: float = setting(8.0, "longest time that measuring the model takes at the start", 0, 600)
    admit_load: float | None = setting(
        None,
        "share of the measured capacity up to which sessions are let in; none: 0.87, 0.9 of a quota of the processor, "
        "0.86 where that is less than a core for each thread, 0.75 of engines with more threads than cores, and "
        "of several on a GPU, 0.65 or 0.75 where nobody says what is used of a quota",
        0.01,
        1e6,
        kind=float,
    )
    degrade: bool = setting(True, "give sessions less, and tell them, where the machine cannot keep up")
    max_sessions: int = setting(2048, "open sessions on this server, if its capacity allows", 1, 100_000)
    max_sessions_per_stream: int = setting(512, "open sessions on one stream", 1, 100_000)
    max_streams: int = setting(2048, "streams open at once", 1, 100_000)
    lookahead_frames: int = setting(
        0, "frames sent beyond the playhead; 0 = 40 or max_lookahead_frames, or the horizon if longer", 0, 10_000
    )
    max_lookahead_frames: int = setting(80, "most that a session may ask for", 1, 10_000)
    max_prompt_characters: int = setting(1000, "length of a prompt", 1, 100_000)
    max_request_bytes: int = setting(1 << 20, "size of one message from a client", 1024, 1 << 30)
    keepalive_s: float = setting(30.0, "silence after which a client is asked whether it is there", 1, 1e6)
    keepalive_timeout_s: float = setting(10.0, "within which it must answer, or its transport is lost", 0.1, 1e6)
    min_ping_interval_s: float = setting(1.0, "least time between keepalives of a client, else it is cut off", 0, 1e6)
    hello_timeout_s: float = setting(
        5.0, "within which a stream must say hello, and the request of another call come", 0.1, 3600
    )
    empty_timeout_s: float = setting(300.0, "after which a stream without sessions is ended", 1, 1e6)
    stuck_timeout_s: float = setting(30.0, "after which a stream or clip that nobody reads is ended", 1, 3600)
    silent_timeout_s: float = setting(90.0, "after which a stream from which nothing comes is lost", 0.1, 1e6)
    max_waiting_mib: int = setting(
        256, "unsent updates of all streams and clips, and what else is held for clients, MiB", 1, 1_000_000
    )
    max_clip_calls: int = setting(256, "calls for clips that are under way", 1, 100_000)
    loop_share: float = setting(0.4, "of the gateway's event loop's time, what clients' messages may take", 0.01, 1e9)
    peer_streams: int = setting(1024, "streams of one address", 1, 100_000)
    peer_calls: int = setting(256, "calls of one address for catalogues and clips, open at once", 1, 100_000)
    peer_events_per_second: float = setting(20_000.0, "events of one address a second", 1, 1e9)
    peer_prompts_per_second: float = setting(200.0, "new prompts of one address a second", 0.1, 1e6)
    peer_calls_per_second: float = setting(100.0, "new streams, clips, catalogues of one address a second", 1, 1e6)
    peer_bytes_per_second: float = setting(16e6, "bytes received of one address a second", 1024, 1e12)
    peer_session_weight: int = setting(4096, "sessions of one address; a HERO counts 4, a NEAR 2", 4, 1_000_000)
    peer_heroes: int = setting(128, "sessions of one address in the class HERO", 0, 1_000_000)
    peer_clip_samples: int = setting(32, "samples of clips of one address that are being made", 1, 100_000)
    events_per_second: float = setting(50.0, "events of one session a second", 1, 1e6)
    stream_events_per_second: float = setting(5000.0, "events of one stream a second", 1, 1e7)
    flush_ms: float = setting(20.0, "how long updates are gathered into one message", 1, 1000)
    playback_rate: float = setting(1.05, "times its frame rate that a session may be played at", 1, 1e6)
    idle_timeout_s: float = setting(300.0, "silence after which a session is closed", 1, 1e6)
    rewind_s: float = setting(2.0, "of each session's motion that is kept behind its playhead, to go back to", 0, 600)
    resume_grace_s: float = setting(30.0, "for which sessions wait for a client that lost its line", 0, 3600)
    snapshot_store: str = setting("auto", SNAPSHOT_STORES)
    advertise_address: str = setting(
        "", "host:port of this server for clients that another of the same Redis has no room for; none: by the proxy"
    )
    state_dir: str = setting("", "folder of what outlives the server; none: motiongen in $XDG_STATE_HOME")
    snapshot_keep_s: float = setting(600.0, "for which a session that nobody serves stays there", 10, 1e6)
    prompt_cache: int = setting(4096, "prompts whose embeddings are remembered", 1, 10_000_000)
    prompt_store: str = setting("", "file on this machine that remembers them beyond the end of the process")
    prompt_store_size: int = setting(65_536, "prompts in that file", 1, 100_000_000)
    prompt_timeout_s: float = setting(10.0, "longest that an event waits for the text encoder", 0.01, 600)
    max_waiting_prompts: int = setting(256, "prompts that may wait for the text encoder", 1, 1_000_000)
    presets: str = setting("", "file of prompts encoded beforehand, made by python -m motiongen_ardy.text")
    drain_wait_s: float = setting(0.5, "after SIGTERM: not ready for so long, before clients are told", 0, 600)
    drain_grace_s: float = setting(5.0, "after SIGTERM: time clients get to end their sessions", 0, 3600)
    reconnect_after_s: float = setting(
        0.0, "after SIGTERM: clients are told to connect again then; 0: at once", 0, 3600
    )
    reflection: bool = setting(True, "answer gRPC server reflection")
    trace_to: str = setting(
        "", "collector of OpenTelemetry traces, grpc:HOST:PORT or grpcs:HOST:PORT (TLS); none: none"
    )
    trace_share: float = setting(1.0, "share of windows that are traced", 0, 1)
    log_level: str = setting("INFO", "least severity that is logged", choices=LOG_LEVELS)
    log_format: str = setting("text", "form of log lines on standard error", choices=("text", "json"))

    def __post_init__(self) -> None:
        """Raises SettingError for a value outside its range, or values that contradict each other."""
        check_settings(self)
        if self.max_lookahead_frames < self.lookahead_frames:
            raise SettingError(
                f"max_lookahead_frames is {self.max_lookahead_frames}; it must be at least lookahead_frames, "
                f"which is {self.lookahead_frames}"
            )
        if not all(self.models) or len(set(self.models)) < len(self.models):
            raise SettingError(f"model is {self.model!r}; give each model once, with commas between them")
        if self.admin_listen:
            check_admin_address(self.admin_listen)
        check_protection(self)
        check_encoder_access(self.text_encoder, self.text_encoder_ca, self.text_encoder_token)
        check_collector(self.trace_to)
        if self.advertise_address:
            check_advertised(self.advertise_address)
        check_devices(self.devices)

    @property
    def models(self) -> tuple[str, ...]:
        """All models to serve, the default first."""
        return tuple(name.strip() for name in self.model.split(","))

    def lookahead_for(self, horizon: int) -> int:
        """Frames sent beyond the playhead of a session that does not say, of a model with that horizon."""
        return self.lookahead_frames or max(min(DEFAULT_LOOKAHEAD_FRAMES, self.max_lookahead_frames), horizon)


def check_encoder_access(encoder: str, authorities: str, token: str) -> None:
    """Raise SettingError for what would prove nobody: an encoder that is reached without it."""
    if authorities and not encoder.startswith("grpcs:"):
        raise SettingError(
            f"text_encoder_ca is given, and text_encoder is {encoder!r}; only grpcs:HOST:PORT is reached by TLS"
        )
    if token and not encoder.startswith(("grpc:", "grpcs:")):
        raise SettingError(
            f"text_encoder_token is given, and text_encoder is {encoder!r}; a token is shown to grpc:HOST:PORT and "
            "grpcs:HOST:PORT only"
        )


def check_advertised(given: str) -> None:
    """Raise SettingError unless clients can be told it."""
    host, _, port = given.rpartition(":")
    if not host or not is_port(port) or not int(port) or len(given) > 256:
        raise SettingError(
            f"advertise_address is {given!r}; it must be host:port as clients reach this server, such as "
            "motion-3.example.com:50051"
        )


def check_admin_address(given: str) -> None:
    """Raise SettingError unless it is an address of this machine that others cannot reach."""
    host, _, port = given.rpartition(":")
    if given.startswith(UNIX) and given != UNIX:
        return
    if not is_local(host.removeprefix("[").removesuffix("]")) or not is_port(port):
        raise SettingError(
            f"admin_listen is {given!r}; it must be a loopback host and a port, such as 127.0.0.1:50052, or unix:PATH: "
            "who reaches it may load any folder"
        )


SERVER = Program(
    ServerConfig,
    "python -m motiongen_server",
    "Serve ARDY motion generation over gRPC.",
    other_prefixes=(ENCODER_PREFIX,),
)


def parse_config(arguments: Sequence[str], environment: Mapping[str, str] | None = None) -> ServerConfig:
    """The configuration that flags and environment ask for. Raises SettingError; --help exits."""
    return SERVER.parse(arguments, environment)
