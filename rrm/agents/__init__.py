"""Agents by name. No torch is imported here."""

#: Each is made with its section of the configuration, the task's sizes, the run's streams, and a precision.
AGENTS: dict[str, str] = {
    "sac": "rrm.agents.sac:Sac",
    "drqv2": "rrm.agents.drqv2:Drq",
    "drm": "rrm.agents.drm:Drm",
}
