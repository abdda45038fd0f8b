"""Cameras from pictures of a board: the numbers that come out, and what cannot be used."""

import cv2
import numpy as np
import pytest

from rrm.errors import CalibrationError, UnknownNameError
from rrm.robot.calibration import BASE, Board, Calibration, Placement, calibrate, calibrate_folders, load, read_pictures
from rrm.robot.camera import rigid
from rrm.robot.config import RigConfig
from rrm.robot.pictures import photograph
from rrm.robot.setup import board_pictures, calibration, cameras, optics

RIG = RigConfig(boards=8)
PLACEMENT = Placement(0.3, 0.14, 0.0, 0.0)


@pytest.fixture(scope="module")
def camera():
    return cameras(RIG)["front"]


@pytest.fixture(scope="module")
def pictures(camera):
    return board_pictures(RIG, camera, Board(), np.random.default_rng(0))


def test_a_camera_is_found_again(camera, pictures):
    """Through distortion, blur and noise: points of the workspace appear where they do, to a fraction of a pixel."""
    found = calibrate(pictures, Board(), PLACEMENT)
    points = np.random.default_rng(0).uniform((0.35, -0.2, 0.0), (0.65, 0.2, 0.2), (50, 3))
    assert np.linalg.norm(found.project(points) - camera.project(points), axis=1).max() < 0.5
    assert found.pictures == 9
    assert 0 < found.error_px < 0.3
    assert 0 < found.base_error_px < 0.5


def test_the_same_pictures_give_the_same_camera(pictures):
    """To the last digit, whatever OpenCV's threads do: episodes by it follow from their numbers."""
    cv2.setNumThreads(4)
    assert len({calibrate(pictures, Board(), PLACEMENT).model_dump_json() for _ in range(8)}) == 1


def test_the_board_lies_where_it_is_said_to_lie(camera, pictures):
    """Placed 10 cm along x and turned by a quarter about the vertical, the camera is found to stand so as well."""
    usual, turned = (calibrate(pictures, Board(), at) for at in (PLACEMENT, Placement(0.4, 0.14, 0.0, np.pi / 2)))
    corner = np.linalg.inv(PLACEMENT.matrix) @ np.linalg.inv(usual.pose) @ [0, 0, 0, 1]
    assert np.allclose(np.linalg.inv(turned.pose) @ [0, 0, 0, 1], Placement(0.4, 0.14, 0.0, np.pi / 2).matrix @ corner)
    eye = (np.linalg.inv(usual.pose) @ [0, 0, 0, 1])[:3]
    assert np.linalg.norm(eye - (np.linalg.inv(camera.pose) @ [0, 0, 0, 1])[:3]) < 0.005


def test_a_file_holds_what_was_found(tmp_path):
    """Written and read it is the same, and so is its digest; another number gives another digest."""
    made = calibration(RIG)
    made.save(tmp_path / "cameras.json")
    assert load(tmp_path / "cameras.json") == made
    assert load(tmp_path / "cameras.json").digest == made.digest
    left = made.cameras["front"].model_copy(update={"focal": (300.0, 300.0)})
    assert Calibration(board=made.board, cameras=made.cameras | {"front": left}).digest != made.digest


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (None, "No such file"),
        (b"", "Invalid JSON"),
        (b'{"board": {}, "cameras": {"front": {"width": 640}}}', r"cameras\.front\.height: Field required"),
        (b'{"board": {}, "cameras": {}, "more": 1}', "more: Extra inputs"),
    ],
)
def test_a_file_that_is_none(tmp_path, content, message):
    path = tmp_path / "cameras.json"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(CalibrationError, match=rf"cameras\.json is no calibration: .*{message}.*deploy calibrate"):
        load(path)


def without_board(pictures, count):
    """The pictures, `count` of them grey all over."""
    blank = list(pictures)[:count]
    return pictures | {name: np.full_like(pictures[name], 128) for name in blank}


def test_pictures_of_several_sizes(pictures):
    odd = pictures | {"board-03": np.zeros((240, 320), np.uint8)}
    with pytest.raises(CalibrationError, match="front: base is 640 x 480 and board-03 320 x 240"):
        calibrate(odd, Board(), PLACEMENT, name="front")


def test_a_board_that_is_not_found(pictures):
    """How many show it; what else may be wrong."""
    with pytest.raises(CalibrationError, match=r"7 x 5.* found in 5 of 9 pictures, 6 are needed: is it sharp"):
        calibrate(without_board(pictures, 4), Board(), PLACEMENT)
    assert calibrate(without_board(pictures, 3), Board(), PLACEMENT).pictures == 6
    with pytest.raises(CalibrationError, match="found in 8 of 9 pictures, not in base"):
        calibrate(pictures | {BASE: np.full((480, 640), 128, np.uint8)}, Board(), PLACEMENT)


def test_a_board_of_another_dictionary(pictures):
    """The one that the pictures do show is named."""
    with pytest.raises(CalibrationError, match=r"DICT_6X6_50 was found in 0 of 9 .*; it shows markers of DICT_4X4_50"):
        calibrate(pictures, Board(dictionary="DICT_6X6_50"), PLACEMENT)
    with pytest.raises(UnknownNameError, match='did you mean "DICT_4X4_50"'):
        calibrate(pictures, Board(dictionary="DICT_4X4_5O"), PLACEMENT)


def test_a_board_that_there_is_not(pictures):
    with pytest.raises(CalibrationError, match=r"markers of 0\.06 m: it has at least 2 x 2, and a marker fits"):
        calibrate(pictures, Board(marker=0.06), PLACEMENT)


def test_pictures_that_are_too_alike(camera):
    """Of a board that faces the camera in all of them: near and small, or far and large, who knows."""
    rng, board = np.random.default_rng(0), Board()
    poses = {name: rigid((0.0, 0.0, 0.0), (-0.18 - at / 1e3, -0.14, 0.5)) for at, name in enumerate((BASE, *"abcdef"))}
    pictures = {name: photograph(board, pose, camera, optics(RIG), rng) for name, pose in poses.items()}
    with pytest.raises(CalibrationError, match="its 7 pictures of the board are too alike to tell"):
        calibrate(pictures, board, PLACEMENT)


def test_a_folder(tmp_path, pictures):
    """Pictures are read whatever their kind, and other files are left alone."""
    folder = tmp_path / "front"
    folder.mkdir()
    for name, picture in pictures.items():
        cv2.imwrite(str(folder / f"{name}.{'jpg' if name == BASE else 'PNG'}"), picture)
    (folder / "notes.txt").write_text("of the board")
    assert set(read_pictures(folder)) == set(pictures)
    found = calibrate_folders([folder], Board(), PLACEMENT)
    assert list(found.cameras) == ["front"]
    other = tmp_path / "other" / "front"
    with pytest.raises(CalibrationError, match='two folders are named "front"'):
        calibrate_folders([folder, other], Board(), PLACEMENT)
    (folder / "base.jpg").unlink()
    with pytest.raises(CalibrationError, match=r"8 pictures and none named base\.png"):
        read_pictures(folder)
    for content in (b"not a picture", b""):
        (folder / "torn.png").write_bytes(content)
        with pytest.raises(CalibrationError, match=r"torn\.png is (not a picture|empty)"):
            read_pictures(folder)
    with pytest.raises(CalibrationError, match="nowhere: No such file"):
        read_pictures(tmp_path / "nowhere")
