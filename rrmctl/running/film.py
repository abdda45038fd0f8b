"""A film of an episode, for people: what the policy of a run does, and how that ends."""

from __future__ import annotations

import contextlib
import math
import os
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np

from rrm.envs import make
from rrm.envs.observer import Observer
from rrm.files import write_atomically
from rrm.robot.camera import rigid
from rrm.robot.deployment import rules_of
from rrm.robot.interface import PERIOD_S
from rrm.robot.markers import detect
from rrm.robot.perception import Sight, locate
from rrm.robot.rig import Rig
from rrm.robot.setup import marked_cube
from rrm.seeding import evaluation_seed
from rrm.training.deployments import Laboratory
from rrm.training.episodes import Policy, expert_policy, play
from rrmctl.errors import UserError
from rrmctl.running.config_file import load_run
from rrmctl.running.deployments import kept_policy, own_rig
from rrmctl.store.files import storing

if TYPE_CHECKING:
    from rrm.envs.panda.physics import Vector
    from rrm.robot.camera import Camera
    from rrm.robot.config import RigConfig
    from rrm.training.run_config import RunConfig
    from rrm.types import Pixels
    from rrmctl.store.layout import RunFolder

#: By the file's ending: what browsers play, and what players and slides do. OpenCV's wheels bring both encoders.
_CODECS = {".webm": "VP80", ".mp4": "mp4v"}
_LINE, _MARGIN, _FONT, _WHITE = 18, 6, cv2.FONT_HERSHEY_SIMPLEX, (235, 235, 235)  # pixels, and of the caption


def film(folder: RunFolder, path: Path, checkpoint: int | None, episode: int, *, cameras: bool) -> str:
    """Film an episode of the run's deterministic policy; what the film shows, in words.

    Args:
        folder: of the run.
        path: the film, of an ending in `_CODECS`.
        checkpoint: the step whose networks act; None: the last.
        episode: its number in that step's evaluation, or in its deployment.
        cameras: what the cameras of the simulated workplace see of it there.

    Raises:
        UserError: of this run, or at this place, there is no such film.
        ConfigError: the task is not one of an arm's.
        RenderingError: nothing draws here.
    """
    if (ending := path.suffix.lower()) not in _CODECS:
        raise UserError(f"{path}: a film's name ends in {' or '.join(_CODECS)}")
    config = load_run(folder)
    if cameras:
        rules_of(config.task)
    if cameras and config.action_repeat > 1:
        raise UserError(f"run {folder.id}: an arm is told what to do at every step; its action_repeat is not 1")
    step, networks = kept_policy(folder, config.steps, checkpoint)
    title = f"{config.task}, {config.method}, seed {config.seed}", f"episode {episode} after {step:,} steps"
    with storing(path):  # refused at once where it takes no file
        scratch = tempfile.TemporaryDirectory(dir=path.parent, prefix=f".{path.name}.")
    with scratch:
        reel = _Reel(Path(scratch.name) / f"film{ending}", title)
        if cameras:
            words = _deployed(reel, config, networks, episode, own_rig(folder))
        else:
            seed = evaluation_seed(config.seed, step, episode)
            words = _played(reel, config, expert_policy(config, networks), seed)
        data = reel.developed()
        with storing(path):
            write_atomically(path, data)
    return f"{title[1]}: {words}; {reel.pictures} pictures, in real time"


class _Reel:
    """The pictures of a film, each above a strip that says what it shows."""

    def __init__(self, path: Path, title: Sequence[str]) -> None:
        self._path, self._title = path, title
        self._writer: Any = None
        self.pictures = 0

    def add(self, picture: Pixels, line: str, rate: float) -> None:
        """Append a picture, RGB; `rate` of them a second."""
        frame = np.vstack((picture, _strip(picture.shape[1], (*self._title, line))))[..., ::-1]
        if self._writer is None:
            codec = cv2.VideoWriter.fourcc(*_CODECS[self._path.suffix])
            with _unheard():
                self._writer = cv2.VideoWriter(str(self._path), codec, rate, (frame.shape[1], frame.shape[0]))
        if not self._writer.isOpened():
            raise UserError(f"the OpenCV that is installed here writes no {self._path.suffix}", "try the other ending")
        self._writer.write(np.ascontiguousarray(frame))
        self.pictures += 1

    def developed(self) -> bytes:
        """The film's bytes; it is over."""
        self._writer.release()
        return self._path.read_bytes()


