import subprocess
import sys

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from rrm.buffers.experience import Experience
from rrm.buffers.frames import Frames
from rrm.buffers.replay import Replay
from rrm.envs import FrameSpace, Spaces
from rrm.errors import CheckpointError
from rrm.types import Transition


def picture(row):
    return np.full((1, 2, 2), row % 256, np.uint8)


def filmed(lengths, *, stack, window, unfinished=0):
    """Episodes whose pictures show the number of their row, and whose observation tells the episode and the step."""
    experience = Experience(4, 4, Spaces(2, 1, FrameSpace(2, 2, 1, stack=stack)), window)
    for episode, length in enumerate([*lengths, unfinished]):
        for step in range(length):
            row = experience.rows
            last = step == length - 1 and episode < len(lengths)
            experience.append(
                Transition(
                    np.array([episode, step], np.float32), np.zeros(1, np.float32),
                    np.array([episode, step + 1], np.float32), 0.0, 0.0, 0.0, False, last,
                    np.stack([picture(row)] * stack), np.stack([picture(row + 1)] * stack),
                ),
                100.0 * episode + step,
            )  # fmt: skip
    return experience


lengths = st.lists(st.integers(1, 9), min_size=1, max_size=5)


@given(lengths, st.integers(1, 4), st.integers(1, 4), st.integers(0, 6))
def test_a_window_is_of_one_episode_and_begins_with_the_stack_of_its_first_step(episodes, stack, window, unfinished):
    """All windows of consecutive steps can be drawn, no others; an episode's first picture stands for those before."""
    experience = filmed(episodes, stack=stack, window=window, unfinished=unfinished)
    possible = [
        (episode, begin)
        for episode, length in enumerate([*episodes, unfinished])
        for begin in range(length - window + 1)
    ]
    batch = experience.batch_of_windows(torch.arange(experience.windows))
    assert [tuple(first) for first in batch.obs[:, 0].int().tolist()] == possible
    starts = np.cumsum([0, *(length + 1 for length in episodes)])
    for i, (episode, begin) in enumerate(possible):
        assert batch.obs[i].tolist() == [[episode, begin + t] for t in range(window)]
        assert batch.next_obs[i].tolist() == [[episode, begin + t + 1] for t in range(window)]
        assert batch.reward[i].tolist() == [100.0 * episode + begin + t for t in range(window)]
        steps = [max(begin + t, 0) for t in range(-stack + 1, window + 1)]
        assert batch.frames[i, :, 0, 0, 0].tolist() == [starts[episode] + step for step in steps]


@given(lengths, st.integers(1, 4), st.integers(1, 3))
def test_stacks_of_rows_in_order(episodes, stack, block):
    """Looked at in blocks of any size, every row shows the pictures up to it and none of another episode."""
    experience = filmed(episodes, stack=stack, window=1)
    blocks = [experience.stacks(b, min(b + block, experience.rows)) for b in range(0, experience.rows, block)]
    shown = torch.cat(blocks)[..., 0, 0, 0].tolist()
    row = 0
    for length in episodes:
        first = row
        for _ in range(length + 1):
            assert shown[row] == [max(row - back, first) for back in range(stack - 1, -1, -1)]
            row += 1


@pytest.mark.slow
@given(lengths, st.integers(1, 3), st.integers(0, 4))
def test_windows_are_counted_again_when_they_come_back(tmp_path_factory, episodes, window, unfinished):
    folder = tmp_path_factory.mktemp("frames")
    experience = filmed(episodes, stack=2, window=window, unfinished=unfinished)
    state = experience.save(folder)
    restored = Experience(4, 4, Spaces(2, 1, FrameSpace(2, 2, 1, stack=2)), window)
    restored.load(folder, state)
    assert (restored.windows, restored.transitions) == (experience.windows, experience.transitions)
    pairs = (each.batch_of_windows(torch.arange(each.windows)) for each in (experience, restored))
    for one, other in zip(*pairs, strict=True):
        assert torch.equal(one, other)


def test_pictures_of_a_process_that_died_are_written_over(tmp_path):
    """What was written behind the last checkpoint is not seen again; what comes then takes its place."""
    space = FrameSpace(2, 2, 1)
    before = Frames(space)
    for row in range(3):
        before.append(picture(row))
    state = before.save(tmp_path / "frames.bin")
    before.append(picture(77))
    after = Frames(space)
    after.load(tmp_path / "frames.bin", state)
    assert (tmp_path / "frames.bin").stat().st_size == 12
    after.append(picture(3))
    seen = np.empty((4, 1, 2, 2), np.uint8)
    after.read(0, seen)
    assert seen[:, 0, 0, 0].tolist() == [0, 1, 2, 3]
    with pytest.raises(IndexError, match="there are 4"):
        after.read(1, seen)


@pytest.mark.parametrize("harm", ["flip", "cut", "remove"])
def test_damaged_pictures_are_noticed(tmp_path, harm):
    frames = Frames(FrameSpace(2, 2, 1))
    for row in range(5):
        frames.append(picture(row))
    path = tmp_path / "frames.bin"
    state = frames.save(path)
    data = bytearray(path.read_bytes())
    data[7] ^= 1
    path.write_bytes({"flip": data, "cut": data[:-1]}.get(harm, b""))
    if harm == "remove":
        path.unlink()
    with pytest.raises(CheckpointError, match=r"frames\.bin"):
        Frames(FrameSpace(2, 2, 1)).load(path, state)


@pytest.mark.slow
def test_pictures_do_not_stay_in_memory():
    """Twenty thousand pictures of 12 kB, drawn from: the process grows by a small part of what they are."""
    program = """
import resource, numpy as np, torch
from rrm.buffers.frames import Frames
from rrm.envs import FrameSpace
frames, picture = Frames(FrameSpace(64, 64)), np.zeros((3, 64, 64), np.uint8)
def peak(): return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss // 1024
frames.append(picture)
before = peak()
for _ in range(20_000): frames.append(picture)
window = np.empty((6, 3, 64, 64), np.uint8)
for row in np.random.default_rng(0).integers(0, 19_990, 3000): frames.read(int(row), window)
print(peak() - before)
"""
    grown = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert int(grown.stdout) < 24  # MiB, of 234


def test_a_sample_of_an_agent_that_sees_frames_is_of_windows():
    experience = filmed([5, 5], stack=2, window=3)
    replay = Replay(experience, 7, torch.Generator().manual_seed(0), repeat=2)
    assert replay.sample().reward.shape == (7, 3)
    assert (replay.transitions, replay.steps) == (10, 20)
