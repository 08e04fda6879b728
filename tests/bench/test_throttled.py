"""CPU quotas: control groups, quotas in virtual time, and the options of the bench."""

from pathlib import Path

import pytest

from tests.bench.costed_runner import VirtualQuota
from tests.bench.cpu_quota import CpuQuota, NoQuota
from tests.bench.throttled import HEADER, parse


def group(root: Path) -> Path:
    (found,) = [path for path in root.iterdir() if path.is_dir() and path.name.startswith("motiongen-quota")]
    return found


def test_version_1_group_gets_the_quota(tmp_path: Path) -> None:
    (tmp_path / "cpu").mkdir()
    CpuQuota(0.7, root=tmp_path).__enter__()
    made = group(tmp_path / "cpu")
    assert (made / "cpu.cfs_quota_us").read_text() == "70000"
    assert (made / "cpu.cfs_period_us").read_text() == "100000"


def test_usage_gets_a_group_in_a_separate_hierarchy(tmp_path: Path) -> None:
    for name in ("cpu", "cpuacct"):
        (tmp_path / name).mkdir()
    CpuQuota(0.7, root=tmp_path).__enter__()
    assert group(tmp_path / "cpuacct").name == group(tmp_path / "cpu").name


def test_usage_in_the_quotas_hierarchy_needs_no_further_group(tmp_path: Path) -> None:
    (tmp_path / "cpu").mkdir()
    (tmp_path / "cpuacct").symlink_to(tmp_path / "cpu")
    CpuQuota(0.7, root=tmp_path).__enter__()
    assert group(tmp_path / "cpu").is_dir()


def test_version_2_group_gets_the_quota(tmp_path: Path) -> None:
    (tmp_path / "cgroup.controllers").write_text("cpuset cpu io")
    (tmp_path / "cgroup.subtree_control").write_text("io")
    CpuQuota(0.5, root=tmp_path).__enter__()
    assert (group(tmp_path) / "cpu.max").read_text() == "50000 100000"
    assert (tmp_path / "cgroup.subtree_control").read_text() == "+cpu"


def test_missing_control_groups_and_a_quota_of_0_raise_errors(tmp_path: Path) -> None:
    with pytest.raises(NoQuota, match="run as root"):
        CpuQuota(0.5, root=tmp_path / "nothing").__enter__()
    with pytest.raises(ValueError, match="0 cores"):
        CpuQuota(0)


def test_work_within_a_period_takes_no_longer() -> None:
    quota = VirtualQuota(0.5)
    assert quota.ends_at(10.0, 0.04) == pytest.approx(10.04)


def test_work_beyond_a_period_waits_for_the_next() -> None:
    quota = VirtualQuota(0.5)
    assert quota.ends_at(10.0, 0.06) == pytest.approx(10.11)
    assert quota.ends_at(10.11, 0.04) == pytest.approx(10.15)
    assert quota.ends_at(10.15, 0.001) == pytest.approx(10.201)


def test_long_work_takes_its_time_divided_by_the_quota() -> None:
    quota, now = VirtualQuota(0.7), 0.0
    for _ in range(1000):
        now = quota.ends_at(now, 0.013)
    assert now == pytest.approx(13.0 / 0.7, rel=0.01)


def test_every_quota_is_tried_with_one_engine_and_with_two() -> None:
    options = parse([])
    assert (options.cores, options.engines, options.scenario) == ([0.7, 1.0, 1.5], [1, 2], ["crowd"])
    assert parse(["--", "--precision", "float32"]).server == ["--precision", "float32"]
    assert len({line.count("|") for line in HEADER}) == 1
