"""A small Slurm for tests: a controller and three nodes on this machine, on loopback, that ends with its context."""

from __future__ import annotations

import contextlib
import os
import shutil
import signal
import socket
import subprocess
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

#: Some memory and one card each; the cards are files.
NODES = ("n1", "n2", "n3")

_CONF = """
ClusterName=ci
SlurmctldHost={host}(127.0.0.1)
SlurmctldPort={port}
SlurmctldParameters=preempt_send_user_signal
CommunicationParameters=NoInAddrAny,NoCtldInAddrAny
SlurmUser=root
SlurmdUser=root
AuthType=auth/none
CredType=cred/none
AuthInfo=cred_expire=5
StateSaveLocation={folder}/state
SlurmdSpoolDir={folder}/spool/%n
SlurmctldPidFile={folder}/slurmctld.pid
SlurmdPidFile={folder}/slurmd-%n.pid
SlurmctldLogFile={folder}/log/slurmctld.log
SlurmdLogFile={folder}/log/slurmd-%n.log
ProctrackType=proctrack/linuxproc
TaskPlugin=task/none
JobAcctGatherType=jobacct_gather/none
AccountingStorageType=accounting_storage/none
JobCompType=jobcomp/none
MpiDefault=none
SwitchType=switch/none
ReturnToService=2
SchedulerParameters=sched_interval=1,bf_interval=1,sched_min_interval=0
SelectType=select/cons_tres
SelectTypeParameters=CR_Core_Memory
PreemptType=preempt/partition_prio
PreemptMode=REQUEUE
KillWait=30
MinJobAge=300
MaxArraySize={largest}
JobRequeue=1
SlurmdTimeout=10
GresTypes=gpu
"""
_NODE = "CPUs={cores} RealMemory=2000 Gres=gpu:1 State=UNKNOWN"
_PARTITIONS = """
PartitionName=main Nodes=ALL Default=YES PriorityTier=1 GraceTime=20 MaxTime=60 State=UP
PartitionName=high Nodes=ALL PriorityTier=10 PreemptMode=off MaxTime=60 State=UP
"""


@dataclass
class Slurm:
    """A running one."""

    folder: Path
    environment: dict[str, str]

    def ask(self, *words: str) -> str:
        """What one of its programs prints."""
        return subprocess.run(words, env=self.environment, capture_output=True, text=True, check=True).stdout.strip()

    def queue(self) -> list[str]:
        """Task, state and node of each that is queued or runs."""
        return self.ask("squeue", "-h", "-r", "-o", "%i %T %N").splitlines()

    def start_node(self, node: str) -> None:
        """Start its daemon."""
        subprocess.run(["slurmd", "-N", node], env=self.environment, check=True)

    def kill_node(self, node: str) -> None:
        """As if it lost its daemon; its job lives on."""
        os.kill(int((self.folder / f"slurmd-{node}.pid").read_text()), signal.SIGKILL)

    def clear(self) -> None:
        """Cancel everything and wait for its end."""
        self.ask("scancel", f"--user={os.getuid()}")
        until(lambda: not self.queue())


def until(true: Callable[[], object], patience_s: float = 120.0) -> None:
    """Wait until something holds; an AssertionError where it does not."""
    deadline = time.monotonic() + patience_s
    while not true():
        assert time.monotonic() < deadline, "waited in vain"
        time.sleep(0.2)


@contextlib.contextmanager
def slurm(folder: Path, largest: int = 5, cores: int = 1) -> Iterator[Slurm]:
    """Slurm, with its files in this folder; `largest`: tasks of an array; `cores`: of each node."""
    for name in ("state", "spool", "log", "fake"):
        (folder / name).mkdir(parents=True)
    host = socket.gethostname().partition(".")[0]
    ports = _free_ports(1 + len(NODES))
    nodes = [
        f"NodeName={node} NodeHostname={host} NodeAddr=127.0.0.1 Port={port} {_NODE.format(cores=cores)}"
        for node, port in zip(NODES, ports[1:], strict=True)
    ]
    conf = _CONF.format(host=host, port=ports[0], folder=folder, largest=largest) + "\n".join(nodes) + _PARTITIONS
    (folder / "slurm.conf").write_text(conf)
    for node in NODES:
        subprocess.run(["mknod", folder / "fake" / node, "c", "1", "3"], check=True)
    cards = [f"NodeName={node} Name=gpu File={folder}/fake/{node}\n" for node in NODES]
    (folder / "gres.conf").write_text("".join(cards))
    running = Slurm(folder, os.environ | {"SLURM_CONF": str(folder / "slurm.conf")})
    try:
        subprocess.run(["slurmctld"], env=running.environment, check=True)
        for node in NODES:
            running.start_node(node)
        until(lambda: running.ask("sinfo", "-h", "-p", "main", "-t", "idle", "-o", "%D") == str(len(NODES)))
        yield running
        running.clear()
    finally:
        for file in folder.glob("*.pid"):
            with contextlib.suppress(ProcessLookupError, ValueError):
                os.kill(int(file.read_text()), signal.SIGTERM)


def missing() -> str | None:
    """Why there can be none here."""
    if shutil.which("slurmctld") is None:
        return "no Slurm: `make cluster` installs it"
    return None if os.geteuid() == 0 else "Slurm's daemons run as root"


def _free_ports(count: int) -> list[int]:
    with contextlib.ExitStack() as opened:
        sockets = [opened.enter_context(socket.socket()) for _ in range(count)]
        for each in sockets:
            each.bind(("127.0.0.1", 0))
        return [each.getsockname()[1] for each in sockets]
