"""From pictures of a ChArUco board to calibrated cameras, and the file that holds them."""

from __future__ import annotations

import hashlib
import json
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import cv2
import numpy as np
from pydantic import ValidationError

from rrm.config import ConfigSection, Count, Positive
from rrm.errors import CalibrationError
from rrm.files import read_bounded, write_atomically
from rrm.robot.camera import Camera, placed, rigid
from rrm.robot.markers import dictionary, others

if TYPE_CHECKING:
    from rrm.envs.base import Doubles
    from rrm.types import Pixels

#: The picture that shows the board where it lies in the robot's base frame; all others may show it anywhere.
BASE = "base"
_KINDS = (".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff", ".webp")
_LARGEST = 100_000_000  # bytes of a picture
_LARGEST_FILE = 1_000_000  # bytes of a calibration

#: Pictures with the board in them, corners in each of these, and degrees of tilt between some two of them.
FEWEST_PICTURES, FEWEST_CORNERS, LEAST_TILT = 6, 8, 15


class Board(ConfigSection):
    """A ChArUco board as `cv2.aruco.CharucoBoard` prints it. Its frame: origin at the top left corner of the print, x
    to the right, y down, z into the paper, metres.
    """

    columns: Count = 7  #: squares
    rows: Count = 5
    square: Positive = 0.055  #: of an edge, metres, measured on the print: of a sheet of A3
    marker: Positive = 0.041  #: of a marker's edge, metres
    dictionary: str = "DICT_4X4_50"

    @cached_property
    def _pattern(self) -> Any:
        marks = dictionary(self.dictionary)
        if min(self.columns, self.rows) < 2 or self.marker >= self.square:
            raise CalibrationError(
                f"there is no board of {self.columns} x {self.rows} squares of {self.square:g} m with markers of "
                f"{self.marker:g} m: it has at least 2 x 2, and a marker fits into a square"
            )
        return cv2.aruco.CharucoBoard((self.columns, self.rows), self.square, self.marker, marks)

    @property
    def words(self) -> str:
        """For a message."""
        return f"board of {self.columns} x {self.rows} squares with markers of {self.dictionary}"

    def drawn(self, pixels: int) -> Pixels:
        """The print, grey, squares of this many pixels."""
        picture: Pixels = self._pattern.generateImage((self.columns * pixels, self.rows * pixels))
        return picture

    def found(self, picture: Pixels) -> tuple[Doubles, Doubles] | None:
        """Corners of squares in a grey picture: on the board [n, 3] metres, and in pixels [n, 2]; None for too few."""
        detector = cv2.aruco.CharucoDetector(self._pattern)
        corners, numbers, _, _ = detector.detectBoard(picture)
        if numbers is None or len(numbers) < FEWEST_CORNERS:
            return None
        onboard, pixels = self._pattern.matchImagePoints(corners, numbers)
        return np.array(onboard, float).reshape(-1, 3), np.array(pixels, float).reshape(-1, 2)


class Placement(NamedTuple):
    """Where the board lies on the table, print up: its top left corner, and the direction of its rows."""

    x: float  #: metres, in the base frame
    y: float
    z: float
    yaw: float  #: radians from the base's x axis to the print's rightward direction

    @property
    def matrix(self) -> Doubles:
        """The board's frame into the base frame, [4, 4]."""
        turned = rigid((0.0, 0.0, self.yaw), (self.x, self.y, self.z))
        return turned * (1.0, -1.0, -1.0, 1.0)


class Calibration(ConfigSection):
    """What the file holds."""

    board: Board
    cameras: dict[str, Camera]

    @property
    def digest(self) -> str:
        """Sixteen hex digits that stand for all of it."""
        return hashlib.sha256(json.dumps(self.model_dump(mode="json"), sort_keys=True).encode()).hexdigest()[:16]

    def save(self, path: Path) -> None:
        """Write it as JSON."""
        write_atomically(path, self.model_dump_json(indent=1).encode() + b"\n")


def load(path: Path) -> Calibration:
    """The calibration in a file; a `CalibrationError` where there is none."""
    try:
        return Calibration.model_validate_json(read_bounded(path, _LARGEST_FILE))
    except OSError as error:
        problem = error.strerror or str(error)
    except ValidationError as error:
        first = error.errors()[0]
        problem = f"{'.'.join(map(str, first['loc'])) or 'it'}: {first['msg']}"
    raise CalibrationError(
        f"{path} is no calibration: {problem}; `rrmctl deploy calibrate --help` says how to make one"
    )


