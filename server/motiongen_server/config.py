"""ServerConfig: the settings of the server, each with its default, meaning and range."""

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
"""Of the environment variables of `python -m motiongen_server.text.encoder`, which may be set here too."""
ENCODERS = (
    "static (built in), hashed (for tests: knows no meaning), llm2vec, grpc:HOST:PORT, grpcs:HOST:PORT (TLS), "
    "gradio:URL, prompts:FILE, or a folder"
)
SNAPSHOT_STORES = (
    "where sessions are saved for another server to resume: auto (a file in the state folder), none, sqlite:FILE, "
    "redis://HOST:PORT/0 (Valkey too), rediss://, unix://PATH"
)
AS_PEERS_CALL = "2000, or peer_calls_per_second if that is more"
BY_ADDRESS = "Limits of one address (of a tenant, quotas in --tenants take their place)"


@dataclass(frozen=True)
class ServerConfig:
    """Every setting of the server. A flag wins over the environment, the environment over the default."""

    host: str = setting("127.0.0.1", "address to serve gRPC on, or unix:PATH for a Unix socket", section="Addresses")
    port: int = setting(50051, "port to serve gRPC on; 0 picks a free one", 0, 65535)
    ops_host: str = setting("127.0.0.1", "address to serve health checks and metrics on (HTTP)")
    ops_port: int = setting(9464, "port for health checks and metrics; 0 picks a free one", 0, 65535)
    admin_listen: str = setting("", "loopback host:port, or unix:PATH, to serve the admin service on")
    print_ports: bool = setting(False, "print one JSON line with both ports on standard output once ready")
    advertise_address: str = setting(
        "", "host:port at which clients reach this server if another one of the same Redis has no room for them"
    )
    reflection: bool = setting(True, "serve gRPC server reflection")

    tls_certificate: str = setting(
        "", "PEM file with the server's certificate chain; none: plain text", section="TLS and callers"
    )
    tls_key: str = setting("", "PEM file with the private key of the certificate")
    tls_client_ca: str = setting("", "PEM file of authorities; clients must show a certificate signed by one of them")
    ops_tls: bool = setting(False, "serve health checks and metrics over HTTPS, with the same certificate")
    tenants: str = setting("", "TOML file of who may call, with their tokens, certificates and quotas; none: anybody")
    insecure: bool = setting(False, "allow a non-loopback address without TLS or without tenants")

    model: str = setting(
        "motiongen-mini",
        "motiongen-mini, core, core8, g1, g18, a folder, or owner/name on the hub; repeat for more models",
        many=True,
        section="Models",
    )
    devices: str = setting(
        "",
        "one engine process for each: cpu:2 (two, of one thread each), cpu:2x4 (two, of four threads), cuda:0,cuda:1, "
        "cuda:0x3 (three on that GPU), cuda:all; none: cuda:all if there is CUDA, else one of one thread for each "
        "core, up to 8",
        many=True,
    )
    precision: str = setting(
        "auto", "precision of matrix products; auto: bfloat16 if at least 1.5 times as fast", choices=PRECISIONS
    )
    denoise_steps: int = setting(4, "denoising steps of a window, unless the session asks for others", 2, 1000)
    text_guidance: float | None = setting(
        None,
        "guidance weight of the prompt, unless the session asks for another",
        0,
        10,
        kind=float,
        unset="the model's own",
    )
    constraint_guidance: float | None = setting(
        None, "guidance weight of constraints, likewise", 0, 10, kind=float, unset="the model's own"
    )
    history_frames: int = setting(
        16, "frames of history that a window starts with, rounded down to whole tokens", 1, 400
    )
    lookahead_frames: int = setting(
        0,
        "frames sent ahead of the playhead; 0: 40 or max_lookahead_frames, or the model's horizon if longer",
        0,
        10_000,
    )
    max_lookahead_frames: int = setting(80, "most frames ahead of the playhead that a session may ask for", 1, 10_000)

    max_rows: int = setting(64, "most windows in one denoising step", 1, 4096, section="Denoising and admission")
    max_step_ms: int = setting(
        35, "longest planned time of a denoising step, if smaller steps are as efficient", 1, 60_000
    )
    cuda_graphs: bool = setting(True, "record usual batch sizes as CUDA graphs and replay them; no effect on a CPU")
    profile_s: float = setting(8.0, "longest time to measure the model for at start-up", 0, 600)
    admit_load: float | None = setting(
        None,
        "share of the measured capacity up to which sessions are admitted; if unset, 0.87; 0.9 under a CPU quota, 0.86 "
        "if that is less than one core for each thread; 0.75 with more threads than cores, or with several engines on "
        "a GPU; 0.65 or 0.75 where the system does not report how much of a quota is used",
        0.01,
        1e6,
        kind=float,
        unset="by the machine",
    )
    degrade: bool = setting(True, "when overloaded, give sessions fewer steps and tell them, the least urgent first")

    text_encoder: str = setting("static", ENCODERS, section="Text encoder and prompts")
    text_encoder_ca: str = setting("", "PEM file of authorities for an encoder at grpcs:; none: the system's")
    text_encoder_token: str = setting("", "file with the token for an encoder at grpc: or grpcs:")
    text_device: str = setting("cpu", "device that llm2vec runs on", choices=("cpu", "cuda"))
    text_precision: str = setting("bfloat16", "precision of llm2vec", choices=TEXT_PRECISIONS)
    presets: str = setting("", "file of prompts encoded in advance, made by python -m motiongen_ardy.text")
    prompt_cache: int = setting(4096, "prompts whose embeddings are kept in memory", 1, 10_000_000)
    prompt_store: str = setting("", "file in which embeddings of prompts outlive the process")
    prompt_store_size: int = setting(65_536, "prompts kept in that file", 1, 100_000_000)
    prompt_timeout_s: float = setting(10.0, "longest time that an event waits for the text encoder", 0.01, 600)
    max_waiting_prompts: int = setting(256, "prompts that may wait for the text encoder", 1, 1_000_000)

    max_sessions: int = setting(
        2048, "open sessions, as far as the capacity allows", 1, 100_000, section="Sessions and streams"
    )
    max_sessions_per_stream: int = setting(512, "open sessions on one stream", 1, 100_000)
    max_streams: int = setting(2048, "open streams", 1, 100_000)
    max_clip_calls: int = setting(256, "calls for clips in progress", 1, 100_000)
    max_prompt_characters: int = setting(1000, "characters of a prompt", 1, 100_000)
    max_request_bytes: int = setting(1 << 20, "bytes of one message from a client", 1024, 1 << 30)
    max_waiting_mib: int = setting(
        256, "MiB held for clients: unsent updates of all streams and clips, and unread messages", 1, 1_000_000
    )
    loop_share: float = setting(0.4, "share of the event loop's time that clients' messages may take", 0.01, 1e9)
    events_per_second: float = setting(50.0, "events of one session per second", 1, 1e6)
    stream_events_per_second: float = setting(5000.0, "events of one stream per second", 1, 1e7)
    flush_ms: float = setting(20.0, "how long updates are collected into one message", 1, 1000)
    playback_rate: float = setting(1.05, "fastest playback of a session, in multiples of its frame rate", 1, 1e6)
    rewind_s: float = setting(2.0, "seconds of motion kept behind each playhead, for seeking back", 0, 600)
    idle_timeout_s: float = setting(300.0, "silence after which a session is closed", 1, 1e6)
    hello_timeout_s: float = setting(5.0, "time for a stream's hello, or for the request of another call", 0.1, 3600)
    empty_timeout_s: float = setting(300.0, "time after which a stream without sessions is ended", 1, 1e6)
    stuck_timeout_s: float = setting(30.0, "time after which a stream or clip that nobody reads is ended", 1, 3600)
    silent_timeout_s: float = setting(90.0, "silence after which a stream counts as lost", 0.1, 1e6)
    keepalive_s: float = setting(30.0, "silence after which the server sends an HTTP/2 keepalive", 1, 1e6)
    keepalive_timeout_s: float = setting(10.0, "time for its answer, or the connection counts as lost", 0.1, 1e6)
    min_ping_interval_s: float = setting(1.0, "least time between a client's keepalives, or it is cut off", 0, 1e6)

    peer_streams: int = setting(1024, "open streams", 1, 100_000, section=BY_ADDRESS)
    peer_calls: int = setting(256, "open calls for catalogues and clips", 1, 100_000)
    peer_events_per_second: float = setting(20_000.0, "events per second", 1, 1e9)
    peer_prompts_per_second: float = setting(200.0, "new prompts per second", 0.1, 1e6)
    peer_calls_per_second: float = setting(100.0, "new streams, clips and catalogues per second", 1, 1e6)
    address_calls_per_second: float | None = setting(
        None,
        "calls of one service begun per second, whichever tenants call from the address; more end with CANCELLED",
        1,
        1e9,
        kind=float,
        unset=AS_PEERS_CALL,
    )
    peer_bytes_per_second: float = setting(16e6, "bytes received per second", 1024, 1e12)
    peer_session_weight: int = setting(4096, "open sessions; a HERO counts 4, a NEAR 2, others 1", 4, 1_000_000)
    peer_heroes: int = setting(128, "open sessions of the class HERO", 0, 1_000_000)
    peer_clip_samples: int = setting(32, "samples of clips in progress", 1, 100_000)

    resume_grace_s: float = setting(
        30.0, "time that sessions wait for a client that lost its connection", 0, 3600, section="Resuming and draining"
    )
    snapshot_store: str = setting("auto", SNAPSHOT_STORES)
    snapshot_keep_s: float = setting(600.0, "time that the store keeps a session that no server serves", 10, 1e6)
    state_dir: str = setting("", "folder for what outlives the server; none: motiongen in $XDG_STATE_HOME")
    drain_wait_s: float = setting(0.5, "on SIGTERM: time to report not ready before clients are told", 0, 600)
    drain_grace_s: float = setting(5.0, "on SIGTERM: time for clients to end their sessions", 0, 3600)
    reconnect_after_s: float = setting(
        0.0, "on SIGTERM: time after which clients are told to reconnect; 0: at once", 0, 3600
    )

    log_level: str = setting("INFO", "least severity that is logged", choices=LOG_LEVELS, section="Logs and traces")
    log_format: str = setting("text", "format of log lines, on standard error", choices=("text", "json"))
    trace_to: str = setting("", "OpenTelemetry collector, grpc:HOST:PORT or grpcs:HOST:PORT (TLS); none: no traces")
    trace_share: float = setting(1.0, "share of windows that are traced", 0, 1)

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
        """The look-ahead in frames of a session that does not ask for one, for a model with that horizon."""
        return self.lookahead_frames or max(min(DEFAULT_LOOKAHEAD_FRAMES, self.max_lookahead_frames), horizon)


