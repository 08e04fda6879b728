"""deploy/compose.yaml: valid, complete, protected, and with settings that the programs accept."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
import yaml

from motiongen_server.config import parse_config
from motiongen_server.text.encoder.config import ENCODER
from tests.deploy.compose_here import DEPLOY, IMAGE, SERVERS, make_secrets, read_compose

COMPOSE = read_compose()
SERVICES: dict[str, Any] = COMPOSE["services"]


def names_in(service: dict[str, Any], kind: str) -> set[str]:
    """Secrets or networks that a service uses."""
    return {each["source"] if isinstance(each, dict) else each for each in service.get(kind, ())}


@pytest.mark.parametrize("kind", ["secrets", "networks"])
def test_secrets_and_networks_are_all_declared_and_used(kind: str) -> None:
    used = {name for service in SERVICES.values() for name in names_in(service, kind)}
    assert used == set(COMPOSE[kind])


def test_script_creates_every_secret(tmp_path: Path) -> None:
    made = make_secrets(tmp_path)
    wanted = {Path(each["file"]).name for each in COMPOSE["secrets"].values()}
    wanted |= {Path(file).name for service in SERVICES.values() for file in service.get("env_file", ())}
    assert wanted <= {path.name for path in made.iterdir()}
    assert made.stat().st_mode & 0o077 == 0, "other users must not read the keys"
    ignored = (DEPLOY.parent / ".gitignore").read_text(encoding="utf-8").split()
    assert "/deploy/secrets/" in ignored


def test_script_without_a_token_program_fails_and_leaves_no_files(tmp_path: Path) -> None:
    environment = {**os.environ, "IDENTITY": "false"}
    command = [str(DEPLOY / "make_secrets.sh"), str(tmp_path / "secrets")]
    made = subprocess.run(command, env=environment, capture_output=True, text=True)
    assert made.returncode == 1
    assert "IDENTITY" in made.stderr
    assert not list(tmp_path.iterdir())


def test_failure_while_creating_tokens_leaves_no_files(tmp_path: Path) -> None:
    program = tmp_path / "identity"
    program.write_text('#!/bin/sh\ntest "$1" = --help || { echo "no more tokens" >&2; exit 3; }\n', encoding="utf-8")
    program.chmod(0o755)
    command = [str(DEPLOY / "make_secrets.sh"), str(tmp_path / "secrets")]
    made = subprocess.run(command, env={**os.environ, "IDENTITY": str(program)}, capture_output=True, text=True)
    assert made.returncode == 3
    assert "no more tokens" in made.stderr
    assert list(tmp_path.iterdir()) == [program]


def test_configs_of_read_only_services_are_files() -> None:
    """Compose copies inline configs into the container, which fails if its root is read-only."""
    assert all(config.keys() == {"file"} for config in COMPOSE.get("configs", {}).values())


def test_mounted_files_exist() -> None:
    for name, service in SERVICES.items():
        for source in (volume.split(":")[0] for volume in service.get("volumes", ())):
            is_named = source in COMPOSE["volumes"]
            assert is_named or (DEPLOY / source).exists(), (name, source)


@pytest.mark.parametrize("name", SERVERS)
def test_server_settings_are_valid_and_protected(name: str) -> None:
    config = parse_config([], IMAGE | SERVICES[name]["environment"])
    assert not config.insecure
    named = {Path(path).name for path in (config.tls_certificate, config.tls_key, config.tenants)}
    assert named <= names_in(SERVICES[name], "secrets")


def test_encoder_settings_are_valid_and_protected() -> None:
    service = SERVICES["encoder"]
    config = ENCODER.parse([], IMAGE | service["environment"])
    assert not config.insecure
    assert config.tls_certificate
    assert config.tenants
    assert service["entrypoint"] == ["motiongen-text-encoder"]
    assert service["healthcheck"]["test"] == ["CMD", "motiongen-server-ready", "--encoder"]


@pytest.mark.parametrize("name", SERVICES)
def test_services_have_no_rights_that_they_do_not_need(name: str) -> None:
    service = SERVICES[name]
    assert service["read_only"]
    assert service["cap_drop"] == ["ALL"]
    assert "no-new-privileges:true" in service["security_opt"]
    published = [str(port) for port in service.get("ports", ())]
    assert name == "proxy" or all(port.startswith("127.0.0.1:") for port in published)


def test_only_proxy_and_grafana_are_on_outside_networks() -> None:
    outside = {name for name, each in COMPOSE["networks"].items() if not each.get("internal")}
    assert {name for name, service in SERVICES.items() if names_in(service, "networks") & outside} == {
        "proxy",
        "grafana",
    }


def test_images_have_a_fixed_version() -> None:
    for name, service in SERVICES.items():
        assert re.search(r":v?\d+\.\d+|^motiongen-server:(cpu|cuda)$", service["image"]), name


@pytest.mark.system
def test_compose_file_matches_the_schema() -> None:
    command = [sys.executable, "-m", "check_jsonschema", "--builtin-schema", "vendor.compose-spec"]
    done = subprocess.run([*command, str(DEPLOY / "compose.yaml")], capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr


def test_prometheus_scrapes_all_servers_and_the_encoder() -> None:
    content = yaml.safe_load((DEPLOY / "prometheus" / "compose.yaml").read_text(encoding="utf-8"))
    targets = {job["job_name"]: job["static_configs"][0]["targets"] for job in content["scrape_configs"]}
    assert targets == {
        "motiongen": [f"{name}:{parse_config([], {}).ops_port}" for name in SERVERS],
        "encoder": [f"encoder:{ENCODER.parse([], {}).ops_port}"],
    }
