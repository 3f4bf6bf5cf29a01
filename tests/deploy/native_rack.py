"""docker-compose.yml without containers: its commands, its environment, its files, as processes on loopback.

Only what a container would have of its own is put in other words: host names, ports, and where files are mounted.
Grafana is not among Debian's and PyPI's packages and is left out; PostgreSQL takes any password from loopback.
"""

from __future__ import annotations

import json
import re
import resource
import shutil
import signal
import subprocess
import sys
import time
import urllib.parse
import urllib.request
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Self

import psycopg
import yaml
from numba.core.caching import UserProvidedCacheLocator

from splitslam.stack.envoy import EnvoyProxy
from splitslam.stack.postgres import PostgresServer, binary
from splitslam.stack.process import StackProcess, free_port, wait_until
from tests import debian
from tests.conftest import ROOT
from tests.deploy import compose
from tests.deploy.dockerfile import Dockerfile

BIN = Path(sys.executable).parent
IMAGE = Dockerfile(ROOT / "deploy" / "docker" / "map_service.Dockerfile")
ENTRY = ROOT / "deploy" / "docker" / "entrypoint.sh"
_READY_S = 60.0


def in_other_words(text: str, words: Mapping[str, str]) -> str:
    """`text` with what is true in a container replaced by what is true here, the longest first."""
    longest_first = "|".join(map(re.escape, sorted(words, key=len, reverse=True)))
    return re.sub(longest_first, lambda found: words[found[0]], text)


def fill_kernels(folder: Path) -> float:
    """What building the image does: `map-service warm-up`, here into the checkout's own cache, copied to `folder`.

    The checkout's serves every other test as well, and compiling takes half a minute. Returns how many times longer
    than on a machine that has nothing else to do it took.
    """
    began_s, cpu_s = time.monotonic(), _children_cpu_s()
    for program in ("map-service", "edge-agent"):
        subprocess.run((BIN / program, "warm-up"), check=True, capture_output=True, cwd=ROOT, timeout=400)
    slower = (time.monotonic() - began_s) / (_children_cpu_s() - cpu_s)
    for cached in (ROOT / package for package in ("splitslam", "map_service")):
        for file in cached.rglob("__pycache__/*.nb[ic]"):
            place = UserProvidedCacheLocator.get_suitable_cache_subpath(str(file.parent.parent / "module.py"))
            (folder / place).mkdir(parents=True, exist_ok=True)
            shutil.copy2(file, folder / place)
    return max(1.0, slower)


def _children_cpu_s() -> float:
    usage = resource.getrusage(resource.RUSAGE_CHILDREN)
    return usage.ru_utime + usage.ru_stime


class MapService(StackProcess):
    """One replica, by the image's entry point, as compose starts it."""

    def __init__(self, name: str, folder: Path, words: Mapping[str, str], kernels: Path) -> None:
        super().__init__(name, folder / f"{name}.log")
        self.port, self.metrics_port = free_port(), free_port()
        own = {
            "0.0.0.0:50051": f"127.0.0.1:{self.port}",
            "0.0.0.0": "127.0.0.1",
            "/tmp/": f"{folder}/{name}-",
            IMAGE.environment()["SPLITSLAM_KERNELS"]: str(kernels),
        }
        kernel_settings = {
            k: v for k, v in IMAGE.environment().items() if k in ("SPLITSLAM_KERNELS", "NUMBA_CACHE_DIR")
        }
        said = {**kernel_settings, **compose.environment("map_service")}
        self._said = {key: in_other_words(value, {**words, **own}) for key, value in said.items()}
        self._said["SPLITSLAM_MAP__METRICS__PORT"] = str(self.metrics_port)  # in a container each has the same

    @property
    def address(self) -> str:
        return f"127.0.0.1:{self.port}"

    def start(self) -> None:
        program = [str(BIN / word) if word == "map-service" else word for word in IMAGE.command("ENTRYPOINT")[1:]]
        self.launch(self._with_environment((str(ENTRY), *program, *compose.SERVICES["map_service"]["command"])))

    def healthy(self) -> bool:
        """The image's HEALTHCHECK."""
        check = IMAGE.command("HEALTHCHECK")
        command = self._with_environment((str(BIN / check[0]), *check[1:]))
        return subprocess.run(command, capture_output=True, timeout=60).returncode == 0

    def _with_environment(self, command: Sequence[str]) -> tuple[str, ...]:
        return ("env", *(f"{key}={value}" for key, value in self._said.items()), *command)


