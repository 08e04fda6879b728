"""EncoderConfig: the settings of the encoder service."""

from __future__ import annotations

from dataclasses import dataclass

from motiongen_server.config import AS_PEERS_CALL, ENCODER_PREFIX, LOG_LEVELS, TEXT_PRECISIONS
from motiongen_server.protection import check_protection
from motiongen_server.settings import Program, check_settings, setting


@dataclass(frozen=True)
class EncoderConfig:
    """Every setting of the encoder service."""

    host: str = setting("127.0.0.1", "address to serve gRPC on, or unix:PATH for a Unix socket", section="Addresses")
    port: int = setting(50052, "port to serve gRPC on; 0 picks a free one", 0, 65535)
    ops_host: str = setting("127.0.0.1", "address to serve health checks and metrics on (HTTP)")
    ops_port: int = setting(9465, "port for health checks and metrics; 0 picks a free one", 0, 65535)
    print_ports: bool = setting(False, "print one JSON line with both ports on standard output once ready")

    tls_certificate: str = setting(
        "", "PEM file with the server's certificate chain; none: plain text", section="TLS and callers"
    )
    tls_key: str = setting("", "PEM file with the private key of the certificate")
    tls_client_ca: str = setting("", "PEM file of authorities; clients must show a certificate signed by one of them")
    ops_tls: bool = setting(False, "serve health checks and metrics over HTTPS, with the same certificate")
    tenants: str = setting("", "TOML file of who may call, with the role text; none: anybody")
    insecure: bool = setting(False, "allow a non-loopback address without TLS or without tenants")

    text_encoder: str = setting(
        "llm2vec", "llm2vec, static (built in), hashed, gradio:URL, prompts:FILE, or a folder", section="Encoder"
    )
    width: int = setting(0, "numbers in a vector, for hashed, which can have any; 0: the encoder's own", 0, 1 << 16)
    device: str = setting("cpu", "device that llm2vec runs on", choices=("cpu", "cuda"))
    precision: str = setting("bfloat16", "precision of llm2vec", choices=TEXT_PRECISIONS)
    threads: int = setting(0, "CPU threads of llm2vec; 0: one for each core", 0, 1024)
    cache: int = setting(16_384, "texts whose vectors are kept in memory", 1, 10_000_000)
    store: str = setting("", "file that keeps vectors of texts when the process ends")
    store_size: int = setting(65_536, "texts kept in that file", 1, 100_000_000)

    max_texts: int = setting(64, "texts in one request", 1, 10_000, section="Limits")
    max_characters: int = setting(10_000, "characters of a text", 1, 1_000_000)
    max_waiting: int = setting(1024, "texts that may wait for the encoder", 1, 1_000_000)
    timeout_s: float = setting(60.0, "longest time that a request waits for the encoder", 0.01, 3600)
    peer_texts_per_second: float = setting(
        1000.0, "new texts per second of one address or tenant; more are refused for a while", 0.1, 1e9
    )
    peer_calls_per_second: float = setting(1000.0, "requests per second of one address or tenant", 0.1, 1e9)
    address_calls_per_second: float | None = setting(
        None,
        "requests begun per second from one address, whichever tenants call from there; more end with CANCELLED",
        1,
        1e9,
        kind=float,
        unset=AS_PEERS_CALL,
    )
    drain_grace_s: float = setting(5.0, "on SIGTERM: time for running requests to end", 0, 3600)

    log_level: str = setting("INFO", "least severity that is logged", choices=LOG_LEVELS, section="Logs")
    log_format: str = setting("text", "format of log lines, on standard error", choices=("text", "json"))

    def __post_init__(self) -> None:
        """Raises SettingError."""
        check_settings(self)
        check_protection(self)


ENCODER = Program(
    EncoderConfig,
    "python -m motiongen_server.text.encoder",
    "Serve a text encoder over gRPC, to many servers.",
    prefix=ENCODER_PREFIX,
)
