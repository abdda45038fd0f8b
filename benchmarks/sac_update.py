"""SAC updates per second beside what the arithmetic alone would allow on the same core.

    taskset -c 0 python benchmarks/sac_update.py

The floor is the update's multiplications and additions, no unused gradient counted, divided by the rate of one
batch x hidden x hidden product. Updates and products are timed in turns, so that a busy machine slows both alike; the
share is the median over the turns.
"""

from __future__ import annotations

import argparse
import statistics
import time
from collections.abc import Callable

import torch

from rrm.agents.sac import Sac
from rrm.config import AgentConfig
from rrm.seeding import Streams
from rrm.types import Batch

OBS, ACT = 39, 4  # Meta-World


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


def make_update(config: AgentConfig) -> Callable[[], None]:
    """An agent's update on random data."""
    sac = Sac(config, OBS, ACT, Streams(0))
    rows = config.batch
    obs, next_obs = torch.randn(2, rows, OBS)
    batch = Batch(obs, torch.rand(rows, ACT) * 2 - 1, torch.zeros(rows), torch.randn(rows), next_obs, torch.ones(rows))
    return lambda: sac.update(batch)


def make_product(config: AgentConfig) -> Callable[[], None]:
    """The product whose rate is the measure."""
    x, w = torch.randn(config.batch, config.hidden), torch.randn(config.hidden, config.hidden)
    out = torch.empty(config.batch, config.hidden)

    def product() -> None:
        torch.mm(x, w, out=out)

    return product


def seconds(work: Callable[[], None], budget: float) -> float:
    """Seconds per call, averaged over about `budget` seconds."""
    calls, start = 0, time.process_time()
    while (passed := time.process_time() - start) < budget:
        work()
        calls += 1
    return passed / calls


def measure(config: AgentConfig, turns: int, budget: float) -> str:
    """One line of the table."""
    update, product = make_update(config), make_product(config)
    for warm_up in (update, product):
        seconds(warm_up, budget)
    pairs = [(seconds(update, budget), seconds(product, budget)) for _ in range(turns)]
    flop, product_flop = update_flop(config), 2.0 * config.batch * config.hidden**2
    share = statistics.median(flop * p / product_flop / u for u, p in pairs)
    rate = statistics.median(product_flop / p for _, p in pairs)
    updates = statistics.median(1 / u for u, _ in pairs)
    return (
        f"{config.batch:>5} {config.hidden:>4}x{config.layers} {flop / 1e9:>7.2f} {rate / 1e9:>8.0f} "
        f"{rate / flop:>10.1f} {updates:>10.1f} {share:>7.1%}"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--batch", type=int, nargs="+", default=[512, 128])
    parser.add_argument("--hidden", type=int, default=256)
    parser.add_argument("--layers", type=int, default=3)
    parser.add_argument("--turns", type=int, default=15, help="alternations of updates and products")
    parser.add_argument("--budget", type=float, default=0.3, help="seconds of each in a turn")
    args = parser.parse_args()
    torch.set_num_threads(1)
    print("batch   net   GFLOP  GFLOP/s  floor/s  updates/s  share")
    for batch in args.batch:
        config = AgentConfig(batch=batch, hidden=args.hidden, layers=args.layers)
        print(measure(config, args.turns, args.budget))


if __name__ == "__main__":
    main()
