"""What this machine offers: its processor and the cores this process may use."""

from __future__ import annotations

import math
import os
import platform
import re
from pathlib import Path


def cpu_model() -> str:
    """The processor's name as the system tells it, "unknown" where it does not."""
    info = Path("/proc/cpuinfo")
    text = info.read_text(errors="replace") if info.is_file() else ""
    named = re.search(r"^model name\s*:(.*)", text, re.MULTILINE)
    return named[1].strip() if named else platform.processor() or "unknown"


def usable_cores(quota: Path = Path("/sys/fs/cgroup/cpu.max")) -> int:
    """Cores this process may keep busy; batch systems and containers grant fewer than the machine has."""
    affinity = getattr(os, "sched_getaffinity", None)  # not on macOS
    cores = len(affinity(0)) if affinity is not None else os.cpu_count() or 1
    try:
        granted, period = quota.read_text().split()  # "max PERIOD" or "MICROSECONDS PERIOD"
    except (OSError, ValueError):
        return cores  # no control group, or none of version 2: nothing is limited this way
    return cores if granted == "max" else max(1, min(cores, math.floor(int(granted) / int(period))))


def extensions(cpuinfo: Path = Path("/proc/cpuinfo")) -> frozenset[str]:
    """The processor's instruction sets by the system's names; empty where the system does not tell."""
    try:
        text = cpuinfo.read_text(errors="replace")
    except OSError:
        return frozenset()
    lines = (line for line in text.splitlines() if line.startswith(("flags", "Features")))
    return frozenset(next(lines, "").partition(":")[2].split())
