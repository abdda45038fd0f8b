"""What of the user's environment is heeded neither here nor in processes that we or a library start."""

from __future__ import annotations

import os
import sys
from collections.abc import Mapping

#: Libraries and Python would draw, compute, warn or fold lines otherwise; mujoco leaves its choice of renderer behind,
#: and a child with another choice refuses to start.
_IGNORED = frozenset({
    "MPLBACKEND", "NUMBA_DISABLE_JIT", "PYOPENGL_PLATFORM", "PYTHONOPTIMIZE", "PYTHONWARNINGS",
    "COLUMNS", "LINES", "TERMINAL_WIDTH",
})  # fmt: skip
#: Files that lie around are not modules; figures have settings of their own; what simulates loads no OpenGL.
_OURS = {"PYTHONSAFEPATH": "1", "MUJOCO_GL": "disabled", "MATPLOTLIBRC": os.devnull}

#: Keeps the user's MUJOCO_GL for whoever draws, see `rrm.rendering`.
WISH = "RRM_MUJOCO_GL"

#: Seconds that a fresh Python may take for a trial.
_PATIENCE_S = 120


def environment(base: Mapping[str, str] = os.environ) -> dict[str, str]:
    """Variables under which the same input gives the same output, whatever a shell or a notebook has set."""
    wish = base.get("MUJOCO_GL", _OURS["MUJOCO_GL"])
    kept = {WISH: wish} if wish != _OURS["MUJOCO_GL"] else {}
    return {name: value for name, value in base.items() if name not in _IGNORED} | kept | _OURS


def run_python(code: str, **variables: str) -> str:
    """What a fresh Python prints under `environment` and these variables; a `RuntimeError` says its last words where it
    does not run to its end.
    """
    import subprocess

    command = [sys.executable, "-W", "ignore", "-c", code]
    try:
        done = subprocess.run(
            command, env=environment() | variables, capture_output=True, text=True, timeout=_PATIENCE_S, check=False
        )
    except subprocess.TimeoutExpired:
        raise RuntimeError("gave no answer within two minutes") from None
    if done.returncode:
        raise RuntimeError((done.stderr.strip().splitlines() or [f"ended with code {done.returncode}"])[-1])
    return done.stdout
