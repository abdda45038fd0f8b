"""One seed becomes named, independent random streams, each of which can be saved.

One more draw in one place must not shift the others, so every purpose has a stream of its own. The streams in use:
`env` (resets), `explore` (random and policy actions), `agent` (update noise), `shift` (how far pictures are moved),
`replay` (batches), `init` and `reward-init` (weights of the agent and of the reward), `reward` (minibatches and crops
of reward learning), `query` (segment pairs), `unlabelled` (pairs nobody is asked about), `lookahead` (actions imagined
by a learner that asks the agent for its targets), `teacher` (label noise), `prior` (random priors), `imitation-init`
(weights of the discriminator), `imitation` (its minibatches, the expert's and the policy's), `demonstrations`
(instances that an expert is shown).
Evaluation draws from `evaluation_seed` and never from a stream of training.
"""

from __future__ import annotations

import hashlib
from typing import TYPE_CHECKING

import numpy as np

from rrm.devices import kind_of
from rrm.types import State

if TYPE_CHECKING:
    import torch


def _entropy(seed: int, name: str) -> list[int]:
    return [seed, int.from_bytes(hashlib.sha256(name.encode()).digest()[:8], "little")]


def evaluation_seed(seed: int, step: int, episode: int) -> int:
    """Seed of one evaluation episode: a pure function of the run's seed, the step and the episode's number."""
    sequence = np.random.SeedSequence([*_entropy(seed, "evaluation"), step, episode])
    return int(sequence.generate_state(1, np.uint32)[0])


class Streams:
    """The random streams of one run, made on first use and saved together."""

    def __init__(self, seed: int) -> None:
        if seed < 0:
            raise ValueError(f"seed is {seed}; seeds are integers from 0 up")
        self._seed = seed
        self._numpy: dict[str, np.random.Generator] = {}
        self._torch: dict[str, torch.Generator] = {}

    def numpy(self, name: str) -> np.random.Generator:
        """The numpy generator of this name; the same object at every call."""
        if name not in self._numpy:
            self._numpy[name] = np.random.default_rng(_entropy(self._seed, name))
        return self._numpy[name]

    def torch(self, name: str, device: str = "cpu") -> torch.Generator:
        """The torch generator of this name on `device`; the same object at every call."""
        if name not in self._torch:
            import torch

            words = np.random.SeedSequence(_entropy(self._seed, name)).generate_state(1, np.uint64)
            self._torch[name] = torch.Generator(device=device).manual_seed(int(words[0]) >> 1)
        if self._torch[name].device.type != kind_of(device):
            raise ValueError(f"the stream {name!r} lives on {self._torch[name].device}, not on {device}")
        return self._torch[name]

    def state_dict(self) -> State:
        return {
            "numpy": {name: g.bit_generator.state for name, g in self._numpy.items()},
            "torch": {name: g.get_state() for name, g in self._torch.items()},
        }

    def load_state_dict(self, state: State) -> None:
        for name, saved in state["numpy"].items():
            self.numpy(name).bit_generator.state = saved
        for name, saved in state["torch"].items():  # on whatever device it is by now
            (self._torch.get(name) or self.torch(name)).set_state(saved)
