"""Errors a person can act on: each says what was given, what is accepted and what to do."""

from __future__ import annotations

import difflib
from collections.abc import Iterable


def nearest(name: str, known: Iterable[str]) -> str:
    """`; did you mean "x"?` where a known name is near, else nothing."""
    near = difflib.get_close_matches(name, sorted(known), n=1)
    return f'; did you mean "{near[0]}"?' if near else ""


class RrmError(ValueError):
    """A mistake in what the library was given (configuration, prior, label, file), not a bug in the library."""


class ConfigError(RrmError):
    """A configuration that cannot be run."""


class UnknownNameError(RrmError):
    """A name that no table holds; the message suggests the nearest one."""

    def __init__(self, kind: str, name: str, known: Iterable[str]) -> None:
        names = sorted(known)
        super().__init__(f'unknown {kind} "{name}"{nearest(name, names)} known: {", ".join(names)}')


class PriorError(RrmError):
    """A prior that raised, or returned something other than one finite number."""


class RefusedCodeError(PriorError):
    """Code of a language model that goes beyond what such code may do; the message names the line."""


class DemosError(RrmError):
    """Demonstrations that cannot be used: another file, another task, or an expert that fails."""


class LabelError(RrmError):
    """Queries or answers of people that cannot be used: no such file, a damaged one, or those of another run."""


class MissingResultError(RrmError):
    """What an earlier run should have left behind is not there."""


class CheckpointError(RrmError):
    """A checkpoint that is missing or torn."""


class RenderingError(RrmError):
    """No OpenGL to draw pictures with; the message says what is missing and what to install."""


class CalibrationError(RrmError):
    """Cameras that cannot be calibrated from what is there, or a calibration that is not of these cameras."""


class PerceptionError(RrmError):
    """What a robot acts on is out of its cameras' sight."""


class RobotError(RrmError):
    """A robot, or what simulates one, that does not answer any more."""


class EpisodesError(RrmError):
    """A record of deployed episodes that cannot be gone on with: a damaged one, or one of something else."""


class NumericalError(RrmError):
    """A reward, action or loss that is not finite."""


class WaitingError(Exception):
    """Not a mistake: a run cannot go on before what it waits for has come from outside; the message says what."""