def check_encoder_access(encoder: str, authorities: str, token: str) -> None:
    """Raise SettingError for authorities or a token that the connection to this encoder would not use."""
    if authorities and not encoder.startswith("grpcs:"):
        raise SettingError(
            f"text_encoder_ca is given, but text_encoder is {encoder!r}; only grpcs:HOST:PORT is reached by TLS"
        )
    if token and not encoder.startswith(("grpc:", "grpcs:")):
        raise SettingError(
            f"text_encoder_token is given, but text_encoder is {encoder!r}; a token is sent to grpc:HOST:PORT and "
            "grpcs:HOST:PORT only"
        )


def check_advertised(given: str) -> None:
    """Raise SettingError unless it is an address that clients can connect to."""
    host, _, port = given.rpartition(":")
    if not host or not is_port(port) or not int(port) or len(given) > 256:
        raise SettingError(
            f"advertise_address is {given!r}; it must be host:port as clients reach this server, such as "
            "motion-3.example.com:50051"
        )


def check_admin_address(given: str) -> None:
    """Raise SettingError unless it is an address that only this machine can reach."""
    host, _, port = given.rpartition(":")
    if given.startswith(UNIX) and given != UNIX:
        return
    if not is_local(host.removeprefix("[").removesuffix("]")) or not is_port(port):
        raise SettingError(
            f"admin_listen is {given!r}; it must be a loopback host and a port, such as 127.0.0.1:50052, or unix:PATH: "
            "whoever reaches it may load any folder"
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
