"""`--devices`: the engines that it gives, their cores, and the load that they admit."""

from __future__ import annotations

import math

import pytest

from motiongen_server.devices import (
    ADMIT_LOAD,
    ADMIT_LOAD_QUOTA,
    ADMIT_LOAD_SCANT,
    ADMIT_LOAD_SHARED,
    ADMIT_LOAD_THROTTLED,
    KERNELS_KEPT,
    EngineDevice,
    admit_load_for,
    check_devices,
    count_cuda_devices,
    devices_of,
    spare_engines,
    usable_cores,
)
from motiongen_server.settings import SettingError


@pytest.mark.parametrize(
    ("given", "devices"),
    [
        ("cpu:2", [("cpu", 0, 1)] * 2),
        ("cpu:2x4", [("cpu", 0, 4)] * 2),
        ("cuda:1", [("cuda", 1, 1)]),
        ("cuda:0, cuda:2", [("cuda", 0, 1), ("cuda", 2, 1)]),
        ("cuda:all", [("cuda", 0, 1), ("cuda", 1, 1), ("cuda", 2, 1)]),
        ("cuda:0,cpu:1x2", [("cuda", 0, 1), ("cpu", 0, 2)]),
        ("cuda:2x3", [("cuda", 2, 1)] * 3),
        ("cuda:0x2,cuda:1", [("cuda", 0, 1), ("cuda", 0, 1), ("cuda", 1, 1)]),
        ("cuda:allx2", [("cuda", index, 1) for index in (0, 0, 1, 1, 2, 2)]),
        ("", [("cuda", 0, 1), ("cuda", 1, 1), ("cuda", 2, 1)]),
    ],
)
def test_devices_setting_gives_one_device_for_each_engine(given: str, devices: list[tuple[str, int, int]]) -> None:
    assert [(each.kind, each.index, each.threads) for each in devices_of(given, lambda: 3)] == devices


def test_without_cuda_each_core_gets_an_engine_up_to_eight(monkeypatch: pytest.MonkeyPatch) -> None:
    for cores, engines in ((1, 1), (4, 4), (64, 8)):
        monkeypatch.setattr("motiongen_server.devices.usable_cores", lambda cores=cores: cores)
        assert devices_of("", lambda: 0) == (EngineDevice("cpu", 0, 1),) * engines


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ("abacus", "it must be one of cuda:0"),
        ("cpu", "it must be one of"),
        ("cpu:0", "1 to 64 engines"),
        ("cpu:65", "1 to 64 engines"),
        ("cpu:1x0", "1 to 256"),
        ("cpu:2,", "it must be one of"),
        ("cuda:0,cuda:0", "each CUDA device once: cuda:0x2 has two"),
        ("cuda:1x2,cuda:1", "each CUDA device once"),
        ("cuda:1,cuda:3,cuda:3", "each CUDA device once: cuda:3x2 has two"),
        ("cuda:0x0", "1 to 64 engines"),
        ("cuda:0x65", "1 to 64 engines"),
        ("cpu:40,cpu:40", "80 engines"),
    ],
)
def test_invalid_devices_are_refused_with_what_is_allowed(given: str, said: str) -> None:
    with pytest.raises(SettingError, match=said):
        check_devices(given)


def test_missing_cuda_devices_are_reported() -> None:
    with pytest.raises(SettingError, match="finds no CUDA device"):
        devices_of("cuda:all", lambda: 0)


