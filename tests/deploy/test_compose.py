"""deploy/compose.yaml: what the format allows, what the programs take, and nothing that is missing."""

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
def test_what_services_use_is_declared_and_all_of_it_is_used(kind: str) -> None:
    used = {name for service in SERVICES.values() for name in names_in(service, kind)}
    assert used == set(COMPOSE[kind])


def test_the_script_makes_every_secret(tmp_path: Path) -> None:
    made = make_secrets(tmp_path)
    wanted = {Path(each["file"]).name for each in COMPOSE["secrets"].values()}
    wanted |= {Path(file).name for service in SERVICES.values() for file in service.get("env_file", ())}
    assert wanted <= {path.name for path in made.iterdir()}
    assert made.stat().st_mode & 0o077 == 0, "others must not reach the keys"
    ignored = (DEPLOY.parent / ".gitignore").read_text(encoding="utf-8").split()
    assert "/deploy/secrets/" in ignored


def test_a_script_that_can_make_no_tokens_says_so_and_leaves_nothing(tmp_path: Path) -> None:
    environment = {**os.environ, "IDENTITY": "false"}
    command = [str(DEPLOY / "make_secrets.sh"), str(tmp_path / "secrets")]
    made = subprocess.run(command, env=environment, capture_output=True, text=True)
    assert made.returncode == 1
    assert "IDENTITY" in made.stderr
    assert not list(tmp_path.iterdir())


def test_tokens_that_fail_half_way_leave_nothing_either(tmp_path: Path) -> None:
    program = tmp_path / "identity"
    program.write_text('#!/bin/sh\ntest "$1" = --help || { echo "no more tokens" >&2; exit 3; }\n', encoding="utf-8")
    program.chmod(0o755)
    command = [str(DEPLOY / "make_secrets.sh"), str(tmp_path / "secrets")]
    made = subprocess.run(command, env={**os.environ, "IDENTITY": str(program)}, capture_output=True, text=True)
    assert made.returncode == 3
    assert "no more tokens" in made.stderr
    assert list(tmp_path.iterdir()) == [program]


def test_what_is_mounted_into_a_service_that_may_not_write_is_a_file() -> None:
    """Compose copies configs that are written in its own file, which a root that is read-only refuses."""
    assert all(config.keys() == {"file"} for config in COMPOSE.get("configs", {}).values())


def test_files_that_are_mounted_are_there() -> None:
    for name, service in SERVICES.items():
        for source in (volume.split(":")[0] for volume in service.get("volumes", ())):
            is_named = source in COMPOSE["volumes"]
            assert is_named or (DEPLOY / source).exists(), (name, source)


@pytest.mark.parametrize("name", SERVERS)
def test_the_server_takes_its_settings_and_is_protected(name: str) -> None:
    config = parse_config([], IMAGE | SERVICES[name]["environment"])
    assert not config.insecure
    named = {Path(path).name for path in (config.tls_certificate, config.tls_key, config.tenants)}
    assert named <= names_in(SERVICES[name], "secrets")


def test_the_encoder_takes_its_settings_and_is_protected() -> None:
    service = SERVICES["encoder"]
    config = ENCODER.parse([], IMAGE | service["environment"])
    assert not config.insecure
    assert config.tls_certificate
    assert config.tenants
    assert service["entrypoint"] == ["motiongen-text-encoder"]
    assert service["healthcheck"]["test"] == ["CMD", "motiongen-server-ready", "--encoder"]


@pytest.mark.parametrize("name", SERVICES)
def test_a_service_may_do_no_more_than_it_must(name: str) -> None:
    service = SERVICES[name]
    assert service["read_only"]
    assert service["cap_drop"] == ["ALL"]
    assert "no-new-privileges:true" in service["security_opt"]
    published = [str(port) for port in service.get("ports", ())]
    assert name == "proxy" or all(port.startswith("127.0.0.1:") for port in published)


def test_only_the_proxy_and_grafana_are_where_others_reach_them() -> None:
    outside = {name for name, each in COMPOSE["networks"].items() if not each.get("internal")}
    assert {name for name, service in SERVICES.items() if names_in(service, "networks") & outside} == {
        "proxy",
        "grafana",
    }


def test_images_of_others_have_a_version() -> None:
    for name, service in SERVICES.items():
        assert re.search(r":v?\d+\.\d+|^motiongen-server:(cpu|cuda)$", service["image"]), name


@pytest.mark.system
def test_the_format_allows_it() -> None:
    command = [sys.executable, "-m", "check_jsonschema", "--builtin-schema", "vendor.compose-spec"]
    done = subprocess.run([*command, str(DEPLOY / "compose.yaml")], capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr


def test_prometheus_is_told_of_all_that_have_metrics() -> None:
    content = yaml.safe_load((DEPLOY / "prometheus" / "compose.yaml").read_text(encoding="utf-8"))
    targets = {job["job_name"]: job["static_configs"][0]["targets"] for job in content["scrape_configs"]}
    assert targets == {
        "motiongen": [f"{name}:{parse_config([], {}).ops_port}" for name in SERVERS],
        "encoder": [f"encoder:{ENCODER.parse([], {}).ops_port}"],
    }