class Envoy(EnvoyProxy):
    """By compose's command."""

    def launch(self, command: Sequence[str | Path]) -> None:
        binary, _, config, *_ = command
        words = {"envoy": str(binary), "/etc/envoy/envoy.yaml": str(config)}
        said: list[str] = compose.SERVICES["envoy"]["command"]
        super().launch([words.get(word, word) for word in said])

    def well(self) -> bool:
        """Compose's health check."""
        check = compose.SERVICES["envoy"]["healthcheck"]["test"][1:]
        command = [word.replace("9901", str(self.admin_port)) for word in check]
        return subprocess.run(command, capture_output=True, timeout=60).returncode == 0


class Prometheus(StackProcess):
    """By compose's command, with deploy/prometheus; the replicas by their ports instead of by one name."""

    def __init__(self, folder: Path, targets: Sequence[str]) -> None:
        super().__init__("prometheus", folder / "prometheus.log")
        self.port = free_port()
        self._config = folder / "prometheus"
        shutil.copytree(ROOT / compose.mounts("prometheus")["/etc/prometheus"], self._config)
        said = yaml.safe_load((self._config / "prometheus.yml").read_text())
        for job in said["scrape_configs"]:
            if job.pop("dns_sd_configs", None):
                job["static_configs"] = [{"targets": list(targets)}]
        (self._config / "prometheus.yml").write_text(yaml.safe_dump(said))
        self._data = folder / "metrics"

    def start(self) -> None:
        words = {"/etc/prometheus": str(self._config), "=/prometheus": f"={self._data}"}
        options = [in_other_words(word, words) for word in compose.SERVICES["prometheus"]["command"]]
        binary = debian.binary("prometheus", "prometheus")
        self.launch((binary, *options, f"--web.listen-address=127.0.0.1:{self.port}", "--log.level=warn"))

    def ask(self, expression: str) -> list[dict[str, Any]]:
        """The series of an expression now; none while it does not answer."""
        url = f"http://127.0.0.1:{self.port}/api/v1/query?{urllib.parse.urlencode({'query': expression})}"
        try:
            with urllib.request.urlopen(url, timeout=5.0) as page:
                return json.load(page)["data"]["result"]
        except OSError:
            return []


class NativeRack:
    """`with NativeRack(...) as rack:` robots connect to `rack.address`; nothing waits until all of it is healthy."""

    def __init__(self, folder: Path, tls: Path, kernels: Path, replicas: int = 3) -> None:
        """tls: what compose mounts as ./tls. kernels: as the image has them."""
        self.postgres = PostgresServer(folder)
        words = {"@postgres/": f"@127.0.0.1:{self.postgres.port}/", "/etc/splitslam/tls": str(tls / "service")}
        self.replicas = [MapService(f"map-{i}", folder, words, kernels) for i in range(1, replicas + 1)]
        self.envoy = Envoy(folder, tls=tls / "envoy")
        self.prometheus = Prometheus(folder, [f"127.0.0.1:{replica.metrics_port}" for replica in self.replicas])

    def __enter__(self) -> Self:
        """In compose's order: the service when the database is healthy, the proxy beside the service."""
        try:
            self.prometheus.start()
            self.postgres.start()
            database = compose.environment("postgres")["POSTGRES_DB"]
            with psycopg.connect(self.postgres.url.replace("+psycopg", ""), autocommit=True) as connection:
                connection.execute(f"CREATE DATABASE {database}".encode())
            wait_until(self.database_healthy, _READY_S, "compose's health check of postgres")
            for replica in self.replicas:
                replica.start()
            self.envoy.set_endpoints([replica.address for replica in self.replicas])
            self.envoy.start()
        except BaseException:
            self.close()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        for process in (*self.replicas, self.envoy, self.prometheus):
            process.kill()
        self.postgres.close()

    @property
    def address(self) -> str:
        return self.envoy.address

    @property
    def alive(self) -> bool:
        """All of it."""
        return all(process.alive for process in self._processes)

    def check_alive(self) -> None:
        """Raises StackError with the last words of what has ended."""
        for process in self._processes:
            process.check_alive()

    @property
    def _processes(self) -> tuple[StackProcess, ...]:
        return (self.postgres, *self.replicas, self.envoy, self.prometheus)

    def database_healthy(self) -> bool:
        """Compose's health check."""
        check = compose.SERVICES["postgres"]["healthcheck"]["test"][1:]
        command = (binary(check[0]), *check[1:], "-p", str(self.postgres.port))
        return subprocess.run(command, capture_output=True, timeout=60).returncode == 0

    def stop(self, replica: MapService) -> int | None:
        """As `docker stop` does: its signal, and SIGKILL after compose's grace."""
        number = signal.Signals[IMAGE.all("STOPSIGNAL")[0]]
        return replica.stop(float(compose.SERVICES["map_service"]["stop_grace_period"].removesuffix("s")), number)
