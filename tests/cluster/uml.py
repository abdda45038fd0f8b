"""User-mode Linux: kernels of their own, whose root is this machine's, and which a network joins."""

from __future__ import annotations

import contextlib
import os
import select
import shutil
import signal
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.cluster.slurm import until

NEEDED = ("linux.uml", "uml_switch", "rpc.nfsd", "mount.nfs", "rpcbind", "modprobe")
_HERE = Path(__file__).parent
#: Of its last words where a processor has more registers than it knows of.
_TOO_WIDE = "ptrace set fp regs failed"


def missing() -> str | None:
    """Why there can be none here."""
    if os.geteuid() != 0:
        return "only root may be root of a user-mode Linux"
    if any(shutil.which(name) is None for name in NEEDED):
        return "no NFS: apt-get install user-mode-linux nfs-kernel-server kmod"
    return None


class Kernel:
    """A running one; its console is a conversation, a line each."""

    def __init__(self, folder: Path, name: str, words: tuple[str, ...], network: Path | None) -> None:
        Path("/lib/modules").mkdir(exist_ok=True)  # where the kernel's are mounted
        self._log, self._said = folder / f"{name}.log", folder / f"{name}.kernel"
        begin = folder / f"{name}.init"
        begin.write_text(f"#!/bin/sh\nexec /bin/bash {_HERE / 'kernel.sh'} {self._log} {' '.join(words)}\n")
        begin.chmod(0o755)
        (hears, told), (reads, says) = os.pipe(), os.pipe()
        with self._said.open("w") as said:
            self._process = subprocess.Popen(
                [
                    "linux.uml", "mem=1000M", "rootfstype=hostfs", "rw", f"init={begin}", f"uml_dir={folder}/",
                    "con=null", "con0=null,fd:1", f"con1=fd:{hears},fd:{says}",
                    *([f"eth0=daemon,,unix,{network}"] if network else []),
                ],
                stdin=subprocess.DEVNULL, stdout=said, stderr=said, pass_fds=[hears, says],
                env=os.environ | _preloaded(folder), start_new_session=True,
            )  # fmt: skip
        for descriptor in (hears, says):
            os.close(descriptor)
        self._told, self._reads = os.fdopen(told, "w"), os.fdopen(reads, "rb", buffering=0)

    def tell(self, line: str) -> None:
        """Write to its console."""
        self._told.write(f"{line}\n")
        self._told.flush()

    def said(self) -> str:
        """The next line of its console; an AssertionError where none comes within two minutes."""
        assert not self.silent(120.0), self.log()
        line = self._reads.readline().decode().strip()
        assert line, self.log()
        return line

    def silent(self, seconds: float) -> bool:
        """Wait; True where it says nothing meanwhile."""
        return not select.select([self._reads], [], [], seconds)[0]

    def log(self) -> str:
        """What its programs printed; where none began, what it said itself. Skips where it cannot start."""
        if _TOO_WIDE in self._said.read_text():
            pytest.skip("user-mode Linux does not start on this processor without gcc: apt-get install gcc")
        return (self._log if self._log.exists() else self._said).read_text()

    def wait(self) -> None:
        """Until it is switched off."""
        self._process.wait(timeout=540)

    def freeze(self) -> None:
        """As a machine that is suspended."""
        self._process.send_signal(signal.SIGSTOP)

    def thaw(self) -> None:
        """It goes on, without a memory of the time between."""
        self._process.send_signal(signal.SIGCONT)

    def end(self) -> None:
        """Cut its power, whatever it does."""
        with contextlib.suppress(ProcessLookupError):
            os.killpg(self._process.pid, signal.SIGKILL)
        self._process.wait()
        self._told.close()
        self._reads.close()


@contextlib.contextmanager
def kernel(folder: Path, name: str, *words: str, network: Path | None = None) -> Iterator[Kernel]:
    """One that is begun by `kernel.sh` with these words, for as long as the block lasts."""
    running = Kernel(folder, name, words, network)
    try:
        yield running
    finally:
        running.end()


@contextlib.contextmanager
def switch(folder: Path) -> Iterator[Path]:
    """A network that joins kernels and nothing else; its socket."""
    at = folder / "net"
    with subprocess.Popen(
        ["uml_switch", "-unix", at], stdin=subprocess.PIPE, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    ) as process:
        try:
            until(at.exists)
            yield at
        finally:
            process.kill()


def _preloaded(folder: Path) -> dict[str, str]:
    """What has it start on every processor, as far as it can be compiled here."""
    if shutil.which("gcc") is None:
        return {}
    library = folder / "xstate.so"
    subprocess.run(["gcc", "-O1", "-shared", "-fPIC", "-o", library, _HERE / "xstate.c"], check=True)
    return {"LD_PRELOAD": str(library)}