def test_engine_process_sees_only_its_own_device(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CUDA_VISIBLE_DEVICES", "4,7")
    assert EngineDevice("cuda", 1, 1).environment()["CUDA_VISIBLE_DEVICES"] == "7"
    monkeypatch.delenv("CUDA_VISIBLE_DEVICES")
    assert EngineDevice("cuda", 1, 1).environment()["CUDA_VISIBLE_DEVICES"] == "1"
    assert EngineDevice("cpu", 0, 3).environment() == {"OMP_NUM_THREADS": "3", **KERNELS_KEPT}


@pytest.mark.parametrize(
    ("visible", "given", "number"), [("2,3", "cuda:0,cuda:2", 2), ("", "cuda:0", 0), ("4,-1,5", "cuda:1", 1)]
)
def test_device_beyond_the_visible_ones_is_refused(
    visible: str, given: str, number: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("CUDA_VISIBLE_DEVICES", visible)
    with pytest.raises(SettingError, match=rf"cuda:{number}.* CUDA_VISIBLE_DEVICES shows"):
        devices_of(given, lambda: 0)
    with pytest.raises(SettingError, match="CUDA_VISIBLE_DEVICES shows"):
        EngineDevice("cuda", number, 1).environment()
    check_devices(given)  # the setting alone is valid


def test_visible_devices_keep_the_names_of_the_environment(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setenv("CUDA_VISIBLE_DEVICES", "2, GPU-5f")
    found = [device.environment()["CUDA_VISIBLE_DEVICES"] for device in devices_of("cuda:all", lambda: 2)]
    assert found == ["2", "GPU-5f"]


def test_kernel_cache_sizes_of_the_environment_are_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in KERNELS_KEPT:
        monkeypatch.setenv(name, "4096")
        assert EngineDevice("cpu", 0, 3).environment()[name] == "4096"


def test_container_quota_limits_the_usable_cores(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("os.sched_getaffinity", lambda pid: set(range(16)))
    for quota, cores in ((math.inf, 16), (2.5, 3), (0.5, 1), (64.0, 16)):
        monkeypatch.setattr("motiongen_server.devices.quota_cores", lambda quota=quota: quota)
        assert usable_cores() == cores


def test_engines_sharing_cores_admit_less_load(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("os.sched_getaffinity", lambda pid: {0, 1})
    monkeypatch.setattr("motiongen_server.devices.quota_cores", lambda: math.inf)
    for given in ("cpu:2", "cpu:1x2", "cpu:1,cuda:0", "cuda:0,cuda:1,cuda:2"):
        assert admit_load_for(devices_of(given, lambda: 3)) == ADMIT_LOAD
    for given in ("cpu:1x4", "cpu:1,cpu:1x2"):
        assert admit_load_for(devices_of(given, lambda: 0)) == ADMIT_LOAD_SHARED
    for given in ("cpu:3", "cpu:2x2", "cpu:2,cpu:1x1"):
        assert admit_load_for(devices_of(given, lambda: 0)) == ADMIT_LOAD, "the engines beyond the cores are spare"


@pytest.mark.parametrize(
    ("given", "quota", "spare"),
    [
        ("cpu:2", math.inf, (False, False)),
        ("cpu:3", math.inf, (False, False, True)),
        ("cpu:2x2", math.inf, (False, True)),
        ("cpu:1x2,cpu:1", math.inf, (False, True)),
        ("cpu:1x4,cpu:1", math.inf, (False, True)),
        ("cuda:0,cuda:1,cpu:3", math.inf, (False, False, False, False, True)),
        ("cuda:0,cuda:1,cuda:2", 1.0, (False, False, False)),
        ("cpu:2", 1.5, (False, False)),
        ("cpu:2", 1.0, (False, True)),
        ("cpu:3", 0.7, (False, True, True)),
    ],
)
def test_engines_without_a_core_are_spare(
    monkeypatch: pytest.MonkeyPatch, given: str, quota: float, spare: tuple[bool, ...]
) -> None:
    monkeypatch.setattr("os.sched_getaffinity", lambda pid: {0, 1})
    monkeypatch.setattr("motiongen_server.devices.quota_cores", lambda: quota)
    assert spare_engines(devices_of(given, lambda: 3)) == spare


def test_quota_without_a_usage_count_admits_less_load(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("os.sched_getaffinity", lambda pid: {0, 1})
    monkeypatch.setattr("motiongen_server.devices.quota_use", lambda: None)
    for quota, engines, load in (
        (1.5, 1, ADMIT_LOAD), (2.0, 1, ADMIT_LOAD), (8.0, 2, ADMIT_LOAD), (1.0, 1, ADMIT_LOAD_SHARED),
        (1.5, 2, ADMIT_LOAD_THROTTLED), (0.7, 1, ADMIT_LOAD_THROTTLED),
    ):  # fmt: skip
        monkeypatch.setattr("motiongen_server.devices.quota_cores", lambda quota=quota: quota)
        assert admit_load_for(devices_of(f"cpu:{engines}", lambda: 0)) == load


def test_quota_with_a_usage_count_needs_a_smaller_margin(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("os.sched_getaffinity", lambda pid: {0, 1})
    monkeypatch.setattr("motiongen_server.devices.quota_use", lambda: lambda: 0.0)
    for quota, engines, load in (
        (1.5, 1, ADMIT_LOAD), (2.0, 2, ADMIT_LOAD_QUOTA), (1.0, 1, ADMIT_LOAD_QUOTA), (1.5, 2, ADMIT_LOAD_SCANT),
        (0.7, 1, ADMIT_LOAD_SCANT),
        (1.0, 2, ADMIT_LOAD_QUOTA), (0.7, 2, ADMIT_LOAD_SCANT),
    ):  # fmt: skip
        monkeypatch.setattr("motiongen_server.devices.quota_cores", lambda quota=quota: quota)
        assert admit_load_for(devices_of(f"cpu:{engines}", lambda: 0)) == load


@pytest.mark.parametrize(
    ("probe", "why"),
    [
        ("import sys; sys.exit('libcudart is missing')", "exit code 1: libcudart is missing"),
        ("print('two')", "'two\\n'"),
    ],
)
def test_failed_cuda_probe_is_logged(
    probe: str, why: str, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr("motiongen_server.devices.Path.glob", lambda self, pattern: iter((self,)))
    monkeypatch.setattr("motiongen_server.devices._PROBE", probe)
    assert count_cuda_devices() == 0
    assert "so none is used" in caplog.text
    assert why in caplog.text


def test_without_a_driver_torch_is_not_probed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("motiongen_server.devices.Path.glob", lambda self, pattern: iter(()))
    monkeypatch.setattr("motiongen_server.devices.Path.exists", lambda self: False)
    monkeypatch.setattr("subprocess.run", None)
    assert count_cuda_devices() == 0
