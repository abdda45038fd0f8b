"""Steps for language priors to look at."""

import hashlib

import numpy as np

from rrm.envs import task
from rrm.priors.language import parse_record, read_source
from rrm.priors.step import PriorStep, Scene


def random_step(name, rng):
    """A step of the task with everything drawn from a normal distribution, as read-only as in a run."""
    spec = task(name)
    obs, first = rng.normal(size=(2, spec.spaces.obs)).astype(np.float32)
    act = rng.uniform(-1, 1, spec.spaces.act).astype(np.float32)
    for array in (obs, first, act):
        array.flags.writeable = False
    info = {"success": 0.0, "unscaled_reward": 7.0} | {name: rng.normal() for name in spec.outcomes}
    return PriorStep(spec, obs, act, info, np.random.default_rng(0), Scene(spec, first))


def code(body, before=""):
    """A file whose reward function has this body."""
    lines = "\n".join(f"    {line}" for line in body.strip("\n").split("\n"))
    return f"import numpy as np\nimport math\n{before}\n\ndef reward(step):\n{lines}\n".encode()


def sha256(data):
    return hashlib.sha256(data).hexdigest()


def recorded(path):
    """The record of a frozen file."""
    return parse_record(read_source(path), path)
