"""The quota of the processor, as control groups of both versions tell it."""

import math
from pathlib import Path

import pytest

from motiongen_server.processor_quota import quota_cores


def membership(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "cgroup"
    path.write_text(text)
    return path


@pytest.mark.parametrize(
    ("told", "cores"),
    [("70000 100000", 0.7), ("max 100000", math.inf), ("nonsense", math.inf), ("-1 100000", math.inf)],
)
def test_the_second_version(tmp_path: Path, told: str, cores: float) -> None:
    groups = tmp_path / "groups"
    groups.mkdir()
    (groups / "cpu.max").write_text(told)
    assert quota_cores(groups, membership(tmp_path, "0::/\n")) == cores


def test_the_least_of_a_group_and_of_those_above_counts(tmp_path: Path) -> None:
    groups = tmp_path / "groups"
    for path, told in (("", "max 100000"), ("pod", "150000 100000"), ("pod/one", "200000 100000")):
        (groups / path).mkdir(parents=True, exist_ok=True)
        (groups / path / "cpu.max").write_text(told)
    assert quota_cores(groups, membership(tmp_path, "0::/pod/one\n")) == 1.5


def test_the_first_version(tmp_path: Path) -> None:
    group = tmp_path / "groups/cpu/docker/1234"
    group.mkdir(parents=True)
    (group / "cpu.cfs_quota_us").write_text("50000\n")
    (group / "cpu.cfs_period_us").write_text("100000\n")
    told = membership(tmp_path, "9:memory:/docker/1234\n4:cpu,cpuacct:/docker/1234\n0::/\n")
    assert quota_cores(tmp_path / "groups", told) == 0.5


def test_a_container_is_told_a_path_that_it_does_not_see(tmp_path: Path) -> None:
    groups = tmp_path / "groups"
    groups.mkdir()
    (groups / "cpu.max").write_text("50000 100000")
    assert quota_cores(groups, membership(tmp_path, "0::/kubepods/pod7/abc\n")) == 0.5


def test_without_control_groups_there_is_none(tmp_path: Path) -> None:
    assert quota_cores(tmp_path, tmp_path / "nothing") == math.inf
