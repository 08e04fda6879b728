"""The objects that kustomize makes of deploy/kubernetes: valid by Kubernetes' schemas, and as operators rely on."""

from __future__ import annotations

import re
import shutil
import subprocess
from typing import Any

import pytest
import yaml

from motiongen_server.config import parse_config
from tests.deploy.dashboard import REPOSITORY

pytestmark = pytest.mark.system
FOLDER = REPOSITORY / "deploy" / "kubernetes"
FOLDERS = ["base", "overlays/gpu", "overlays/autoscaling"]
VERSIONS = ["1.29", "1.31", "1.33"]


def built(folder: str) -> dict[str, Any]:
    """The objects that kustomize makes, by kind."""
    assert shutil.which("kubectl"), "kubectl 1.27 or later is not installed"
    done = subprocess.run(["kubectl", "kustomize", str(FOLDER / folder)], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    objects = list(yaml.safe_load_all(done.stdout))
    kinds = {each["kind"]: each for each in objects}
    assert len(kinds) == len(objects)
    return kinds


def container_of(kinds: dict[str, Any]) -> dict[str, Any]:
    (container,) = kinds["Deployment"]["spec"]["template"]["spec"]["containers"]
    return dict(container)


def devices_in(container: dict[str, Any]) -> list[str]:
    return [each["value"] for each in container["env"] if each["name"] == "MOTIONGEN_DEVICES"]


@pytest.mark.parametrize("version", VERSIONS)
@pytest.mark.parametrize("folder", FOLDERS)
def test_every_field_is_valid_in_kubernetes(folder: str, version: str) -> None:
    import kubernetes_validate

    for kind, each in built(folder).items():
        kubernetes_validate.validate(each, version, strict=True)
        assert each["metadata"]["namespace"] == "motiongen", kind


def test_unknown_field_is_found() -> None:
    import kubernetes_validate

    wrong = built("base")["Deployment"]
    container_of({"Deployment": wrong})["resources"]["limit"] = {}
    with pytest.raises(kubernetes_validate.ValidationError):
        kubernetes_validate.validate(wrong, VERSIONS[-1], strict=True)


@pytest.mark.parametrize("folder", FOLDERS)
def test_server_settings_are_valid_and_protected(folder: str) -> None:
    given = {each["name"]: each.get("value", "redis://store:6379/0") for each in container_of(built(folder))["env"]}
    image = {"MOTIONGEN_HOST": "0.0.0.0", "MOTIONGEN_OPS_HOST": "0.0.0.0"}  # as deploy/Dockerfile sets them
    config = parse_config([], image | given)
    assert not config.insecure
    assert config.tls_certificate
    assert config.tenants
    assert config.ops_tls


def test_number_of_engines_equals_the_requested_cores() -> None:
    container = container_of(built("base"))
    assert devices_in(container) == [f"cpu:{container['resources']['requests']['cpu']}"]


def test_files_named_by_settings_are_mounted() -> None:
    container = container_of(built("base"))
    mounts = [each["mountPath"] for each in container["volumeMounts"]]
    named = [each["value"] for each in container["env"] if str(each.get("value", "")).startswith("/")]
    assert named
    for path in named:
        assert any(path.startswith(f"{mount}/") for mount in mounts), path


def test_probes_use_https_and_the_paths_for_readiness_and_liveness() -> None:
    container = container_of(built("base"))
    for probe, path in (("startupProbe", "/readyz"), ("readinessProbe", "/readyz"), ("livenessProbe", "/livez")):
        assert container[probe]["httpGet"] == {"path": path, "port": "ops", "scheme": "HTTPS"}


def test_selectors_match_the_pods() -> None:
    kinds = built("base")
    labels = kinds["Deployment"]["spec"]["template"]["metadata"]["labels"].items()
    for selector in (
        kinds["Deployment"]["spec"]["selector"]["matchLabels"],
        kinds["Service"]["spec"]["selector"],
        kinds["PodDisruptionBudget"]["spec"]["selector"]["matchLabels"],
        kinds["NetworkPolicy"]["spec"]["podSelector"]["matchLabels"],
    ):
        assert selector.items() <= labels


def test_commented_rule_for_issuers_is_valid_once_uncommented() -> None:
    text = (FOLDER / "base" / "network.yaml").read_text(encoding="utf-8")
    taken_in = re.sub("(?m)^    #(?=-|  )", "    ", text)
    without, with_it = (yaml.safe_load(each)["spec"]["egress"] for each in (text, taken_in))
    assert with_it[:-1] == without
    assert with_it[-1]["ports"] == [{"port": 443}]
    assert "169.254.0.0/16" in with_it[-1]["to"][0]["ipBlock"]["except"], "where cloud machines get their credentials"


def test_overlays_change_image_devices_and_scaling() -> None:
    gpu = container_of(built("overlays/gpu"))
    assert gpu["image"] == "motiongen-server:cuda"
    assert gpu["resources"]["limits"]["nvidia.com/gpu"] == 1
    assert devices_in(gpu) == ["cuda:all"]
    scaled = built("overlays/autoscaling")
    assert "replicas" not in scaled["Deployment"]["spec"], "two objects would set the number of servers"
    scaler = scaled["HorizontalPodAutoscaler"]["spec"]
    assert scaler["scaleTargetRef"]["name"] == scaled["Deployment"]["metadata"]["name"]
    (metric,) = scaler["metrics"]
    assert metric["pods"]["metric"]["name"] == "motiongen_used_share"
    assert metric["pods"]["target"]["averageValue"] == "650m"
