"""What a run on images costs beside the update of its agent (`drqv2_update`), on button-press-image: reading and moving
pictures, feedback sessions, checkpoints, and the memory of a million pictures.

The state of mid-run is made as in `training_loop`: real steps of random actions, repeated, and the labels of half a
run. A million pictures take 13 GB of disk, in the folder for temporary files, and as much memory for the system to keep
them in, which is what their batches are read from here.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator

import torch

from benchmarks.lines import Line, apart, in_turns, peak_mib
from benchmarks.training_loop import CHECKPOINT_S, checkpoint_seconds, hold, mid_run, session_seconds, shipped
from rrm.buffers.replay import Replay
from rrm.nets.shift import pictures
from rrm.training.loop import Trainer

TASK, PROFILE = "button-press-image", "laptop"
_REAL = 500  # transitions
_PICTURES = 1_000_000
_FEW = 5_000
_STEPS_A_SECOND, _SESSIONS, _CHECKPOINT, _READING, _MIB = 65, 12, 1, 5, 1024


def lines(
    profiles: tuple[str, ...] = (PROFILE, "paper"),
    *,
    stored: int = _PICTURES,
    budget: float = 1.5,
    interval: float = CHECKPOINT_S,
) -> Iterator[Line]:
    """Reading at the scales of all profiles; loop, sessions, checkpoint and memory at that of the first."""
    torch.set_num_threads(1)
    for profile in profiles:
        yield _reading(profile, budget)
    yield from _loop(profiles[0], budget, interval)
    yield from _memory(profiles[0], stored)


def _begun(method: str, profile: str, transitions: int, labels: int = 0) -> Trainer:
    return mid_run(shipped(method, TASK, profile), transitions, labels, real=_REAL)


def _replay(trainer: Trainer) -> Replay:
    return Replay(trainer.experience, trainer.config.agent.batch, torch.Generator().manual_seed(0))


def _reading(profile: str, budget: float) -> Line:
    """Share of an update, drawing its batch included."""
    trainer = _begun("oracle", profile, _FEW)
    agent, replay, stack = trainer.agent, _replay(trainer), trainer.config.spaces.frames.stack  # type: ignore[union-attr]
    batch = replay.sample()
    assert batch.frames is not None
    seen, then = batch.frames[:, :stack], batch.frames[:, -stack:]
    moves = torch.randint(-4, 5, (2, len(seen), 2), generator=torch.Generator().manual_seed(0))

    def move() -> None:
        pictures(seen, moves[0])
        pictures(then, moves[1])

    read_s, move_s, update_s = in_turns(replay.sample, move, lambda: agent.update(batch), turns=5, budget=budget / 2)
    trainer.close()
    return Line(
        item=f"reading and moving pictures, of an update, {profile}", unit="%", bound=_READING,
        ours=100 * (read_s + move_s) / (read_s + update_s),
        note=f"batch {len(seen)}: {1e3 * read_s:.1f} and {1e3 * move_s:.1f} ms, update {1e3 * update_s:.0f} ms",
    )  # fmt: skip


def _loop(profile: str, budget: float, interval: float) -> Iterator[Line]:
    """Steps of the environment a second of processor time, in the middle of a run."""
    for method in ("oracle", "rrm-penalty"):
        config = shipped(method, TASK, profile)
        half, feedback, repeat = config.steps // config.action_repeat // 2, config.feedback, config.action_repeat
        trainer = _begun(method, profile, half, feedback.budget // 2 if feedback else 0)
        session_s = session_seconds(trainer) / feedback.every if feedback else 0.0
        (act_s,) = in_turns(trainer.advance, turns=5, budget=budget)
        step_s = session_s + act_s / repeat
        yield Line(
            item=f"loop on {TASK}, {profile}, {method}", ours=1 / step_s, unit="/s", bound=_STEPS_A_SECOND,
            note=f"of a core; {1e3 * act_s:.1f} ms an action",
        )  # fmt: skip
        if feedback:
            yield Line(
                item="feedback sessions, of that loop", ours=100 * session_s / step_s, unit="%", bound=_SESSIONS,
                note=f"{session_s * feedback.every:.1f} s every {feedback.every:,} steps, {half:,} transitions",
            )  # fmt: skip
            checkpoint_s = checkpoint_seconds(trainer, steps=int(interval / step_s / repeat))
            yield Line(
                item="checkpoint, of that loop", ours=100 * checkpoint_s / interval, unit="%", bound=_CHECKPOINT,
                note=f"{1e3 * checkpoint_s:.0f} ms every {interval:g} s",
            )  # fmt: skip
        trainer.close()


def _memory(profile: str, stored: int) -> Iterator[Line]:
    (last_mib,) = apart("benchmarks.images", "last", profile)
    yield Line(item=f"resident memory, {profile}, rrm-penalty, last session", ours=last_mib, unit="MiB", bound=_MIB)
    mib, read_ms, few_ms = apart("benchmarks.images", "stored", profile, stored)
    yield Line(item=f"resident memory, {stored:,} pictures", ours=mib, unit="MiB", bound=_MIB)
    yield Line(
        item=f"reading a batch, {profile}, of {stored:,} pictures", ours=read_ms, unit="ms",
        note=f"of {_REAL}: {few_ms:.2g} ms",
    )  # fmt: skip


def _last(profile: str) -> list[float]:
    """Largest resident size in MiB of a run that holds its last session and goes on."""
    config = shipped("rrm-penalty", TASK, profile)
    assert config.feedback is not None
    trainer = _begun("rrm-penalty", profile, config.steps // config.action_repeat, config.feedback.budget // 2)
    hold(trainer, trainer.step)
    trainer.advance()
    return [peak_mib()]


def _stored(profile: str, stored: int) -> list[float]:
    """Largest resident size in MiB of a run with so many pictures, and milliseconds of a batch of them and of few."""
    few, many = (_begun("oracle", profile, count) for count in (_REAL, stored))
    many.advance()
    read_s, few_s = in_turns(_replay(many).sample, _replay(few).sample, turns=5)
    return [peak_mib(), 1e3 * read_s, 1e3 * few_s]


if __name__ == "__main__":
    torch.set_num_threads(1)
    what, profile, *count = sys.argv[1:]
    print(*(_last(profile) if what == "last" else _stored(profile, int(count[0]))))
