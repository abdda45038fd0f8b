"""What an agent is told of a task before it is made: the sizes of what it sees and does."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

Quality = Literal["fast", "full"]  #: of pictures: without shadows, reflections and smooth edges, or with them


@dataclass(frozen=True)
class FrameSpace:
    """A camera's pictures, uint8 [height, width, channels], and how many of the newest an agent sees at once.

    What is stored and learned from is planar, [channels, height, width].
    """

    height: int
    width: int
    channels: int = 3
    stack: int = 3
    view: str = ""  #: which of the task's cameras
    quality: Quality = "fast"

    def __str__(self) -> str:
        size = " x ".join(map(str, self.planar))
        return f"{size} from {self.view or 'its camera'} ({self.quality}), {self.stack} at once"

    @property
    def planar(self) -> tuple[int, int, int]:
        """The shape of a stored picture."""
        return self.channels, self.height, self.width


@dataclass(frozen=True)
class Spaces:
    """What an agent is told of a task before it is made."""

    obs: int  #: length of the observation vector
    act: int  #: length of the action vector; every action lies in [-1, 1]
    frames: FrameSpace | None = None  #: None where the task has no camera
