"""The experience: an observation that counts its own steps makes any off-by-one visible."""

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from rrm.buffers.experience import Episode, Experience
from rrm.buffers.replay import Replay
from rrm.envs import FrameSpace, Spaces
from rrm.errors import CheckpointError
from rrm.sources.entropy import neighbour_distance
from rrm.types import Transition


def lived(lengths, *, terminated=False, unfinished=0):
    """Episodes of the given lengths; the observation of step t of episode e is (e, t), its true reward 100 e + t."""
    experience = Experience(3, 100, Spaces(2, 1))  # room is made as it is needed
    for e, length in enumerate([*lengths, unfinished]):
        for t in range(length):
            last = t == length - 1 and e < len(lengths)
            step = Transition(
                obs=np.array([e, t], np.float32), act=np.array([t / 100], np.float32), prior=e + t / 10,
                raw_prior=2 * (e + t / 10), true_reward=100 * e + t, next_obs=np.array([e, t + 1], np.float32),
                terminated=last and terminated, truncated=last and not terminated,
            )  # fmt: skip
            experience.append(step, -1.0)
    return experience


def sample(experience, count, generator, **options):
    return Replay(experience, count, generator).sample(**options)


lengths = st.lists(st.integers(1, 7), min_size=1, max_size=6)


@given(lengths, st.integers(0, 5))
def test_a_sampled_transition_is_one_that_was_lived(episode_lengths, unfinished):
    """Successors are one step on in the same episode, also at its end, and every transition can be drawn."""
    experience = lived(episode_lengths, unfinished=unfinished)
    batch = sample(experience, 2000, torch.Generator().manual_seed(0))
    assert torch.equal(batch.obs + torch.tensor([0.0, 1.0]), batch.next_obs)
    total = sum(episode_lengths) + unfinished
    assert experience.transitions == total
    assert len(torch.unique(batch.obs, dim=0)) == total
    assert torch.allclose(batch.prior, batch.obs[:, 0] + batch.obs[:, 1] / 10)
    assert torch.allclose(batch.act[:, 0], batch.obs[:, 1] / 100)


def test_only_termination_cuts_the_bootstrap():
    """A time limit continues, a termination does not."""
    generator = torch.Generator().manual_seed(0)
    assert sample(lived([3, 3]), 100, generator).continues.min() == 1
    batch = sample(lived([3, 3], terminated=True), 100, generator)
    assert torch.equal(batch.continues, (batch.obs[:, 1] < 2).float())


def test_a_time_limit_can_be_asked_to_cut_it_too():
    """Then whatever ends an episode does not continue, and nothing else of the batch is different."""
    for terminated in (False, True):
        experience = lived([3, 3], terminated=terminated, unfinished=1)
        usual, cut = (
            sample(experience, 100, torch.Generator().manual_seed(0), time_limits_end=end) for end in (False, True)
        )
        assert torch.equal((cut.obs[:, 1] < 2).float(), cut.continues)
        assert torch.equal(usual.obs, cut.obs)


@given(lengths)
def test_a_segment_stays_inside_its_episode(episode_lengths):
    """Rows from an episode's start are its steps in order, with their true rewards."""
    experience = lived(episode_lengths)
    for e, episode in enumerate(experience.episodes):
        assert episode.length == episode_lengths[e]
        segment = experience.segments(torch.tensor([episode.start]), episode.length)
        wanted = torch.tensor([[float(e), float(t)] for t in range(episode.length)])
        assert torch.equal(wanted, segment.obs[0])
        true = experience.true_rewards(np.array([episode.start]), episode.length)
        np.testing.assert_array_equal([100 * e + t for t in range(episode.length)], true[0])


def test_relabelling_uses_the_stored_prior():
    """New rewards are computed from the prior as it was stored, whatever the raw value or scale is now."""
    experience = lived([4, 4])
    experience.relabel(lambda obs, act, prior: 10 * prior)
    batch = sample(experience, 200, torch.Generator().manual_seed(0))
    assert torch.allclose(10 * batch.prior, batch.reward)


def test_neighbour_distance_is_the_brute_force_one():
    """The k-th nearest among the states of transitions, itself and the ends of episodes left out."""
    experience = lived([5, 3])
    states = torch.tensor([[e, t] for e, n in ((0, 5), (1, 3)) for t in range(n)], dtype=torch.float32)
    query = states[:3]
    wanted = torch.stack([(states - q).norm(dim=1).sort().values[2] for q in query])
    assert torch.allclose(wanted, neighbour_distance(experience, query, 2))


