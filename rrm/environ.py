"""What of the user's environment is heeded neither here nor in processes that we or a library start."""

from __future__ import annotations

import os
from collections.abc import Mapping

#: Libraries and Python would draw, compute, warn or fold lines otherwise; mujoco leaves its choice of renderer behind,
#: and a child with another choice refuses to start.
_IGNORED = frozenset({
    "MPLBACKEND", "NUMBA_DISABLE_JIT", "PYOPENGL_PLATFORM", "PYTHONOPTIMIZE", "PYTHONWARNINGS",
    "COLUMNS", "LINES", "TERMINAL_WIDTH",
})  # fmt: skip
#: Files that lie around are not modules; nothing of ours renders; figures have settings of their own.
_OURS = {"PYTHONSAFEPATH": "1", "MUJOCO_GL": "disabled", "MATPLOTLIBRC": os.devnull}


def environment(base: Mapping[str, str] = os.environ) -> dict[str, str]:
    """Variables under which the same input gives the same output, whatever a shell or a notebook has set."""
    return {name: value for name, value in base.items() if name not in _IGNORED} | _OURS
