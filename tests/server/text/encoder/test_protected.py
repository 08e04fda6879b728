"""The encoder service with TLS and tokens: what its callers need, and how they are refused without it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from motiongen_ardy.text import HashedTextEncoder, TextEncoderUnavailable
from motiongen_server.config import ServerConfig
from motiongen_server.settings import SettingError
from motiongen_server.text.encoder.access import encoder_credentials, encoder_token
from motiongen_server.text.encoder.client import RemoteEncoder
from motiongen_server.text.encoder.config import EncoderConfig
from tests.server.identity.files import AUTHORITY, TenantsFile, copy_pair
from tests.server.text.encoder.encoder_process import EncoderProcess
from tests.waiting import LIMIT_S


def test_service_with_tls_serves_callers_with_a_token_for_text(tmp_path: Path) -> None:
    certificate, key = copy_pair("server-1", tmp_path)
    tenants = TenantsFile(tmp_path)
    token = tenants.one("roles = ['text']")
    (tmp_path / "token").write_text("mg_old\n")
    options = ("--text-encoder", "hashed", "--width", "16", "--tls-certificate", certificate, "--tls-key", key)
    settings = ServerConfig(
        text_encoder="grpcs:x:1", text_encoder_ca=AUTHORITY, text_encoder_token=str(tmp_path / "token")
    )
    credentials = encoder_credentials(settings)
    with EncoderProcess(tmp_path / "log.txt", *options, "--tenants", str(tenants.path)) as process:
        present = encoder_token(settings, process.address, by_tls=True)
        encoder = RemoteEncoder(process.address, LIMIT_S, ("hashed-16", 16), credentials, present)
        with pytest.raises(TextEncoderUnavailable, match="UNAUTHENTICATED"):
            encoder.encode(["a person walks"])
        (tmp_path / "token").write_text(f"{token}\n")
        expected = HashedTextEncoder(16).encode(["a person walks"])
        np.testing.assert_array_equal(encoder.encode(["a person walks"]), expected)
        assert RemoteEncoder(process.address, LIMIT_S, None, credentials, present).identity == "hashed-16"
        tenants.write(tenants.path.read_text().replace("'text'", "'motion'"))
        with pytest.raises(TextEncoderUnavailable, match="PERMISSION_DENIED"):
            encoder.encode(["a person jumps"])
        with pytest.raises(TextEncoderUnavailable):
            RemoteEncoder(process.address, 0.5)
        assert process.stop() == 0


@pytest.mark.parametrize("host", ["host", "ops_host"])
def test_listening_for_other_machines_needs_tls_and_tenants(host: str) -> None:
    with pytest.raises(SettingError, match=f"^{host} is '0.0.0.0'"):
        EncoderConfig(**{host: "0.0.0.0"})  # type: ignore[arg-type]
    protection = {"tls_certificate": "a.pem", "tls_key": "a.key", "tenants": "tenants.toml"}
    assert EncoderConfig(**{host: "0.0.0.0"}, **protection).tenants  # type: ignore[arg-type]


def test_token_is_not_sent_over_a_network_in_plain_text(tmp_path: Path) -> None:
    (tmp_path / "token").write_text("mg_1")
    settings = ServerConfig(text_encoder="grpc:x:1", text_encoder_token=str(tmp_path / "token"))
    with pytest.raises(SettingError, match="plain text; give grpcs:"):
        encoder_token(settings, "encoder.example:50052", by_tls=False)
    present = encoder_token(settings, "[::1]:50052", by_tls=False)
    assert present is not None
    assert present() == "mg_1"


def test_missing_authority_or_token_file_is_refused(tmp_path: Path) -> None:
    nowhere = str(tmp_path / "nowhere")
    with pytest.raises(SettingError, match="text_encoder_ca"):
        encoder_credentials(ServerConfig(text_encoder="grpcs:x:1", text_encoder_ca=nowhere))
    with pytest.raises(SettingError, match="text_encoder_token"):
        encoder_token(ServerConfig(text_encoder="grpc:x:1", text_encoder_token=nowhere), "localhost:1", by_tls=True)


@pytest.mark.parametrize("content", ["", "\n", "mg_1 mg_2", "mg_1\nmg_2", "mg_1\ufeff", "mg_\u00e9", "mg_\0"])
def test_malformed_token_file_is_refused_and_the_previous_token_kept(tmp_path: Path, content: str) -> None:
    path = tmp_path / "token"
    settings = ServerConfig(text_encoder="grpc:x:1", text_encoder_token=str(path))
    path.write_text("mg_before\n")
    present = encoder_token(settings, "localhost:1", by_tls=False)
    assert present is not None
    path.write_text(content, encoding="utf-8")
    assert present() == "mg_before"
    with pytest.raises(SettingError, match="text_encoder_token cannot be read: it must be one word of ASCII"):
        encoder_token(settings, "localhost:1", by_tls=False)
    path.write_text("mg_after\n")
    assert present() == "mg_after"
