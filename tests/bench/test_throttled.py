"""Parts of a processor: the kernel's groups, the same in virtual time, and the line that comes of a run."""

from pathlib import Path

import pytest

from tests.bench.costed_runner import VirtualQuota
from tests.bench.cpu_quota import CpuQuota, NoQuota
from tests.bench.throttled import HEADER, parse


def group(root: Path) -> Path:
    (found,) = [path for path in root.iterdir() if path.is_dir() and path.name.startswith("motiongen-quota")]
    return found


def test_a_group_of_the_first_version(tmp_path: Path) -> None:
    (tmp_path / "cpu").mkdir()
    CpuQuota(0.7, root=tmp_path).__enter__()
    made = group(tmp_path / "cpu")
    assert (made / "cpu.cfs_quota_us").read_text() == "70000"
    assert (made / "cpu.cfs_period_us").read_text() == "100000"


def test_what_is_used_is_accounted_where_that_is_a_hierarchy_of_its_own(tmp_path: Path) -> None:
    for name in ("cpu", "cpuacct"):
        (tmp_path / name).mkdir()
    CpuQuota(0.7, root=tmp_path).__enter__()
    assert group(tmp_path / "cpuacct").name == group(tmp_path / "cpu").name


def test_accounts_that_are_kept_with_the_quota_need_no_group(tmp_path: Path) -> None:
    (tmp_path / "cpu").mkdir()
    (tmp_path / "cpuacct").symlink_to(tmp_path / "cpu")
    CpuQuota(0.7, root=tmp_path).__enter__()
    assert group(tmp_path / "cpu").is_dir()


def test_a_group_of_the_second_version(tmp_path: Path) -> None:
    (tmp_path / "cgroup.controllers").write_text("cpuset cpu io")
    (tmp_path / "cgroup.subtree_control").write_text("io")
    CpuQuota(0.5, root=tmp_path).__enter__()
    assert (group(tmp_path) / "cpu.max").read_text() == "50000 100000"
    assert (tmp_path / "cgroup.subtree_control").read_text() == "+cpu"


def test_where_no_group_can_be_made(tmp_path: Path) -> None:
    with pytest.raises(NoQuota, match="run as root"):
        CpuQuota(0.5, root=tmp_path / "nothing").__enter__()
    with pytest.raises(ValueError, match="0 cores"):
        CpuQuota(0)


def test_what_fits_into_a_period_takes_no_longer() -> None:
    quota = VirtualQuota(0.5)
    assert quota.ends_at(10.0, 0.04) == pytest.approx(10.04)


def test_what_does_not_fit_waits_for_the_next_period() -> None:
    quota = VirtualQuota(0.5)
    assert quota.ends_at(10.0, 0.06) == pytest.approx(10.11)
    assert quota.ends_at(10.11, 0.04) == pytest.approx(10.15)
    assert quota.ends_at(10.15, 0.001) == pytest.approx(10.201)


def test_over_a_long_time_a_part_of_a_core_is_that() -> None:
    quota, now = VirtualQuota(0.7), 0.0
    for _ in range(1000):
        now = quota.ends_at(now, 0.013)
    assert now == pytest.approx(13.0 / 0.7, rel=0.01)


def test_every_quota_is_tried_with_one_engine_and_with_two() -> None:
    options = parse([])
    assert (options.cores, options.engines, options.scenario) == ([0.7, 1.0, 1.5], [1, 2], ["crowd"])
    assert parse(["--", "--precision", "float32"]).server == ["--precision", "float32"]
    assert len({line.count("|") for line in HEADER}) == 1