def _strip(width: int, lines: Sequence[str]) -> Pixels:
    strip = np.full((_LINE * len(lines) + 2 * _MARGIN, width, 3), 30, np.uint8)
    for at, line in enumerate(lines, 1):
        (wide, _), _ = cv2.getTextSize(line, _FONT, 0.45, 1)
        scale = 0.45 * min(1.0, (width - 2 * _MARGIN) / wide)
        cv2.putText(strip, line, (_MARGIN, at * _LINE), _FONT, scale, _WHITE, 1, cv2.LINE_AA)
    return strip


@contextlib.contextmanager
def _unheard() -> Iterator[None]:
    """OpenCV prints, past every setting of its own, that WebM knows no tags of codecs."""
    heard = os.dup(2)
    with Path(os.devnull).open("wb") as nowhere:
        os.dup2(nowhere.fileno(), 2)
    try:
        yield
    finally:
        os.dup2(heard, 2)
        os.close(heard)


def _played(reel: _Reel, config: RunConfig, policy: Policy, seed: int) -> str:
    """In the simulation that the run was trained in."""
    env = make(config.task, config.horizon, config.env.ranges(), render_mode="rgb_array")
    observer = Observer(env, frames=config.spaces.frames, repeat=config.action_repeat)
    rate, actions = env.rate / config.action_repeat, config.episode_steps // config.action_repeat
    every = max(1, round(rate / env.metadata["render_fps"]))  # actions: more pictures show no more
    try:
        for at, (total, success) in enumerate(play(policy, observer, config.evaluation, seed)):
            if at % every == 0 or at == actions:
                picture = env.render()
                assert isinstance(picture, np.ndarray)
                at_step = f"step {at * config.action_repeat} of {config.episode_steps}"
                reel.add(picture, f"{at_step}, {_stands(total, success)}", rate / every)
    finally:
        observer.close()
    return _stands(total, success) + (f", seen every {every} actions" if every > 1 else "")


def _stands(total: float, success: float) -> str:
    said = "" if math.isnan(success) else ", success" if success else ", no success"
    return f"return {total:.1f}{said}"


def _deployed(reel: _Reel, config: RunConfig, networks: Path, episode: int, rig: RigConfig) -> str:
    """At a simulated workplace."""
    laboratory = Laboratory(rig)

    def connect(rig: RigConfig) -> Rig:
        return _WatchedRig(rig, reel, laboratory.cameras, config.episode_steps)

    (played,) = laboratory.play(config, networks, episode, episode + 1, lambda: False, connect=connect)
    return _stands(played.total, played.success) + (f"; {played.lost}" if played.lost else "")


class _WatchedRig(Rig):
    """Adds to a film what its cameras take, and what perception finds there."""

    def __init__(self, config: RigConfig, reel: _Reel, cameras: Mapping[str, Camera], steps: int) -> None:
        super().__init__(config)
        self._reel, self._cameras, self._cube, self._of = reel, cameras, marked_cube(config), steps

    def begin(self, task: str, seed: int) -> Vector:
        self._step, self._goal = 0, super().begin(task, seed)
        return self._goal

    def wait(self) -> None:
        super().wait()
        self._step += 1

    def images(self) -> dict[str, Pixels]:
        pictures, truth = super().images(), self.truth()
        sight = locate(pictures, self._cameras, self._cube)
        seen = f"{sight.markers} markers, {sight.error_px:.1f} pixels off" if sight else "no marker"
        line = f"step {self._step} of {self._of}, {_stands(truth.total, truth.success)}; {seen}"
        shown = [self._found(name, picture, sight) for name, picture in pictures.items()]
        self._reel.add(np.hstack(shown), line, 1 / PERIOD_S)
        return pictures

    def _found(self, name: str, picture: Pixels, sight: Sight | None) -> Pixels:
        """A picture with its markers, the goal, and the cube's axes by all pictures: x red, y green, z blue."""
        camera, drawn = self._cameras[name], np.ascontiguousarray(picture[..., ::-1])
        if seen := detect(picture, self._cube.dictionary):
            quads = [quad[None].astype(np.float32) for quad in seen.values()]
            cv2.aruco.drawDetectedMarkers(drawn, quads, np.array(list(seen)))
        if sight is not None:
            pose = camera.pose @ rigid((0.0, 0.0, sight.yaw), sight.position)
            turn = cv2.Rodrigues(pose[:3, :3])[0]
            cv2.drawFrameAxes(drawn, camera.matrix, np.array(camera.distortion), turn, pose[:3, 3], self._cube.size, 2)
        across, down = np.rint(camera.project(np.array([self._goal]))[0]).astype(int).tolist()
        cv2.circle(drawn, (across, down), 8, (60, 160, 60), 2, cv2.LINE_AA)
        cv2.putText(drawn, name, (_MARGIN, _LINE), _FONT, 0.45, (0, 0, 0), 1, cv2.LINE_AA)
        return drawn[..., ::-1]
