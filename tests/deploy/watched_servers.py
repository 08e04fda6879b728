"""A real Prometheus with the configuration of deploy/prometheus that watches real servers."""

from __future__ import annotations

import json
import shutil
import subprocess
import urllib.error
import urllib.parse
import urllib.request
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import yaml

from tests.deploy.dashboard import REPOSITORY
from tests.scale.proxies import free_port
from tests.waiting import until

CONFIGURATION = REPOSITORY / "deploy" / "prometheus" / "scrape.yaml"


class Prometheus:
    """Use as `with Prometheus(folder, ports) as prometheus`. Only the servers and the interval are changed."""

    def __init__(
        self, folder: Path, ops_ports: Sequence[int], interval: str = "1s", configuration: Path = CONFIGURATION
    ) -> None:
        self._folder = folder
        self._port = free_port()
        self._targets = [f"localhost:{port}" for port in ops_ports]
        self._interval = interval
        self._configuration = configuration
        self._num_others = 0  # targets that are not servers
        self._process: subprocess.Popen[bytes] | None = None

    def __enter__(self) -> Prometheus:
        program = shutil.which("prometheus")
        assert program, "prometheus is not installed (apt-get install prometheus)"
        content = yaml.safe_load(self._configuration.read_text(encoding="utf-8"))
        content["global"].update(scrape_interval=self._interval, evaluation_interval=self._interval)
        content["rule_files"] = [str(CONFIGURATION.parent / name) for name in content["rule_files"]]
        servers, *others = content["scrape_configs"]
        servers["static_configs"] = [{"targets": self._targets}]
        self._num_others = sum(len(each["targets"]) for job in others for each in job["static_configs"])
        configuration = self._folder / "prometheus.yaml"
        configuration.write_text(yaml.safe_dump(content), encoding="utf-8")
        with (self._folder / "prometheus.log").open("ab") as log:
            self._process = subprocess.Popen(
                [
                    program,
                    f"--config.file={configuration}",
                    f"--storage.tsdb.path={self._folder / 'prometheus'}",
                    f"--web.listen-address=127.0.0.1:{self._port}",
                ],
                stdout=log,
                stderr=log,
            )
        try:
            until(self._sees_all)
        except BaseException:
            self.__exit__()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        if self._process is not None:
            self._process.terminate()
            self._process.wait()

    def _sees_all(self) -> bool:
        assert self._process is not None
        if self._process.poll() is not None:
            raise RuntimeError((self._folder / "prometheus.log").read_text(errors="replace")[-2000:])
        try:
            urllib.request.urlopen(f"http://127.0.0.1:{self._port}/-/ready", timeout=30).close()
        except OSError:  # it does not listen yet, or still reads what it has stored
            return False
        up = [each for each in self.query("up") if each["value"][1] == "1"]
        return len(up) == len(self._targets) + self._num_others

    def query(self, expression: str) -> list[dict[str, Any]]:
        """The series of an expression now. Raises ValueError with Prometheus' error."""
        return self._asked("query", query=expression)

    def query_range(self, expression: str, start: float, end: float, step_s: float) -> list[dict[str, Any]]:
        """The series of an expression between two times, seconds since 1970."""
        return self._asked("query_range", query=expression, start=str(start), end=str(end), step=str(step_s))

    def _asked(self, what: str, **parameters: str) -> list[dict[str, Any]]:
        query = urllib.parse.urlencode(parameters)
        try:
            with urllib.request.urlopen(f"http://127.0.0.1:{self._port}/api/v1/{what}?{query}", timeout=30) as answer:
                said = json.load(answer)
        except urllib.error.HTTPError as refused:
            raise ValueError(f"{parameters['query']}: {json.load(refused)['error']}") from refused
        return list(said["data"]["result"])
