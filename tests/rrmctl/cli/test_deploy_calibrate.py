"""`rrmctl deploy calibrate`: a file from folders of pictures, or one message."""

import cv2
import numpy as np
import pytest

from rrm.robot.calibration import Board, load
from rrm.robot.config import RigConfig
from rrm.robot.setup import board_pictures, cameras
from tests.rrmctl.cli.test_run import call

RIG = RigConfig(boards=8)
AT = ("--at", "0.30,0.14,0,0")


@pytest.fixture(scope="module")
def folders(tmp_path_factory):
    """Photographs of the board by the rig's two cameras."""
    root = tmp_path_factory.mktemp("photographs")
    for name, camera in cameras(RIG).items():
        (root / name).mkdir()
        for picture, pixels in board_pictures(RIG, camera, Board(), np.random.default_rng(0)).items():
            cv2.imwrite(str(root / name / f"{picture}.png"), pixels)
    return root


def test_two_cameras(folders, tmp_path):
    """Each is called as its folder; what was found is said, and the file holds it."""
    out = tmp_path / "cameras.json"
    result = call("deploy", "calibrate", folders / "front", folders / "side", "-o", out, *AT)
    assert result.exit_code == 0, result.output
    assert "front: 640 x 480, 9 pictures, reprojection error 0." in result.stdout
    assert load(out).digest in result.stdout
    for name, camera in cameras(RIG).items():
        point = np.array([[0.5, 0.0, 0.05]])
        assert np.linalg.norm(load(out).cameras[name].project(point) - camera.project(point)) < 0.5


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("--dictionary", "DICT_5X5_50"), "was found in 0 of 9 pictures"),
        (("--dictionary", "DICT_9"), 'unknown marker dictionary "DICT_9"'),
        (("--columns", "6"), "was found in"),
        (("--marker", "0.06"), "a marker fits into a square"),
        (("--square", "nan"), "square"),
        (("--at", "0.30,0.14,0"), "--at"),
        (("--at", "here"), "--at"),
        (("--at", "0,0,0,nan"), "--at"),
    ],
)
def test_what_cannot_be_calibrated_from(folders, tmp_path, options, message):
    """Exit code 2, one message, no file."""
    out = tmp_path / "cameras.json"
    result = call("deploy", "calibrate", folders / "front", "-o", out, *AT, *options)
    assert result.exit_code == 2, result.output
    assert message in result.stderr
    assert "Traceback" not in result.output
    assert not out.exists()


def test_a_place_that_takes_no_file(folders, tmp_path):
    result = call("deploy", "calibrate", folders / "front", "-o", tmp_path / "nowhere" / "cameras.json", *AT)
    assert result.exit_code == 2, result.output
    assert "nowhere" in result.stderr
    result = call("deploy", "calibrate", tmp_path / "none", "-o", tmp_path / "cameras.json", *AT)
    assert result.exit_code == 2, result.output
    assert "none" in result.stderr
