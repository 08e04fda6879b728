"""The images of deploy/Dockerfile, built with buildah and run in a chroot: no daemon or container engine is needed.

The Dockerfile's base image would come from a registry; here one is made from Debian's packages instead. Layers are kept
in out/images, so that a second run builds only what has changed. Needs root, for mounts and users.
"""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from tests.deploy.dashboard import REPOSITORY

KEPT = REPOSITORY / "out" / "images"
BASE = "localhost/debian-python"
PACKAGES = "python3,python3-venv,python-is-python3,ca-certificates"
PROGRAMS = {"buildah": "buildah", "mmdebstrap": "mmdebstrap", "unshare": "util-linux"}
AUTHORITIES = "/etc/ssl/certs/ca-certificates.crt"

# A private view of the image: its root read-only, /tmp and /run in memory, secrets as files in /run, user and group of
# the image, no capabilities, and no way to get one back.
ENTER = """
set -e
mount --bind "$IMAGE" "$ROOT" && mount -o remount,ro,bind "$ROOT"
mount -t tmpfs tmpfs "$ROOT/tmp" && chmod 1777 "$ROOT/tmp"
mount -t tmpfs tmpfs "$ROOT/run" && mkdir "$ROOT/run/secrets"
mount -t proc proc "$ROOT/proc" && mount --rbind /dev "$ROOT/dev"
if [ -n "$SECRETS" ]; then cp "$SECRETS"/* "$ROOT/run/secrets" && chmod 444 "$ROOT"/run/secrets/*; fi
user=$1; shift
exec chroot "$ROOT" setpriv --reuid "$user" --regid "$user" --clear-groups --no-new-privs --inh-caps=-all \
    --bounding-set=-all -- env -i "$@"
"""


class Images:
    """buildah with its own storage."""

    def __init__(self, kept: Path = KEPT) -> None:
        for program, package in PROGRAMS.items():
            assert shutil.which(program), f"{program} is not installed (apt-get install {package})"
        assert os.geteuid() == 0, "images must be run as root, for their users and mounts"
        self.kept = kept
        kept.mkdir(parents=True, exist_ok=True)

    def buildah(self, *arguments: str) -> str:
        """The output of a buildah command. Raises RuntimeError with the end of its log."""
        storage = ["--root", str(self.kept / "storage"), "--runroot", str(self.kept / "run")]
        done = subprocess.run(["buildah", *storage, *arguments], capture_output=True, text=True, cwd=REPOSITORY)
        if done.returncode:
            raise RuntimeError(f"buildah {' '.join(arguments)}: {done.stdout[-2000:]}{done.stderr[-4000:]}")
        return done.stdout.strip()

    def make_base(self) -> None:
        """Make an image of Debian with Python, if there is none yet."""
        if self.buildah("images", "--quiet", "--filter", f"reference={BASE}"):
            return
        archive = self.kept / "base.tar"
        subprocess.run(
            ["mmdebstrap", "--quiet", "--variant=minbase", f"--include={PACKAGES}", "bookworm", str(archive)],
            check=True,
        )
        container = self.buildah("from", "scratch")
        self.buildah("add", "--quiet", container, str(archive), "/")
        self.buildah("commit", "--quiet", "--rm", container, BASE)
        archive.unlink()

    def build(self, target: str) -> str:
        """Build a target of the Dockerfile and return its name. pip trusts the same authorities as this machine."""
        self.make_base()
        trust = self.kept / "pip.conf"
        trust.write_text("[global]\ncert = /run/authorities.pem\n", encoding="utf-8")
        name = f"motiongen-server:{target}"
        self.buildah(
            *("build", "--isolation", "chroot", "--network", "host", "--format", "docker", "--layers"),
            *("--file", "deploy/Dockerfile", "--target", target, "--tag", name, "--build-arg", f"BASE={BASE}"),
            *("--volume", f"{AUTHORITIES}:/run/authorities.pem:ro", "--volume", f"{trust}:/etc/pip.conf:ro", "."),
        )
        return name

    def config(self, name: str) -> dict[str, Any]:
        """The configuration of an image."""
        return dict(json.loads(self.buildah("inspect", "--type", "image", name))["Docker"]["config"])

    def mounted(self, name: str) -> Mounted:
        """Use as `with images.mounted(name) as image`."""
        return Mounted(self, name)


class Mounted:
    """An image's files, with its programs run as in its container."""

    def __init__(self, images: Images, name: str) -> None:
        self._images = images
        self.config = images.config(name)
        self._container = images.buildah("from", name)
        self.root = Path(images.buildah("mount", self._container))

    def __enter__(self) -> Mounted:
        return self

    def __exit__(self, *_: object) -> None:
        self._images.buildah("rm", self._container)

    def start(
        self, command: Sequence[str] = (), settings: Mapping[str, str] | None = None, secrets: Path | None = None
    ) -> subprocess.Popen[str]:
        """Run a command, by default the image's own, with the image's environment and these settings."""
        given = [*self.config["Env"], *(f"{name}={value}" for name, value in (settings or {}).items())]
        root = self._images.kept / "root"
        root.mkdir(exist_ok=True)
        return subprocess.Popen(
            [
                *("unshare", "--mount", "--pid", "--fork", "--kill-child", "--ipc"),
                *("sh", "-c", ENTER, "enter", self.config["User"], *given, *(command or self.config["Entrypoint"])),
            ],
            env={**os.environ, "IMAGE": str(self.root), "ROOT": str(root), "SECRETS": str(secrets or "")},
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
        )

    def run(self, command: Sequence[str] = (), settings: Mapping[str, str] | None = None) -> tuple[int, str]:
        """Exit code and output of a command that ends by itself."""
        with self.start(command, settings) as process:
            said, _ = process.communicate()
            return process.returncode, said


def tell(process: subprocess.Popen[str], number: signal.Signals) -> None:
    """Send a signal to the first process of the container, as a container engine does."""
    (inside,) = Path(f"/proc/{process.pid}/task/{process.pid}/children").read_text().split()
    os.kill(int(inside), number)
