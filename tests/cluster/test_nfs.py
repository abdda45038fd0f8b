"""The tests of shared folders on NFS itself: NFSv3 without locks and NFSv4.2, in a kernel of their own."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = [pytest.mark.cluster, pytest.mark.slow]

NEEDED = ("linux.uml", "rpc.nfsd", "mount.nfs", "rpcbind", "modprobe")


@pytest.mark.skipif(os.geteuid() != 0, reason="only root may be root of that kernel")
@pytest.mark.skipif(
    any(shutil.which(name) is None for name in NEEDED),
    reason="no NFS: apt-get install user-mode-linux nfs-kernel-server kmod",
)
def test_a_run_has_one_owner_on_nfs(tmp_path: Path) -> None:
    """Races, frozen owners and living ones, on both."""
    Path("/lib/modules").mkdir(exist_ok=True)  # where the kernel's are mounted
    script, log = Path(__file__).with_name("nfs.sh"), tmp_path / "log"
    words = f"/bin/bash {script} {Path(__file__).parents[2]} {sys.executable} {log}"
    begin = tmp_path / "init"
    begin.write_text(f"#!/bin/sh\nexec {words}\n")
    begin.chmod(0o755)
    kernel = ["linux.uml", "mem=1000M", "rootfstype=hostfs", "rw", f"init={begin}", "con=null", "con0=fd:0,fd:1"]
    subprocess.run(kernel, stdin=subprocess.DEVNULL, capture_output=True, timeout=540, check=False)
    said = log.read_text()
    assert "local_lock=all" in said
    assert {"v3 passed", "v4 passed"} <= set(said.splitlines()), said
