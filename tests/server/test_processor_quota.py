"""The processor quota and its use, read from control groups of versions 1 and 2."""

import math
import os
from pathlib import Path

import pytest

from motiongen_server.processor_quota import quota_cores, quota_use


def membership(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "cgroup"
    path.write_text(text)
    return path


@pytest.mark.parametrize(
    ("told", "cores"),
    [
        ("70000 100000", 0.7),
        ("max 100000", math.inf),
        ("nonsense", math.inf),
        ("-1 100000", math.inf),
        ("50000 0", math.inf),
    ],
)
def test_version_2_quota_is_read(tmp_path: Path, told: str, cores: float) -> None:
    groups = tmp_path / "groups"
    groups.mkdir()
    (groups / "cpu.max").write_text(told)
    assert quota_cores(groups, membership(tmp_path, "0::/\n")) == cores


def test_smallest_quota_of_a_group_and_its_parents_counts(tmp_path: Path) -> None:
    groups = tmp_path / "groups"
    for path, told in (("", "max 100000"), ("pod", "150000 100000"), ("pod/one", "200000 100000")):
        (groups / path).mkdir(parents=True, exist_ok=True)
        (groups / path / "cpu.max").write_text(told)
    assert quota_cores(groups, membership(tmp_path, "0::/pod/one\n")) == 1.5


@pytest.mark.parametrize("said", [b"0::/pod\n\n", b"nonsense\n0::/pod\n", b"7:name=\xe9:/\xe9\n0::/pod\n"])
def test_membership_lines_that_name_no_group_are_skipped(tmp_path: Path, said: bytes) -> None:
    (tmp_path / "groups/pod").mkdir(parents=True)
    (tmp_path / "groups/pod/cpu.max").write_text("150000 100000")
    (tmp_path / "cgroup").write_bytes(said)
    assert quota_cores(tmp_path / "groups", tmp_path / "cgroup") == 1.5


def test_group_name_that_is_not_utf8_is_found(tmp_path: Path) -> None:
    name = os.fsdecode(b"groups/pod-\xe9")
    (tmp_path / name).mkdir(parents=True)
    (tmp_path / name / "cpu.max").write_text("150000 100000")
    (tmp_path / "cgroup").write_bytes(b"0::/pod-\xe9\n")
    assert quota_cores(tmp_path / "groups", tmp_path / "cgroup") == 1.5


def test_version_1_quota_is_read(tmp_path: Path) -> None:
    group = tmp_path / "groups/cpu/docker/1234"
    group.mkdir(parents=True)
    (group / "cpu.cfs_quota_us").write_text("50000\n")
    (group / "cpu.cfs_period_us").write_text("100000\n")
    told = membership(tmp_path, "9:memory:/docker/1234\n4:cpu,cpuacct:/docker/1234\n0::/\n")
    assert quota_cores(tmp_path / "groups", told) == 0.5


def test_path_that_is_not_visible_in_a_container_falls_back_to_the_root(tmp_path: Path) -> None:
    groups = tmp_path / "groups"
    groups.mkdir()
    (groups / "cpu.max").write_text("50000 100000")
    assert quota_cores(groups, membership(tmp_path, "0::/kubepods/pod7/abc\n")) == 0.5


def test_without_control_groups_there_is_no_quota(tmp_path: Path) -> None:
    assert quota_cores(tmp_path, tmp_path / "nothing") == math.inf


def write(path: Path, text: str) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text)


def test_version_2_use_is_counted_in_the_group_with_the_smallest_quota(tmp_path: Path) -> None:
    groups = tmp_path / "groups"
    write(groups / "cpu.max", "max 100000")
    write(groups / "pod/cpu.max", "150000 100000")
    write(groups / "pod/one/cpu.max", "200000 100000")
    write(groups / "pod/one/cpu.stat", "usage_usec 1\n")
    write(groups / "pod/cpu.stat", "usage_usec 3000000\nuser_usec 2000000\nsystem_usec 1000000\n")
    used_s = quota_use(groups, membership(tmp_path, "0::/pod/one\n"))
    assert used_s is not None
    assert used_s() == pytest.approx(2.0)  # "pod" has the smallest quota: 3 s of 1.5 processors
    write(groups / "pod/cpu.stat", "usage_usec 4500000\n")
    assert used_s() == pytest.approx(3.0)


def test_removed_usage_file_keeps_the_last_value(tmp_path: Path) -> None:
    groups = tmp_path / "groups"
    write(groups / "cpu.max", "50000 100000")
    write(groups / "cpu.stat", "usage_usec 1000000\n")
    used_s = quota_use(groups, membership(tmp_path, "0::/\n"))
    assert used_s is not None
    assert used_s() == pytest.approx(2.0)
    (groups / "cpu.stat").unlink()
    assert used_s() == pytest.approx(2.0)


@pytest.mark.parametrize("controllers", ["cpu,cpuacct", "cpu"])
def test_version_1_use_is_counted_in_joint_or_separate_hierarchies(tmp_path: Path, controllers: str) -> None:
    groups = tmp_path / "groups"
    for name, text in (
        ("cpu.cfs_quota_us", "50000\n"),
        ("cpu.cfs_period_us", "100000\n"),
        ("cpu.stat", "nr_periods 0\n"),
    ):
        write(groups / "cpu/docker/1234" / name, text)
    apart = controllers == "cpu"
    write(groups / ("cpuacct" if apart else "cpu") / "docker/1234/cpuacct.usage", "2000000000\n")
    lines = "4:cpu:/docker/1234\n3:cpuacct:/docker/1234\n0::/\n" if apart else "4:cpu,cpuacct:/docker/1234\n0::/\n"
    used_s = quota_use(groups, membership(tmp_path, lines))
    assert used_s is not None
    assert used_s() == pytest.approx(4.0)


def test_use_of_another_group_does_not_count(tmp_path: Path) -> None:
    groups = tmp_path / "groups"
    for name, text in (("cpu.cfs_quota_us", "50000\n"), ("cpu.cfs_period_us", "100000\n")):
        write(groups / "cpu/limited" / name, text)
    write(groups / "cpuacct/cpuacct.usage", "2000000000\n")
    assert quota_use(groups, membership(tmp_path, "4:cpu:/limited\n3:cpuacct:/\n")) is None


def test_process_in_the_root_groups_has_no_quota(tmp_path: Path) -> None:
    (tmp_path / "cpu").mkdir()
    told = membership(tmp_path, "4:cpu:/\n3:cpuacct:/\n0::/\n")
    assert quota_use(tmp_path, told) is None
    assert quota_cores(tmp_path, told) == math.inf


def test_without_a_quota_no_use_is_counted(tmp_path: Path) -> None:
    groups = tmp_path / "groups"
    write(groups / "cpu.max", "max 100000")
    write(groups / "cpu.stat", "usage_usec 1000000\n")
    assert quota_use(groups, membership(tmp_path, "0::/\n")) is None
    assert quota_use(tmp_path, tmp_path / "nothing") is None
