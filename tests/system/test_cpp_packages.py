"""The C++ client as its users get it: installed, linked, loaded from C#, cross-compiled, and under sanitizers."""

from __future__ import annotations

import os
import shutil
import subprocess
from collections.abc import Sequence
from pathlib import Path

import pytest

from tests.client.fake_server import FakeServer
from tests.conftest import LiveServer
from tests.cpp import test_goodbye, test_lost_clients
from tests.cpp.building import SOURCE, build, run

pytestmark = [pytest.mark.system, pytest.mark.timeout(1500)]

CONSUMER = SOURCE / "tests" / "consumer"
UNIT_TESTS = ("core_tests", "client_parts_tests", "stream_tests")
RACE_FOUND = 66  # ThreadSanitizer's exit code
servers, server = test_goodbye.servers, test_lost_clients.server


def built() -> Path:
    """The build that the tests of tests/cpp use."""
    return build("test", "-DMOTIONGEN_TESTS=ON", "-DMOTIONGEN_EXAMPLES=ON")


@pytest.mark.parametrize("kind", ["static", "shared"])
def test_outside_project_finds_the_installed_library(kind: str, tmp_path: Path) -> None:
    prefix, consumer = tmp_path / "prefix", tmp_path / "consumer"
    folder = built() if kind == "static" else build("shared", "-DBUILD_SHARED_LIBS=ON")
    run("cmake", "--install", folder, "--prefix", prefix)
    shutil.copytree(CONSUMER, consumer)
    run("cmake", "-S", consumer, "-B", consumer / "build", "-G", "Ninja", f"-DCMAKE_PREFIX_PATH={prefix}")
    run("cmake", "--build", consumer / "build")
    assert run(consumer / "build" / "consumer") == "3 frames; INVALID_ARGUMENT\n"
    assert "host:port" in run(consumer / "build" / "consumer_c")
    by_pkg_config(prefix, consumer, shared=kind == "shared")


def by_pkg_config(prefix: Path, consumer: Path, shared: bool) -> None:
    (libraries,) = {path.parent for path in prefix.rglob("motiongen.pc")}
    environment = {**os.environ, "PKG_CONFIG_PATH": str(libraries), "LD_LIBRARY_PATH": str(libraries.parent)}
    static = [] if shared else ["--static"]
    flags = run("pkg-config", *static, "--cflags", "--libs", "motiongen", environment=environment).split()
    run("g++", "-std=c++17", "-fno-exceptions", consumer / "main.cpp", "-o", consumer / "by_pkg_config", *flags)
    assert "INVALID_ARGUMENT" in run(consumer / "by_pkg_config", environment=environment)
    flags = run("pkg-config", "--cflags", "--libs", "motiongen-c", environment=environment).split()
    run("gcc", "-std=c99", "-pedantic", "-Werror", consumer / "main.c", "-o", consumer / "c_by_pkg_config", *flags)
    assert "host:port" in run(consumer / "c_by_pkg_config", environment=environment)


def test_c_sharp_program_plays_a_character(live_server: LiveServer, tmp_path: Path) -> None:
    folder = built()
    run("mcs", f"-out:{tmp_path / 'Character.exe'}", SOURCE / "examples" / "csharp" / "Character.cs")
    environment = {**os.environ, "LD_LIBRARY_PATH": str(folder)}
    told = run("mono", tmp_path / "Character.exe", live_server.address, environment=environment)
    assert "the root is" in told
    assert "frame 10" in told


def test_core_compiles_for_windows(tmp_path: Path) -> None:
    compiler = "x86_64-w64-mingw32-g++-posix"
    settings = ["-DCMAKE_SYSTEM_NAME=Windows", f"-DCMAKE_CXX_COMPILER={compiler}", "-DMOTIONGEN_CLIENT=OFF"]
    settings.append("-DCMAKE_C_COMPILER=x86_64-w64-mingw32-gcc-posix")
    run("cmake", "-S", SOURCE, "-B", tmp_path, "-G", "Ninja", *settings)
    run("cmake", "--build", tmp_path)
    assert (tmp_path / "libmotiongen_core.a").is_file()


@pytest.mark.parametrize("sanitizer", ["address", "undefined", "thread"])
def test_sanitizers_find_nothing(
    sanitizer: str,
    live_server: LiveServer,
    servers: Sequence[FakeServer],
    server: FakeServer,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    settings = [f"-DMOTIONGEN_SANITIZE={sanitizer}", "-DMOTIONGEN_TESTS=ON"]
    programs = (*UNIT_TESTS, "told_events", "lost_clients", "planted_race")
    folder = build(f"sanitize-{sanitizer}", *settings, targets=programs) / "tests"
    options = f"ignore_noninstrumented_modules=1 suppressions={SOURCE / 'tests' / 'tsan.supp'}"
    leaks = f"suppressions={SOURCE / 'tests' / 'lsan.supp'}"
    monkeypatch.setenv("MOTIONGEN_ADDRESS", live_server.address)
    monkeypatch.setenv("TSAN_OPTIONS", options)
    monkeypatch.setenv("LSAN_OPTIONS", leaks)
    for program in UNIT_TESTS:
        subprocess.run([folder / program, "--gtest_brief=1"], check=True, cwd=tmp_path)
    planted = subprocess.run([folder / "planted_race"], stderr=subprocess.DEVNULL)
    assert planted.returncode == (RACE_FOUND if sanitizer == "thread" else 0), (
        "the planted race must be found, or races on gRPC's threads are not seen"
    )
    test_goodbye.test_unreachable_servers_of_a_goodbye_are_skipped_then_own_addresses_tried(folder.joinpath, servers)
    for way in test_lost_clients.WAYS:
        test_lost_clients.test_lost_call_is_not_used_after_it_is_destroyed(folder.joinpath, server, way)


def test_ten_thousand_connects_leave_no_memory_behind(live_server: LiveServer) -> None:
    folder = built()
    settled_kb, last_kb = map(int, run(folder / "tests" / "connects", live_server.address, "10000").split())
    print(f"resident memory: {settled_kb} kB after 2,000 connects, {last_kb} kB after 10,000")
    assert last_kb - settled_kb < 8192
