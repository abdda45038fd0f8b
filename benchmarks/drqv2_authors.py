"""The update of DrQ-v2's authors, timed in a process of its own.

    python -m benchmarks.drqv2_authors FOLDER CONFIG BUDGET

For each line that it reads it prints the processor seconds of an update. Of their code the agent alone is used; its
encoder takes the sizes of CONFIG (JSON), for its own are those of other pictures.
"""

from __future__ import annotations

import importlib
import sys
from collections.abc import Callable, Iterator
from types import ModuleType
from typing import Any

import torch
from torch import nn

from benchmarks.lines import seconds
from rrm.config import DrqConfig

ACT, PLANES, SIDE = 4, 9, 64


def main(folder: str, settings: str, budget: str) -> None:
    torch.set_num_threads(1)
    update = _update(folder, DrqConfig.model_validate_json(settings))
    for _ in sys.stdin:
        print(seconds(update, float(budget)), flush=True)


def _update(folder: str, config: DrqConfig) -> Callable[[], object]:
    """Of random batches, which lie ready."""
    for unused in ("hydra", "omegaconf"):  # by the agent
        sys.modules.setdefault(unused, ModuleType(unused))
    vars(sys.modules["omegaconf"]).setdefault("OmegaConf", None)
    sys.path.insert(0, folder)
    theirs = importlib.import_module("drqv2")

    class Encoder(theirs.Encoder):  # type: ignore[name-defined,misc]
        def __init__(self, obs_shape: tuple[int, int, int]) -> None:
            super().__init__(obs_shape)
            layers: list[nn.Module] = []
            for layer, stride in enumerate(config.strides):
                layers += [nn.Conv2d(config.channels if layer else PLANES, config.channels, 3, stride), nn.ReLU()]
            self.convnet = nn.Sequential(*layers)
            self.apply(theirs.utils.weight_init)
            self.repr_dim = self.convnet(torch.zeros(1, *obs_shape)).numel()

    theirs.Encoder = Encoder
    agent = theirs.DrQV2Agent(
        obs_shape=(PLANES, SIDE, SIDE), action_shape=(ACT,), device="cpu", lr=config.lr, feature_dim=config.features,
        hidden_dim=config.hidden, critic_target_tau=config.tau, num_expl_steps=0, update_every_steps=1,
        stddev_schedule="linear(1.0,0.1,500000)", stddev_clip=config.stddev_clip, use_tb=False,
    )  # fmt: skip

    def batches() -> Iterator[tuple[Any, ...]]:
        frames = torch.randint(256, (2, config.batch, PLANES, SIDE, SIDE), dtype=torch.uint8)
        reward, ones = torch.randn(config.batch, 1), torch.ones(config.batch, 1)
        while True:
            yield frames[0], torch.rand(config.batch, ACT) * 2 - 1, reward, ones, frames[1]

    replay = batches()
    return lambda: agent.update(replay, 0)


if __name__ == "__main__":
    main(*sys.argv[1:])
