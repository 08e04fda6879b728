"""deploy/ uses settings, metrics and files that exist."""

from __future__ import annotations

import math
import re
from dataclasses import fields
from pathlib import Path
from typing import Any

import pytest
import yaml

from motiongen_server.config import ENCODER_PREFIX, ServerConfig
from motiongen_server.ops.metrics import Metrics
from motiongen_server.text.encoder.config import EncoderConfig

SETTINGS = {f"MOTIONGEN_{each.name.upper()}" for each in fields(ServerConfig)}
SETTINGS |= {f"{ENCODER_PREFIX}{each.name.upper()}" for each in fields(EncoderConfig)}


def files(repository: Any, *endings: str) -> list[Path]:
    found = [path for path in repository.files if path.parts[0] == "deploy" and path.name.endswith(endings)]
    return [repository.root / path for path in found]


def test_every_setting_in_use_exists(repository: Any) -> None:
    named = set()
    for path in files(repository, "Dockerfile", ".yaml", ".service"):
        named |= set(re.findall(r"\bMOTIONGEN_[A-Z_]+[A-Z]\b", path.read_text(encoding="utf-8")))
    assert sorted(named - SETTINGS) == []
    assert len(named) > 8


def test_every_metric_of_an_alert_exists(repository: Any) -> None:
    there = {
        f"{family.name}_total" if family.type == "counter" else family.name for family in Metrics().registry.collect()
    }
    text = (repository.root / "deploy" / "prometheus" / "alerts.yaml").read_text(encoding="utf-8")
    named = {word for line in text.splitlines() if "expr:" in line for word in re.findall(r"motiongen_\w+", line)}
    assert sorted(named - there) == []
    assert len(named) > 10


def test_every_alert_is_explained_and_tested(repository: Any) -> None:
    folder = repository.root / "deploy" / "prometheus"
    (group,) = yaml.safe_load((folder / "alerts.yaml").read_text(encoding="utf-8"))["groups"]
    alerts = {rule["alert"] for rule in group["rules"]}
    tried = yaml.safe_load((folder / "alerts_test.yaml").read_text(encoding="utf-8"))["tests"]
    assert {f"{alert} {what}" for alert in alerts for what in ("fires", "stays silent")} == {
        each["name"] for each in tried
    }
    page = (repository.root / "docs" / "operations.md").read_text(encoding="utf-8")
    assert re.findall(r"^### `(Motiongen\w+)`$", page, re.MULTILINE) == [rule["alert"] for rule in group["rules"]]


def test_yaml_files_can_be_read_and_kustomization_lists_them_all(repository: Any) -> None:
    for path in files(repository, ".yaml"):
        assert list(yaml.safe_load_all(path.read_text(encoding="utf-8"))), path
    base = repository.root / "deploy" / "kubernetes" / "base"
    listed = yaml.safe_load((base / "kustomization.yaml").read_text(encoding="utf-8"))["resources"]
    assert {path.name for path in base.glob("*.yaml")} == {*listed, "kustomization.yaml"}
    for name in listed:
        content = yaml.safe_load((base / name).read_text(encoding="utf-8"))
        assert content["metadata"]["name"] == "motiongen"


def test_pods_have_more_time_to_end_than_they_drain(repository: Any) -> None:
    path = repository.root / "deploy" / "kubernetes" / "base" / "deployment.yaml"
    pod = yaml.safe_load(path.read_text(encoding="utf-8"))["spec"]["template"]["spec"]
    (container,) = pod["containers"]
    given = {each["name"]: each.get("value") for each in container["env"]}
    drains = float(given["MOTIONGEN_DRAIN_WAIT_S"]) + float(given["MOTIONGEN_DRAIN_GRACE_S"])
    assert pod["terminationGracePeriodSeconds"] > drains + 10
    assert pod["securityContext"]["runAsNonRoot"]
    assert container["securityContext"]["readOnlyRootFilesystem"]


def test_image_runs_as_a_user_and_copies_existing_files(repository: Any) -> None:
    text = (repository.root / "deploy" / "Dockerfile").read_text(encoding="utf-8")
    for stage in re.split(r"^FROM ", text, flags=re.MULTILINE):
        users = re.findall(r"^USER (.+)$", stage, re.MULTILINE)
        assert users[-1:] in ([], ["10001"]), "programs run as a user other than root"
    sources = re.findall(r"^COPY (?!--from)(\S+) ", text, re.MULTILINE)
    ignored = (repository.root / ".dockerignore").read_text(encoding="utf-8")
    for source in sources:
        assert (repository.root / source).exists()
        assert f"!{source}\n" in ignored
    left_out = ignored.rpartition("!")[2].splitlines()
    assert "**/build" in left_out, "pip would pack old build files into the wheels"


@pytest.mark.parametrize("name", ["haproxy.cfg", "nginx.conf", "envoy.yaml"])
def test_every_proxy_routes_by_the_clients_key(repository: Any, name: str) -> None:
    from motiongen_client.channel import REPLICA_KEY

    text = (repository.root / "deploy" / "proxies" / name).read_text(encoding="utf-8")
    assert REPLICA_KEY in text or REPLICA_KEY.replace("-", "_") in text


def test_server_without_a_store_raises_no_store_alert() -> None:
    told = Metrics().registry.get_sample_value("motiongen_snapshot_store_up")
    assert told is not None
    assert math.isnan(told), "NaN, with which no comparison holds"
