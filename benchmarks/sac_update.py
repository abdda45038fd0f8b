"""SAC updates a second beside those of Stable-Baselines3, SBX (the same in JAX) and plain autograd with fused Adam, and
beside what the arithmetic alone would allow.

All of it runs on one core. The floor is the multiplications and additions of the update's matrix products, no unused
gradient counted, at the best rate that any library reaches for the three batch x hidden x hidden products of a layer.
"""

from __future__ import annotations

from collections.abc import Callable
from importlib.util import find_spec
from typing import Any

import gymnasium as gym
import numpy as np
import torch

from benchmarks.lines import Line, in_turns, one_core
from rrm.agents.sac import Sac
from rrm.config import SacConfig
from rrm.envs import Spaces
from rrm.nets.precision import multiplies
from rrm.nets.program import Work
from rrm.nets.ways import WAYS
from rrm.precision import Precision
from rrm.seeding import Streams
from rrm.tuning import machine
from rrm.types import Batch
from tests.rrm.agents.reference_sac import ReferenceSac

OBS, ACT = 39, 4  # Meta-World
_AT_ONCE = 5  #: updates a call: peers prepare each call, and SBX compiles the loop over its updates

#: By batch and precision: least ratio to the best peer (asked for where SBX is one of them), least share of the floor.
_DEMANDS: dict[tuple[int, Precision], tuple[float, float | None]] = {
    (512, "float32"): (1.15, 0.85),
    (512, "bfloat16"): (1.8, 0.70),
    (128, "float32"): (1.15, None),
}


def lines() -> list[Line]:
    """The paper's sizes and the laptop profile's, in both precisions."""
    torch.set_num_threads(1)
    precisions: tuple[Precision, ...] = ("float32", "bfloat16") if multiplies("bfloat16") else ("float32",)
    with one_core():
        return [
            _line(config, precision)
            for config in (SacConfig(), SacConfig(hidden=128, batch=128))
            for precision in precisions
        ]


def _line(config: SacConfig, precision: Precision) -> Line:
    others = peers(config)
    update_s, products_s, *peer_s = in_turns(
        agent_update(config, precision), best_products(config, precision), *others.values()
    )
    rate = products_flop(config) / products_s
    ratio, share = _DEMANDS.get((config.batch, precision), (None, None))
    return Line(
        item=f"SAC update, batch {config.batch}, {config.hidden} x {config.layers}, {precision}",
        ours=1 / update_s, unit="/s", peers={name: _AT_ONCE / s for name, s in zip(others, peer_s, strict=True)},
        floor=rate / update_flop(config), note=f"products at {rate / 1e9:.0f} GFLOP/s",
        least_ratio=ratio if "SBX" in others else None, least_share=share,
    )  # fmt: skip


def update_flop(config: SacConfig) -> float:
    """Floating-point operations of the matrix products of one update; all else is left out."""

    def layers(first: int, last: int) -> tuple[int, int, int]:
        return first * config.hidden, (config.layers - 1) * config.hidden**2, config.hidden * last

    actor, critic = sum(layers(OBS, 2 * ACT)), sum(layers(OBS + ACT, 1))
    actor_down, critic_down = sum(layers(0, 2 * ACT)), sum(layers(0, 1))
    critic_step = actor + 2 * critic + 2 * (critic + critic + critic_down)  # target, then both ways through the critic
    to_action = critic_down + ACT * config.hidden
    actor_step = actor + 2 * (critic + to_action) + actor + actor_down
    return 2.0 * config.batch * (critic_step + actor_step)


def agent_update(config: SacConfig, precision: Precision) -> Callable[[], None]:
    """An agent's update on random data."""
    sac, batch = Sac(config, Spaces(OBS, ACT), Streams(0), precision=precision), random_batch(config.batch)
    return lambda: sac.update(batch)


def random_batch(rows: int) -> Batch:
    """Transitions of normal numbers."""
    obs, next_obs = torch.randn(2, rows, OBS)
    return Batch(obs, torch.rand(rows, ACT) * 2 - 1, torch.zeros(rows), torch.randn(rows), next_obs, torch.ones(rows))


