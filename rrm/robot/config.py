"""Settings of deployments, and of the simulated workplace where they happen."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from rrm.config import ConfigSection, Count, NonNegative, Positive, Range, Weight


class RigConfig(ConfigSection):
    """What the rig is like. Every episode draws from the ranges, uniformly; in brackets what training has."""

    seed: NonNegative = 0  #: of the cameras, and of what episodes draw
    cube_mass: Range[Weight] = (0.07, 0.16)  #: kg (0.1)
    friction: Range[Weight] = (0.45, 0.75)  #: of the cube (0.6)
    latency: Range[NonNegative] = (1, 2)  #: commands until one takes effect (0)
    gain: Range[Weight] = (0.07, 0.12)  #: of the arm's motors (0.1)
    width: Annotated[int, Field(ge=160)] = 640  #: of pictures, pixels
    height: Annotated[int, Field(ge=120)] = 480
    blur: Weight = 0.7  #: pixels, standard deviation
    noise: Weight = 3.0  #: of 255, standard deviation
    bump_mm: Weight = 0.3  #: by which a camera has moved since it was calibrated, standard deviation along each axis
    bump_deg: Weight = 0.03  #: and turned
    boards: Count = 12  #: pictures of the board in the calibration, besides the one in its place
    speed: Positive = 0.4  #: m/s that the arm does not exceed, whatever it is told
    watchdog_s: Positive = 0.2  #: after which the arm stops where no command came
    dictionary: str = "DICT_4X4_50"  #: of the cube


class DeployConfig(ConfigSection):
    """Which policies of a run are kept, and how they are deployed afterwards (Tab. realiqm)."""

    #: Environment steps whose networks are kept; each is deployed. None: the run is not.
    checkpoints: Annotated[tuple[Count, ...], Field(strict=False)] = ()
    episodes: Count = 20  #: of each
    rig: RigConfig = RigConfig()
