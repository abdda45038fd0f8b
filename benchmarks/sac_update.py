"""SAC updates a second beside Stable-Baselines3's, and beside what the arithmetic alone would allow.

The floor is the multiplications and additions of the update's matrix products, no unused gradient counted, at the rate
of one batch x hidden x hidden product in the same precision.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from importlib.util import find_spec

import torch

from benchmarks.lines import Line, in_turns
from rrm.agents.sac import Sac
from rrm.config import AgentConfig
from rrm.envs import Spaces
from rrm.nets.precision import multiplies
from rrm.precision import Precision
from rrm.seeding import Streams
from rrm.types import Batch

OBS, ACT = 39, 4  # Meta-World
_PEER_UPDATES = 5  # at once: the peer sets up its optimisers' rates once a call
_DEMANDS: dict[Precision, tuple[float, float]] = {"float32": (1.3, 0.85), "bfloat16": (2.5, 0.70)}


def lines() -> Iterator[Line]:
    """The paper's sizes in both precisions, and the laptop profile's."""
    torch.set_num_threads(1)
    for config in (AgentConfig(), AgentConfig(hidden=128, batch=128)):
        paper = config == AgentConfig()
        for precision in ("float32", "bfloat16") if multiplies("bfloat16") else ("float32",):
            yield _line(config, precision, demanded=paper)


def _line(config: AgentConfig, precision: Precision, *, demanded: bool) -> Line:
    works = [agent_update(config, precision), product(config, precision)]
    if find_spec("stable_baselines3"):
        works.append(_peer_updates(config))
    update_s, product_s, *peer_s = in_turns(*works)
    rate = 2.0 * config.batch * config.hidden**2 / product_s
    ratio, share = _DEMANDS[precision]
    return Line(
        item=f"SAC update, batch {config.batch}, {config.hidden} x {config.layers}, {precision}",
        ours=1 / update_s, unit="/s", peer="Stable-Baselines3", theirs=_PEER_UPDATES / peer_s[0] if peer_s else None,
        floor=rate / update_flop(config), note=f"product at {rate / 1e9:.0f} GFLOP/s",
        least_ratio=ratio if demanded else None, least_share=share if demanded else None,
    )  # fmt: skip


def update_flop(config: AgentConfig) -> float:
    """Floating-point operations of the matrix products of one update; all else is left out."""

    def layers(first: int, last: int) -> tuple[int, int, int]:
        return first * config.hidden, (config.layers - 1) * config.hidden**2, config.hidden * last

    actor, critic = sum(layers(OBS, 2 * ACT)), sum(layers(OBS + ACT, 1))
    actor_down, critic_down = sum(layers(0, 2 * ACT)), sum(layers(0, 1))
    critic_step = actor + 2 * critic + 2 * (critic + critic + critic_down)  # target, then both ways through the critic
    to_action = critic_down + ACT * config.hidden
    actor_step = actor + 2 * (critic + to_action) + actor + actor_down
    return 2.0 * config.batch * (critic_step + actor_step)


def agent_update(config: AgentConfig, precision: Precision) -> Callable[[], None]:
    """An agent's update on random data."""
    sac = Sac(config, Spaces(OBS, ACT), Streams(0), precision=precision)
    rows = config.batch
    obs, next_obs = torch.randn(2, rows, OBS)
    batch = Batch(obs, torch.rand(rows, ACT) * 2 - 1, torch.zeros(rows), torch.randn(rows), next_obs, torch.ones(rows))
    return lambda: sac.update(batch)


def product(config: AgentConfig, precision: Precision) -> Callable[[], None]:
    """The product whose rate is the measure, on numbers stored in this precision."""
    dtype = torch.bfloat16 if precision == "bfloat16" else torch.float32
    x, w = torch.randn(config.batch, config.hidden).to(dtype), torch.randn(config.hidden, config.hidden).to(dtype)
    out = torch.empty(config.batch, config.hidden, dtype=dtype)

    def one() -> None:
        torch.mm(x, w, out=out)

    return one


def _peer_updates(config: AgentConfig) -> Callable[[], None]:
    """The same number of transitions through the peer's update, with its replay buffer, as its users run it."""
    import gymnasium as gym
    import numpy as np
    from stable_baselines3 import SAC
    from stable_baselines3.common.logger import configure

    class Blank(gym.Env):  # type: ignore[type-arg]
        observation_space = gym.spaces.Box(-np.inf, np.inf, (OBS,), np.float32)
        action_space = gym.spaces.Box(-1, 1, (ACT,), np.float32)

    sac = SAC(
        "MlpPolicy", Blank(), batch_size=config.batch, learning_rate=config.critic_lr, buffer_size=4096, device="cpu",
        policy_kwargs={"net_arch": [config.hidden] * config.layers}, target_update_interval=config.target_every,
    )  # fmt: skip
    sac.set_logger(configure(None, []))
    rng = np.random.default_rng(0)
    for _ in range(2048):
        obs, following = rng.standard_normal((2, 1, OBS), np.float32)
        sac.replay_buffer.add(obs, following, rng.uniform(-1, 1, (1, ACT)), rng.standard_normal(1), np.zeros(1), [{}])
    torch.set_num_threads(1)
    return lambda: sac.train(_PEER_UPDATES, config.batch)
