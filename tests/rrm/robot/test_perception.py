"""Where the cube is, by its markers; and what becomes of frames in which it is not seen."""

import cv2
import numpy as np
import pytest

from benchmarks import perception as benchmark
from rrm.envs.panda.physics import Pose
from rrm.errors import CalibrationError, PerceptionError
from rrm.robot.camera import looking
from rrm.robot.config import RigConfig
from rrm.robot.markers import MarkedCube, detect
from rrm.robot.perception import Gate, Tracker, check_cameras, locate, wrapped
from rrm.robot.pictures import Optics
from rrm.robot.setup import cameras, optics
from tests.robot import robot

CUBE = MarkedCube()
CLEAR = RigConfig(seed=1)
LENS = optics(CLEAR)
EYES = cameras(CLEAR)
BLANK = {name: np.full((480, 640, 3), 128, np.uint8) for name in EYES}

pytestmark = robot


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    from rrm.envs.panda.scene import Look, Scene

    mesh, texture = CUBE.write(tmp_path_factory.mktemp("cube"))
    scene = Scene(look=Look(mesh=mesh, texture=texture))
    yield scene
    scene.close()


@pytest.fixture(scope="module")
def see(scene):
    """What both cameras see of the cube at a pose, the hand aside or somewhere."""
    from rrm.robot.eye import photograph

    def see(x=0.5, y=0.0, z=0.025, yaw=0.3, hand=(0.4, 0.28, 0.3), optics=LENS, eyes=EYES):
        scene.place(hand, Pose((x, y, z), yaw), closed=False)
        rng = np.random.default_rng(0)
        return {name: photograph(scene, eye, optics, rng) for name, eye in eyes.items()}

    return see


def off(sight, x, y, z, yaw):
    """Millimetres and degrees between an estimate and the truth."""
    return 1e3 * np.linalg.norm(np.subtract(sight.position, (x, y, z))), abs(np.degrees(wrapped(sight.yaw - yaw)))


@pytest.mark.parametrize("seed", range(5))
def test_both_views_together(see, seed):
    """A millimetre and a degree with cameras that are known exactly; each marker of each view counts."""
    pose = np.random.default_rng(seed).uniform((0.44, -0.15, 0.025, -np.pi), (0.58, 0.15, 0.15, np.pi)).tolist()
    sight = locate(see(*pose), EYES, CUBE)
    millimetres, degrees = off(sight, *pose)
    assert (sight.views, sight.age) == (2, 0)
    assert 2 <= sight.markers <= 6
    assert sight.error_px < 1
    assert millimetres < 1
    assert degrees < 1


@pytest.mark.slow
def test_the_benchmark_measures_the_rig():
    """Ten poses on a calibrated rig, within what is asked of two cameras."""
    lines = benchmark.lines(10, (RigConfig(boards=8),))
    assert [line.met for line in lines if "two" in line.item] == [True] * 4
    assert all("of 10" in line.note for line in lines)


def test_one_view_is_enough(see):
    pictures = see(0.5, 0.05, 0.025, -2.0)
    sight = locate({"front": pictures["front"]}, EYES, CUBE)
    assert sight.views == 1
    assert off(sight, 0.5, 0.05, 0.025, -2.0)[0] < 15


def test_grey_pictures_do_as_well(see):
    pictures = see()
    grey = {name: cv2.cvtColor(picture, cv2.COLOR_RGB2GRAY) for name, picture in pictures.items()}
    assert locate(grey, EYES, CUBE) == locate(pictures, EYES, CUBE)


def test_a_hand_around_it_hides_not_all(see):
    """Markers on its sides are seen while the gripper is at the cube."""
    sight = locate(see(0.5, 0.0, 0.025, 0.1, hand=(0.5, 0.0, 0.04)), EYES, CUBE)
    assert off(sight, 0.5, 0.0, 0.025, 0.1)[0] < 3


def test_faces_are_told_apart(see):
    """Quarters of a turn are different yaws."""
    for yaw in (-1.4, 0.1, 1.7, 3.1):
        assert off(locate(see(yaw=yaw), EYES, CUBE), 0.5, 0.0, 0.025, yaw)[1] < 1