def read_pictures(folder: Path) -> dict[str, Pixels]:
    """The pictures in a folder by their names without ending, grey; a `CalibrationError` for one that is none."""
    pictures = {}
    try:
        for path in sorted(path for path in folder.iterdir() if path.suffix.lower() in _KINDS):
            picture = cv2.imdecode(np.frombuffer(read_bounded(path, _LARGEST), np.uint8), cv2.IMREAD_GRAYSCALE)
            if picture is None:
                raise CalibrationError(f"{path} is not a picture: take it out of the folder, or take it anew")
            pictures[path.stem] = picture
    except OSError as error:
        raise CalibrationError(f"{error.filename or folder}: {error.strerror}") from None
    except cv2.error:
        raise CalibrationError(f"{path} is empty or damaged: take it out of the folder, or take it anew") from None
    if BASE not in pictures:
        raise CalibrationError(
            f"{folder} has {len(pictures)} pictures and none named {BASE}.png (or .jpg): the one of the board in its "
            "place on the table"
        )
    return pictures


def calibrate(pictures: dict[str, Pixels], board: Board, placement: Placement, *, name: str = "the camera") -> Camera:
    """The camera that took these pictures, grey, by name; that of the board in its place is `BASE`.

    Raises:
        CalibrationError: pictures of several sizes, too few that show the board, or too alike; the message says which.
    """
    height, width = pictures[BASE].shape
    if odd := [key for key, picture in pictures.items() if picture.shape != (height, width)]:
        sizes = ", ".join(f"{key} {pictures[key].shape[1]} x {pictures[key].shape[0]}" for key in odd[:3])
        raise CalibrationError(
            f"{name}: {BASE} is {width} x {height} and {sizes}: pictures of one camera have one size"
        )
    seen = {key: corners for key, picture in pictures.items() if (corners := board.found(picture)) is not None}
    if len(seen) < FEWEST_PICTURES or BASE not in seen:
        lacking = f"{FEWEST_PICTURES} are needed" if len(seen) < FEWEST_PICTURES else f"not in {BASE}"
        missed = next((picture for key, picture in pictures.items() if key not in seen), pictures[BASE])
        raise CalibrationError(
            f"{name}: the {board.words} was found in {len(seen)} of {len(pictures)} pictures, {lacking}"
            f"{others(missed, board.dictionary) or ': is it sharp, well lit and wholly in view?'}"
        )
    cv2.setNumThreads(1)  # several add numbers up in any order: no two calibrations, and no two episodes, were equal
    onboard, pixels = ([np.float32(corners[at]) for corners in seen.values()] for at in (0, 1))
    _, matrix, distortion, turns, shifts, _, _, errors = cv2.calibrateCameraExtended(
        onboard, pixels, (width, height), None, None, flags=cv2.CALIB_FIX_K3
    )
    facing = np.array([cv2.Rodrigues(turn)[0][:, 2] for turn in turns])
    tilt = float(np.degrees(np.arccos(np.clip(facing @ facing.T, -1, 1).min())))
    if tilt < LEAST_TILT:
        raise CalibrationError(
            f"{name}: its {len(seen)} pictures of the board are too alike to tell how far it is away: no two of them "
            f"differ by {LEAST_TILT} degrees in its tilt"
        )
    base = list(seen).index(BASE)
    camera = Camera(
        width=width, height=height, focal=(matrix[0, 0], matrix[1, 1]), centre=(matrix[0, 2], matrix[1, 2]),
        distortion=tuple(distortion.ravel()[:5].tolist()), rotation=(0.0, 0.0, 0.0), translation=(0.0, 0.0, 0.0),
        pictures=len(seen), error_px=float(np.sqrt(np.mean(errors**2))), base_error_px=float(errors[base, 0]),
    )  # fmt: skip
    return placed(camera, rigid(turns[base], shifts[base]) @ np.linalg.inv(placement.matrix))


def calibrate_folders(folders: list[Path], board: Board, placement: Placement) -> Calibration:
    """The cameras of these folders, named as the folders are. Raises as `calibrate` and `read_pictures`."""
    names = [folder.resolve().name for folder in folders]
    if twice := next((name for name in names if names.count(name) > 1), None):
        raise CalibrationError(f'two folders are named "{twice}": a camera is called as its folder is')
    cameras = {
        name: calibrate(read_pictures(folder), board, placement, name=name)
        for name, folder in zip(names, folders, strict=True)
    }
    return Calibration(board=board, cameras=cameras)