def products_flop(config: SacConfig) -> float:
    """Floating-point operations of `best_products`."""
    return 3 * 2.0 * config.batch * config.hidden**2


def best_products(config: SacConfig, precision: Precision) -> Callable[[], None]:
    """The products of a layer between hidden ones, forward and back, each by the library that is the quickest at it; in
    bfloat16 on numbers that are stored so.
    """
    x, d = torch.randn(2, 1, config.batch, config.hidden)
    w = torch.randn(1, config.hidden, config.hidden)
    works = [_quickest(a, b, precision) for a, b in ((x, w), (x.mT, d), (d, w.mT))]

    def work() -> None:
        for one in works:
            one()

    return work


def _quickest(a: torch.Tensor, b: torch.Tensor, precision: Precision) -> Work:
    if precision == "bfloat16":
        a, b = a.bfloat16(), b.bfloat16()
    out = torch.empty(1, a.shape[1], b.shape[2], dtype=a.dtype)
    names = machine().rates if precision == "float32" else ["torch"]
    works = [WAYS[name](a, b, out) for name in names if name in WAYS]
    times = in_turns(*works, turns=3, budget=0.02)
    return works[times.index(min(times))]


def peers(config: SacConfig) -> dict[str, Callable[[], object]]:
    """Whoever is installed, by name: what does as many updates, `_AT_ONCE` a call, of networks of the same sizes.

    Stable-Baselines3 and SBX draw their batches from their replay buffers in it, as their users have it.
    """
    found: dict[str, Callable[[], object]] = {"autograd, fused Adam": _autograd_updates(config)}
    if find_spec("stable_baselines3"):
        found["Stable-Baselines3"] = _stable_baselines_updates(config)
    if find_spec("sbx"):
        found["SBX"] = _sbx_updates(config)
    return found


def _autograd_updates(config: SacConfig) -> Callable[[], object]:
    """The textbook's, from the networks of an agent of ours."""
    sac, batch = Sac(config, Spaces(OBS, ACT), Streams(0)), random_batch(config.batch)
    textbook = ReferenceSac(config, sac.actor, sac.critic, fused=True)

    def work() -> None:
        for _ in range(_AT_ONCE):
            textbook.update(batch, *torch.randn(2, config.batch, ACT))

    return work


def _stable_baselines_updates(config: SacConfig) -> Callable[[], object]:
    sac = stable_baselines(config)
    return lambda: sac.train(_AT_ONCE, config.batch)


def stable_baselines(config: SacConfig, device: str = "cpu") -> Any:
    """The agent of Stable-Baselines3, ready for `train(updates, batch)`."""
    from stable_baselines3 import SAC

    return _ready(SAC, config, device=device, target_update_interval=config.target_every)


def _sbx_updates(config: SacConfig) -> Callable[[], object]:
    import jax
    from sbx import SAC

    sac = _ready(SAC, config, device="cpu")

    def work() -> None:
        sac.train(_AT_ONCE, config.batch)
        jax.block_until_ready((sac.policy.actor_state, sac.policy.qf_state))  # until then the work is only on its way

    return work


class _Blank(gym.Env[Any, Any]):
    """Spaces only: no step is ever taken."""

    observation_space = gym.spaces.Box(-np.inf, np.inf, (OBS,), np.float32)
    action_space = gym.spaces.Box(-1, 1, (ACT,), np.float32)


def _ready(algorithm: Callable[..., Any], config: SacConfig, **settings: Any) -> Any:
    """An agent of Stable-Baselines3 or its kin with random transitions to learn from."""
    from stable_baselines3.common.logger import configure

    sac = algorithm(
        "MlpPolicy", _Blank(), batch_size=config.batch, learning_rate=config.critic_lr, buffer_size=4096,
        policy_kwargs={"net_arch": [config.hidden] * config.layers}, **settings,
    )  # fmt: skip
    sac.set_logger(configure(None, []))
    rng = np.random.default_rng(0)
    for _ in range(2048):
        obs, following = rng.standard_normal((2, 1, OBS), np.float32)
        sac.replay_buffer.add(obs, following, rng.uniform(-1, 1, (1, ACT)), rng.standard_normal(1), np.zeros(1), [{}])
    return sac