def test_nothing_there(see):
    """Neither in an empty picture nor where somebody else's markers are."""
    assert locate(BLANK, EYES, CUBE) is None
    assert locate(see(), EYES, MarkedCube(first=10)) is None
    assert locate({}, EYES, CUBE) is None


def test_what_is_there_twice_is_nobody_s():
    """Two cubes with one number cannot be told apart, so neither is believed."""
    face = np.hsplit(CUBE.atlas(100), 6)[0]
    assert list(detect(face, CUBE.dictionary)) == [0]
    assert detect(np.hstack((face, face)), CUBE.dictionary) == {}


def test_a_frame_without_the_cube_holds_the_last(see):
    """With its age, until one that counts comes; None before there was any."""
    tracker = Tracker(EYES, CUBE, patience=3)
    assert tracker.look(BLANK) is None
    seen = tracker.look(see())
    assert seen.age == 0
    assert [tracker.look(BLANK).age for _ in range(2)] == [1, 2]
    assert tracker.look(see()).age == 0
    assert tracker.look(BLANK).position == seen.position


def test_too_many_frames_without_it_are_an_error(see):
    """The message says why, and which markers are there instead."""
    tracker = Tracker(EYES, MarkedCube(dictionary="DICT_5X5_50"), patience=2)
    pictures = see()
    tracker.look(pictures)
    with pytest.raises(
        PerceptionError,
        match=r"lost for 2 frames: no camera sees a marker of DICT_5X5_50 .*; it shows markers of DICT_4X4",
    ):
        tracker.look(pictures)
    tracker.forget()
    assert tracker.look(pictures) is None


@pytest.mark.slow
def test_what_a_gate_refuses(see):
    """Too few markers, corners that are off, a jump: each is as if nothing had been seen, and is named in the end."""
    for gate, first, then, why in (
        (Gate(deviation=1e-5), see(), see(), r"view\(s\) tell its place to \d mm, 0 are allowed"),
        (Gate(error_px=0.01), see(), see(), "pixels off, 0.01 are allowed: is the calibration of these cameras"),
        (Gate(jump=0.01), see(), see(y=0.15), "it would have jumped by 0.15 m"),
    ):
        tracker = Tracker(EYES, CUBE, gate=gate, patience=2)
        with pytest.raises(PerceptionError, match=why):
            [tracker.look(pictures) for pictures in (first, then, then)]


def test_another_camera_s_calibration_is_found_out(see):
    """A camera that has moved by 10 cm since, or another with the same name: the corners do not fit."""
    x, y, z = np.linalg.inv(EYES["front"].pose)[:3, 3]
    moved = EYES | {"front": looking(EYES["front"], (x, y - 0.1, z), (0.5, 0.1, 0.05))}
    tracker = Tracker(moved, CUBE, patience=1)
    with pytest.raises(PerceptionError, match="is the calibration of these cameras, and nothing moved since"):
        tracker.look(see())


def test_cameras_that_are_not_the_calibration_s():
    check_cameras({"front": (640, 480)}, EYES)
    with pytest.raises(CalibrationError, match='no camera "top", it has front, side'):
        check_cameras({"front": (640, 480), "top": (640, 480)}, EYES)
    with pytest.raises(CalibrationError, match='"front" gives pictures of 1280 x 720, its calibration is of 640 x 480'):
        check_cameras({"front": (1280, 720)}, EYES)
    with pytest.raises(CalibrationError, match="gives pictures of 320 x 240"):
        Tracker(EYES, CUBE).look({"front": np.zeros((240, 320), np.uint8)})


def test_optics_leave_a_picture_alone_where_they_are_perfect():
    from rrm.robot.pictures import developed

    straight = EYES["front"].model_copy(update={"distortion": (0.0,) * 5})
    picture = np.random.default_rng(0).integers(0, 255, (480, 640, 3), np.uint8)
    assert np.array_equal(developed(picture, straight, Optics(), np.random.default_rng(0)), picture)
