"""Which arithmetic a run's networks multiply in. Nothing here imports torch; `rrm.nets.precision` does the work."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Annotated, Literal

from pydantic import BeforeValidator

Precision = Literal["float32", "bfloat16"]

#: A setting that may also be "auto"; what is stored is what that meant on the machine that planned the run.
PrecisionSetting = Annotated[Precision, BeforeValidator(lambda value: native_precision() if value == "auto" else value)]


def extensions(cpuinfo: Path = Path("/proc/cpuinfo")) -> frozenset[str]:
    """The processor's instruction sets by the system's names; empty where the system does not tell."""
    try:
        text = cpuinfo.read_text(errors="replace")
    except OSError:
        return frozenset()
    lines = (line for line in text.splitlines() if line.startswith(("flags", "Features")))
    return frozenset(next(lines, "").partition(":")[2].split())


@cache
def native_precision() -> Precision:
    """bfloat16 where this machine's processor multiplies float32 numbers in it, which on x86 needs AMX."""
    return "bfloat16" if "amx_bf16" in extensions() else "float32"
