"""EncoderConfig: the settings of the encoder service."""

from __future__ import annotations

from dataclasses import dataclass

from motiongen_server.config import ENCODER_PREFIX, LOG_LEVELS, TEXT_PRECISIONS
from motiongen_server.protection import check_protection
from motiongen_server.settings import Program, check_settings, setting


@dataclass(frozen=True)
class EncoderConfig:
    """Every setting of the encoder service."""

    host: str = setting("127.0.0.1", "address to serve gRPC on")
    port: int = setting(50052, "port to serve gRPC on; 0 picks a free one", 0, 65535)
    ops_host: str = setting("127.0.0.1", "address of health checks and metrics (HTTP)")
    ops_port: int = setting(9465, "port of health checks and metrics; 0 picks a free one", 0, 65535)
    tls_certificate: str = setting("", "PEM file of the certificate to serve gRPC with; none: plain text")
    tls_key: str = setting("", "PEM file of its key")
    tls_client_ca: str = setting("", "PEM file of authorities; clients must show a certificate that one of them signed")
    ops_tls: bool = setting(False, "serve health checks and metrics by https, with the same certificate")
    tenants: str = setting("", "TOML file of who may call, with the role text; none: everybody")
    insecure: bool = setting(False, "listen where other machines reach it, without TLS or without asking who calls")
    print_ports: bool = setting(False, "print one JSON line with both ports on standard output once ready")
    text_encoder: str = setting("llm2vec", "llm2vec, static (built in), hashed, gradio:URL, prompts:FILE, a folder")
    width: int = setting(0, "numbers in a vector; for hashed, which fits any. 0: the encoder's own", 0, 1 << 16)
    device: str = setting("cpu", "device of llm2vec", choices=("cpu", "cuda"))
    precision: str = setting("bfloat16", "precision of llm2vec", choices=TEXT_PRECISIONS)
    threads: int = setting(0, "CPU threads of llm2vec; 0 = one for each core", 0, 1024)
    max_texts: int = setting(64, "texts in one request", 1, 10_000)
    max_characters: int = setting(10_000, "length of a text", 1, 1_000_000)
    max_waiting: int = setting(1024, "texts that may wait for the encoder", 1, 1_000_000)
    peer_texts_per_second: float = setting(
        1000.0, "texts that are not known, of one address or tenant; more are refused for a while", 0.1, 1e9
    )
    peer_calls_per_second: float = setting(1000.0, "requests of one address or tenant", 0.1, 1e9)
    timeout_s: float = setting(60.0, "longest that a request waits for the encoder", 0.01, 3600)
    cache: int = setting(16_384, "texts whose vectors are remembered", 1, 10_000_000)
    store: str = setting("", "file on this machine that remembers them beyond the end of the process")
    store_size: int = setting(65_536, "texts in that file", 1, 100_000_000)
    drain_grace_s: float = setting(5.0, "after SIGTERM: time that running requests get", 0, 3600)
    log_level: str = setting("INFO", "least severity that is logged", choices=LOG_LEVELS)
    log_format: str = setting("text", "form of log lines on standard error", choices=("text", "json"))

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
