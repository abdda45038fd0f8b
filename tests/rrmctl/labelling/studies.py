"""Studies to be labelled: runs that people teach, with sessions of random episodes that they have published."""

from __future__ import annotations

import numpy as np

from rrm.envs import make, task
from rrm.teachers.published import (
    PlayedEpisode,
    PublishedQuery,
    PublishedSession,
    ShownSegment,
    publish,
    segment_id,
)
from rrmctl.store.layout import Layout
from rrmctl.store.provenance import record_config
from rrmctl.store.status import RunState, Status, write_status
from rrmctl.store.sweeps import Job, SweepRecord, record_sweep

NAME = "study"
_REST = {"profile": "smoke", "steps": 10_000, "config_version": 1, "precision": "float32", "threads": 1}


def run_id(number):
    return f"{number + 1:016x}"


def make_study(root, runs=1, queries=4, name="toy-car", steps=(1000,), length=10):
    """Args: queries: of a session. steps: before which there is one."""
    layout = Layout(root)
    jobs = tuple(
        Job(id=run_id(at), cell=run_id(100 + at), task=name, method="pebble", teacher="human", feedback="4@10/8",
            seed=at, steps=10_000)
        for at in range(runs)
    )  # fmt: skip
    record_sweep(layout, SweepRecord(experiment=NAME, variant="smoke", profile="smoke", jobs=jobs))
    for at, job in enumerate(jobs):
        content = {"id": job.id, "cell": job.cell, "task": name, "method": "pebble", "teacher": "human", "seed": at}
        write = layout.run(job.id)
        record_config(write, content | {"feedback": {"segment": length}, **_REST})
        write_status(write, Status(state=RunState.WAITING, step=steps[-1] if steps else 0, steps=10_000))
        for number, step in enumerate(steps):
            publish_session(layout, job.id, step, queries, name=name, length=length, seed=10 * at + number)
    return layout


def publish_session(layout, run, step, queries, name="toy-car", length=10, seed=0, first=None):
    """A session of random pairs of the starts of random episodes. `first`: the index of its first query."""
    env, rng = make(name), np.random.default_rng(seed)
    episodes, returns = [], []
    for number in range(6):
        obs, _ = env.reset(seed=seed * 100 + number)
        start, seen, acts, rewards = env.state_dict(), [obs], [], []
        for _ in range(3 * length):
            acts.append(rng.uniform(-1, 1, env.action_space.shape).astype(np.float32))
            obs, reward, *_ = env.step(acts[-1])
            seen.append(obs)
            rewards.append(reward)
        episodes.append(PlayedEpisode(start, np.array(seen, np.float32), np.array(acts, np.float32)))
        returns.append(np.array(rewards))
    env.close()

    def segment():
        at, begin = int(rng.integers(6)), int(rng.integers(2 * length))
        window = slice(begin, begin + length)
        known = segment_id(name, episodes[at].obs[:-1][window], episodes[at].act[window])
        return ShownSegment(known, at, begin, float(returns[at][window].sum()))

    begin = first if first is not None else 0
    asked = tuple(
        PublishedQuery(begin + at, f"{rng.integers(2**63):016x}", segment(), segment()) for at in range(queries)
    )
    session = PublishedSession(
        run=run, task=name, step=step, length=length, repeat=1, horizon=task(name).horizon, queries=asked
    )
    publish(layout.run(run).path, session, episodes)
    return session


def end(layout, run):
    """The run is done."""
    write_status(layout.run(run), Status(state=RunState.DONE, step=10_000, steps=10_000))
