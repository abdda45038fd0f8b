"""Files of demonstrations."""

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest
import safetensors.numpy

from rrm.envs import task
from rrm.errors import ConfigError, DemosError, UnknownNameError
from rrm.imitation.demos import DEMOS_FORMAT, Demonstrations
from rrm.training.episodes import demonstrate

ARRAYS = ("obs", "act", "next_obs", "terminated", "lengths", "returns", "successes")


def demos(lengths=(3, 2), obs_dim=15, act_dim=2, **changes):
    """Episodes whose observations count the steps."""
    count = sum(lengths)
    obs = np.arange(count, dtype=np.float32)[:, None] + np.zeros(obs_dim, np.float32)
    return Demonstrations(**{
        "obs": obs, "next_obs": obs + 1, "act": np.zeros((count, act_dim), np.float32),
        "terminated": np.zeros(count, np.uint8), "lengths": np.array(lengths, np.int64),
        "returns": np.array([1.0, 3.0]), "successes": np.array([1.0, 0.0]),
        "provenance": {"task": "toy-car", "source": "test"},
    } | changes)  # fmt: skip


def test_what_is_written_is_read(tmp_path):
    """Every array and the provenance, through a file that safetensors alone can read too."""
    demos().save(tmp_path / "d.safetensors")
    again = Demonstrations.load(tmp_path / "d.safetensors")
    for name in ARRAYS:
        np.testing.assert_array_equal(getattr(demos(), name), getattr(again, name))
    assert again.summary() == {
        "task": "toy-car", "source": "test", "episodes": 2, "transitions": 5, "success": 0.5, "true_return": 2.0
    }  # fmt: skip
    assert set(safetensors.numpy.load_file(tmp_path / "d.safetensors")) == set(ARRAYS)


@pytest.mark.parametrize(
    ("changes", "problem"),
    [
        ({"obs": np.zeros((5, 15))}, "obs is float64"),
        ({"act": np.zeros((4, 2), np.float32)}, "act has 4 entries; there are 5 transitions"),
        ({"lengths": np.array([3, 1])}, "add up to 4"),
        ({"lengths": np.array([5, 0])}, "add up to 5"),
        ({"next_obs": np.zeros((5, 3), np.float32)}, "next_obs"),
        ({"act": np.full((5, 2), np.nan, np.float32)}, "finite"),
        ({"act": np.full((5, 2), 1.5, np.float32)}, "outside"),
    ],
)
def test_what_does_not_fit_together_is_refused(tmp_path, changes, problem):
    """The message names the file and the array."""
    dataclasses.replace(demos(), **changes).save(tmp_path / "d.safetensors")
    with pytest.raises(DemosError, match=rf"d\.safetensors: .*{problem}"):
        Demonstrations.load(tmp_path / "d.safetensors")


@pytest.mark.parametrize("damage", ["missing", "text", "cut", "other", "lacks", "provenance"])
def test_what_is_no_such_file_is_refused(tmp_path, damage):
    """Whatever lies there instead."""
    path = Path(tmp_path / "d.safetensors")
    arrays = {name: getattr(demos(), name) for name in ARRAYS}
    match damage:
        case "text":
            path.write_text("hello")
        case "cut":
            demos().save(path)
            path.write_bytes(path.read_bytes()[:-20])
        case "other":
            safetensors.numpy.save_file(arrays, path)
        case "lacks":
            del arrays["act"]
            told = json.dumps({"format": DEMOS_FORMAT, "provenance": {}})
            safetensors.numpy.save_file(arrays, path, {"demonstrations": told})
        case "provenance":
            told = json.dumps({"format": DEMOS_FORMAT, "provenance": 3})
            safetensors.numpy.save_file(arrays, path, {"demonstrations": told})
    with pytest.raises(DemosError, match=r"d\.safetensors"):
        Demonstrations.load(path)


def test_another_tasks_demonstrations_are_refused():
    """By what they say they are, and by their sizes where they say nothing."""
    demos().check(task("toy-car"), "d")
    with pytest.raises(DemosError, match="d shows toy-car, not button-press"):
        demos().check(task("button-press"), "d")
    with pytest.raises(DemosError, match="observations of 15 and actions of 2 numbers; button-press has 39 and 4"):
        demos(provenance={}).check(task("button-press"), "d")


def still(obs):
    return np.zeros(2, np.float32)


def test_demonstrations_are_the_episodes_that_were_played():
    """Successors join up inside an episode; equal seeds play equal episodes; a policy that does nothing fails."""
    played = demonstrate("toy-car", still, 3, seed=1, horizon=20, source={"source": "still"})
    assert played.lengths.tolist() == [20, 20, 20]
    for start in (0, 20, 40):
        np.testing.assert_array_equal(played.obs[start + 1 : start + 20], played.next_obs[start : start + 19])
    assert not played.terminated.any()
    assert played.success == 0
    assert played.provenance == {"task": "toy-car", "seed": 1, "source": "still"}
    again = demonstrate("toy-car", still, 3, seed=1, horizon=20, source={})
    np.testing.assert_array_equal(played.obs, again.obs)
    other = demonstrate("toy-car", still, 3, seed=2, horizon=20, source={})
    assert (played.obs[0] != other.obs[0]).any()
    assert dataclasses.replace(played, successes=np.full(3, np.nan)).summary()["success"] is None


def test_an_expert_that_fails_is_refused():
    """The message says how often it succeeds and what to do."""
    with pytest.raises(
        DemosError, match=r"succeeds in 0% of 2 episodes of toy-car, 80% are asked for: train it longer"
    ):
        demonstrate("toy-car", still, 2, seed=0, horizon=20, source={}, least_success=0.8)


def test_collecting_can_be_stopped():
    """After any episode; nothing is handed over then."""
    seen = []
    assert (
        demonstrate(
            "toy-car", still, 5, seed=0, horizon=20, source={}, stopped=lambda step, _: seen.append(step) or step >= 40
        )
        is None
    )
    assert seen == [20, 40]


@pytest.mark.slow
@pytest.mark.sim
def test_scripted_policies_solve_their_tasks():
    """Meta-World's own, through our environment; their actions are clipped into [-1, 1]."""
    from rrm.envs.metaworld import scripted_policy

    policy = scripted_policy("button-press")
    played = demonstrate("button-press", lambda obs: policy(obs.state), 3, seed=0, source={})
    assert played.success == 1.0
    assert np.abs(played.act).max() == 1.0


def test_scripted_policies_are_meta_worlds():
    """Elsewhere there are none."""
    from rrm.envs.metaworld import scripted_policy

    with pytest.raises(ConfigError, match="toy-car has no scripted policy"):
        scripted_policy("toy-car")
    with pytest.raises(UnknownNameError):
        scripted_policy("button-pres")