def test_small_neighbour_distances_keep_their_digits():
    """States a hair apart and far from the origin, where a matrix product would only see rounding."""
    generator = torch.Generator().manual_seed(0)
    states = 100 + 1e-3 * torch.randn(300, 2, generator=generator)
    experience = Experience(300, 300, Spaces(2, 1))
    for t, (obs, following) in enumerate(zip(states, states.roll(-1, 0), strict=True)):
        act = np.zeros(1, np.float32)
        experience.append(Transition(obs.numpy(), act, following.numpy(), 0.0, 0.0, 0.0, False, t == 299), 0.0)
    exact = (states[:, None] - states).double().norm(dim=-1).sort(dim=-1).values[:, 3].float()
    torch.testing.assert_close(neighbour_distance(experience, states, 3), exact)


@pytest.mark.slow
@given(lengths, st.integers(0, 4), st.integers(1, 4), st.booleans())
def test_saved_in_pieces_it_comes_back_whole(tmp_path_factory, episode_lengths, unfinished, every, relabel):
    """However often it was saved, and whatever was relabelled between, the restored experience is the same."""
    folder = tmp_path_factory.mktemp("experience")
    whole = lived(episode_lengths, unfinished=unfinished)
    spaces = Spaces(2, 1, FrameSpace(1, 2, 1, stack=2))
    growing = Experience(1, 1, spaces)
    state = growing.save(folder)
    for i, row in enumerate(whole.since(0).tolist()):
        end = int(whole.kind[row])
        step = Transition(
            obs=whole.obs[row].numpy(), act=whole.act[row].numpy(), prior=float(whole.prior[row]),
            raw_prior=float(whole.raw_prior[row]), true_reward=float(whole.true_reward[row]),
            next_obs=whole.obs[row + 1].numpy(), terminated=end == 1, truncated=end == 2,
            frames=np.full((2, 1, 1, 2), row, np.uint8), next_frames=np.full((2, 1, 1, 2), row + 1, np.uint8),
        )  # fmt: skip
        growing.append(step, -1.0)
        if relabel and i % 3 == 0:
            growing.relabel(lambda obs, act, prior: prior + obs[:, 1])
        if i % every == 0:
            state = growing.save(folder)
    state = growing.save(folder)
    restored = Experience(1, 1, spaces)
    restored.load(folder, state)
    assert restored.episodes == growing.episodes
    assert (restored.rows, restored.transitions) == (growing.rows, growing.transitions)
    for column in ("obs", "act", "prior", "raw_prior", "true_reward", "reward", "kind"):
        rows = slice(growing.rows + (column == "obs"))
        pair = getattr(growing, column)[rows], getattr(restored, column)[rows]
        # After a finished episode the row that follows has not been written: it may be anything, no number at all too.
        torch.testing.assert_close(*pair, rtol=0, atol=0, equal_nan=True, msg=column)
    a, b = (sample(x, 100, torch.Generator().manual_seed(1)) for x in (growing, restored))
    assert all(torch.equal(x, y) for x, y in zip(a, b, strict=True))


def test_what_does_not_change_is_written_once(tmp_path):
    """A checkpoint appends the new rows only; the reward column is rewritten only after a relabelling."""
    experience = lived([50, 50], unfinished=3)
    experience.save(tmp_path)
    before = {path.name: (path.stat().st_size, path.stat().st_ino) for path in tmp_path.iterdir()}
    blank = np.zeros(2, np.float32)
    experience.append(Transition(blank, np.zeros(1, np.float32), blank, 0, 0, 0, False, False), 0)
    experience.save(tmp_path)
    grown = {path.name: path.stat().st_size - before[path.name][0] for path in tmp_path.iterdir()}
    assert grown == {"transitions.bin": 4 * 6 + 1, "reward-000000.bin": 4}
    experience.relabel(lambda obs, act, prior: prior)
    for generations in ([0, 1], [1]):  # of the two checkpoints that are kept
        experience.save(tmp_path)
        experience.discard(tmp_path)
        assert [f"reward-{number:06d}.bin" for number in generations] == sorted(
            path.name for path in tmp_path.glob("reward-*")
        )
    assert sorted(p.name for p in tmp_path.iterdir()) == ["reward-000001.bin", "transitions.bin"]


def test_a_damaged_log_is_a_damaged_checkpoint(tmp_path):
    """A flipped byte anywhere in the committed rows is refused."""
    experience = lived([5, 5])
    state = experience.save(tmp_path)
    path = tmp_path / "transitions.bin"
    data = bytearray(path.read_bytes())
    data[30] ^= 1
    path.write_bytes(data)
    with pytest.raises(CheckpointError, match="damaged"):
        Experience(20, 20, Spaces(2, 1)).load(tmp_path, state)


def test_episodes_are_the_finished_ones():
    """The episode under way is not offered for queries."""
    assert lived([4, 2], unfinished=3).episodes == [Episode(0, 4), Episode(5, 2)]
