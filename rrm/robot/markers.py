"""ArUco markers: which dictionaries there are, what a picture shows of one, and the cube that bears five."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np

from rrm.errors import UnknownNameError

if TYPE_CHECKING:
    from rrm.envs.base import Doubles
    from rrm.types import Pixels

#: OpenCV's predefined dictionaries, by their names there.
DICTIONARIES: dict[str, int] = {name: getattr(cv2.aruco, name) for name in dir(cv2.aruco) if name.startswith("DICT_")}

#: Outward normal and upward direction of each face with a marker, in the cube's frame: the top, then the sides.
_FACES = (
    ((0, 0, 1), (0, 1, 0)),
    ((1, 0, 0), (0, 0, 1)), ((0, 1, 0), (0, 0, 1)), ((-1, 0, 0), (0, 0, 1)), ((0, -1, 0), (0, 0, 1)),
)  # fmt: skip
#: Of a marker or face, to the right and upwards in halves of its side: top left, top right, bottom right, bottom left.
_ROUND = np.array([[-1, 1], [1, 1], [1, -1], [-1, -1]], float)


def dictionary(name: str) -> Any:
    """The dictionary of this name; an `UnknownNameError`, which suggests the nearest, where OpenCV has none."""
    if name not in DICTIONARIES:
        raise UnknownNameError("marker dictionary", name, DICTIONARIES)
    return cv2.aruco.getPredefinedDictionary(DICTIONARIES[name])


def grey(picture: Pixels) -> Pixels:
    """A picture, RGB [H, W, 3] or grey [H, W], as grey."""
    return picture if picture.ndim == 2 else cv2.cvtColor(picture, cv2.COLOR_RGB2GRAY)


@cache
def _detector(name: str) -> Any:
    parameters = cv2.aruco.DetectorParameters()
    # Lines fitted to a marker's edges: a third of the error of CORNER_REFINE_SUBPIX, which draws corners inwards.
    parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_APRILTAG
    parameters.aprilTagMinWhiteBlackDiff = 30  # of 255: lines are not looked for in noise, which takes 60 ms
    parameters.perspectiveRemovePixelPerCell = 8  # with the next: small and blurred markers are read as well
    parameters.perspectiveRemoveIgnoredMarginPerCell = 0.3
    return cv2.aruco.ArucoDetector(dictionary(name), parameters)


def detect(picture: Pixels, name: str) -> dict[int, Doubles]:
    """Corners [4, 2] in pixels of every marker of a dictionary, by number; what is there twice is nobody's."""
    corners, numbers, _ = _detector(name).detectMarkers(grey(picture))
    found = [int(number) for number in np.ravel(numbers)] if numbers is not None else []
    # That refinement counts from the corner of the first pixel, everything else from its middle.
    seen = ((number, quad.reshape(4, 2) - 0.5) for number, quad in zip(found, corners, strict=True))
    return {number: quad for number, quad in seen if found.count(number) == 1}


def others(picture: Pixels, name: str) -> str:
    """`; it shows markers of DICT_...` where there are some of another dictionary and none of `name`; else nothing."""
    if detect(picture, name):
        return ""
    counts = {other: len(detect(picture, other)) for other in DICTIONARIES if other != name}
    # The smaller ones are part of the larger: DICT_4X4_50 of DICT_4X4_100.
    most = max(counts, key=lambda other: (counts[other], -len(dictionary(other).bytesList)))
    return f"; it shows markers of {most}" if counts[most] else ""


@dataclass(frozen=True, kw_only=True)
class MarkedCube:
    """A cube with one marker on its top (`first`) and on its sides: +x, +y, -x and -y, upright, numbered on from it.

    An `UnknownNameError` where OpenCV has no such dictionary.
    """

    size: float = 0.05  #: of an edge, metres
    marker: float = 0.04  #: of a marker's edge, black border included, metres
    dictionary: str = "DICT_4X4_50"
    first: int = 0

    def __post_init__(self) -> None:
        dictionary(self.dictionary)

    def corners(self) -> dict[int, Doubles]:
        """Corners [4, 3] of each marker by number, in detection's order, metres from the cube's centre."""
        return {self.first + at: face for at, face in enumerate(_quads(self.size, self.marker))}

    def atlas(self, pixels: int = 256) -> Pixels:
        """The faces side by side as they are printed, top first, and a white one: grey [pixels, 6 * pixels]."""
        inner = round(pixels * self.marker / self.size)
        edge = (pixels - inner) // 2
        faces = [np.full((pixels, pixels), 255, np.uint8) for _ in range(len(_FACES) + 1)]
        for at, face in enumerate(faces[:-1]):
            marker = cv2.aruco.generateImageMarker(dictionary(self.dictionary), self.first + at, inner)
            face[edge : edge + inner, edge : edge + inner] = marker
        return np.hstack(faces)

    def write(self, folder: Path) -> tuple[Path, Path]:
        """`cube.obj`, of side 1, whose faces look up their part of the atlas, and `cube.png`, the atlas. The bottom is
        white.
        """
        mesh, texture = folder / "cube.obj", folder / "cube.png"
        cv2.imwrite(str(texture), cv2.cvtColor(self.atlas(), cv2.COLOR_GRAY2BGR))
        quads = _quads(1.0, 1.0)
        quads.append(quads[0][::-1] * (1, 1, -1))
        lines: list[str] = []
        for at, quad in enumerate(quads):
            around = (_ROUND + 1) / 2 * (1 / len(quads), 1) + (at / len(quads), 0)
            normal = np.cross(quad[1] - quad[0], quad[0] - quad[3])
            lines += ["v {} {} {}".format(*corner) for corner in quad]
            lines += ["vt {} {}".format(*corner) for corner in around]
            lines += ["vn {} {} {}".format(*(normal / np.linalg.norm(normal)))]
            for three in ((4, 3, 2), (4, 2, 1)):
                lines.append("f " + " ".join(f"{4 * at + k}/{4 * at + k}/{at + 1}" for k in three))
        mesh.write_text("\n".join(lines) + "\n")
        return mesh, texture


def _quads(size: float, edge: float) -> list[Doubles]:
    """Corners [4, 3] of a square of this edge on each face, clockwise from the top left as one looks at it."""
    quads = []
    for normal, up in np.array(_FACES, float):
        plane = np.array([np.cross(up, normal), up])
        quads.append(normal * size / 2 + _ROUND @ plane * edge / 2)
    return quads
