"""A small Ray for tests: a head and two nodes on this machine, on loopback, that end with their context."""

from __future__ import annotations

import contextlib
import os
import secrets
import signal
import socket
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from tests.cluster.slurm import until

#: The head has no core.
NODES = ("n1", "n2")

#: Ray takes 127.0.0.1 for a name of the machine's address outside.
_HOST = "127.0.0.2"


@dataclass
class Ray:
    """A running one."""

    folder: Path
    address: str
    environment: dict[str, str]
    cores: int

    def start_node(self, name: str, *options: str) -> None:
        """Start a node, or the head."""
        words = [
            sys.executable, "-m", "ray.scripts.scripts", "start", "--disable-usage-stats",
            "--object-store-memory=78643200", "--include-log-monitor=false",
            f"--node-ip-address={_HOST}", f"--node-name={name}",
        ]  # fmt: skip
        where = options or (f"--num-cpus={self.cores}", f"--address={self.address}")
        with (self.folder / "start.log").open("a") as log:
            subprocess.run([*words, *where], check=True, stdout=log, stderr=log, env=self.environment, cwd=self.folder)

    def kill_node(self, name: str) -> None:
        """As if its machine lost Ray; what it had started lives on."""
        named = [(pid, words) for pid, words in self._processes() if f"--node-name={name}" in words]
        (raylet,) = [pid for pid, words in named if words[0].endswith("/raylet")]
        os.kill(raylet, signal.SIGKILL)
        until(lambda: raylet not in dict(self._processes()))

    def end(self) -> None:
        """All of it."""
        for pid, _ in self._processes():
            with contextlib.suppress(ProcessLookupError):
                os.kill(pid, signal.SIGKILL)

    def _processes(self) -> Iterator[tuple[int, list[str]]]:
        """Number and command of each that knows the cluster's secret."""
        for entry in Path("/proc").glob("[0-9]*"):
            with contextlib.suppress(OSError):
                if self.environment["RAY_AUTH_TOKEN"].encode() in (entry / "environ").read_bytes():
                    yield int(entry.name), (entry / "cmdline").read_text(errors="replace").split("\0")


@contextlib.contextmanager
def ray(cores: int = 1) -> Iterator[Ray]:
    """Ray, on a port that was free; cores: of each node."""
    with tempfile.TemporaryDirectory(prefix="ray", ignore_cleanup_errors=True) as folder:  # short: sockets lie there
        with socket.socket() as probe:
            probe.bind((_HOST, 0))
            port = probe.getsockname()[1]
        secret = {"RAY_AUTH_MODE": "token", "RAY_AUTH_TOKEN": secrets.token_hex(32), "RAY_ADDRESS": f"{_HOST}:{port}"}
        running = Ray(Path(folder), secret["RAY_ADDRESS"], os.environ | secret, cores)
        try:
            running.start_node(
                "head", "--head", "--include-dashboard=false", f"--port={port}", "--num-cpus=0", f"--temp-dir={folder}"
            )
            for node in NODES:
                running.start_node(node)
            yield running
        finally:
            running.end()
