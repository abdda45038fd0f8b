"""Sweeps that deploy: what is planned after the runs, what is part of which identity, and what a record keeps."""

from dataclasses import replace
from pathlib import Path

import pytest

from rrm.training.kinds import DeploymentConfig
from rrm.training.run_config import RunConfig
from rrmctl.errors import UserError
from rrmctl.planning.manifest import load, parse
from rrmctl.planning.plan import make_plan
from rrmctl.running.config_file import config_content
from rrmctl.running.deployments import own_rig
from rrmctl.running.scheduler import Outcome, Scheduler, Stage
from rrmctl.store.layout import Layout
from rrmctl.store.provenance import record_config
from rrmctl.store.sweeps import SweepRecord, deployments_first, deployments_of, read_sweep, record_sweep

MANIFEST = load(Path(__file__).parents[3] / "experiments" / "sim-to-real.toml")
ONE = {"tasks": ["panda-reach"], "methods": ["pebble"], "seeds": "1"}


def plan(*overrides, profile="paper", **options):
    return make_plan(MANIFEST, profile=profile, overrides=overrides, **{**ONE, **options})


def only(asked):
    """The run and its deployment."""
    (run,) = (asked.configs[job.id] for job in asked.jobs)
    (deployment,) = (asked.configs[job.id] for job in asked.deployments)
    assert isinstance(run, RunConfig)
    assert isinstance(deployment, DeploymentConfig)
    return run, deployment


def test_every_run_is_deployed():
    """The paper's checkpoints, at its length or at their share of a shorter one; a deployment needs its run alone."""
    for profile, reach, push in (
        ("paper", (50_000, 100_000, 150_000), (400_000, 600_000, 800_000)),
        ("laptop", (10_000, 20_000, 30_000), (60_000, 90_000, 120_000)),
        ("smoke", (200, 400, 600), (240, 360, 480)),
    ):
        asked = plan(profile=profile, tasks=None, methods=None, seeds="2")
        assert len(asked.jobs) == len(asked.deployments) == 12
        assert [job.requires for job in asked.deployments] == [(job.id,) for job in asked.jobs]
        for job in asked.deployments:
            assert job.method.endswith(" deployed")
            assert asked.configs[job.id].checkpoints == (reach if job.task == "panda-reach" else push)
            assert job.steps == asked.configs[job.id].steps == asked.configs[job.id].checkpoints[-1]
        assert len({job.cell for job in asked.deployments}) == 6


def test_what_is_kept_is_the_runs_and_how_it_is_deployed_is_not():
    """Episodes and rig make another deployment of the same run; other checkpoints make another run."""
    run, deployment = only(plan())
    for changed in ("deploy.episodes=3", "deploy.rig.latency=[0, 1]", "deploy.rig.noise=1.0"):
        same, other = only(plan(changed))
        assert same.identity == run.identity
        assert other.identity != deployment.identity
    assert (deployment.episodes, deployment.policy.deploy.rig.width) == (20, 640)
    other, _ = only(plan("deploy.checkpoints=[50_000, 150_000]"))
    assert other.identity != run.identity
    nothing = plan("deploy.checkpoints=[]")
    assert nothing.deployments == ()
    assert run.model_copy(update={"deploy": type(run.deploy)()}).identity == nothing.jobs[0].id


@pytest.mark.parametrize(
    ("setting", "message"),
    [
        ("deploy.checkpoints=[200_000]", "200000 comes after the run's end at 150000"),
        ("deploy.checkpoints=[5000, 5000]", "5000, 5000 do not rise"),
        ("action_repeat=2", "action_repeat must be 1"),
        ("deploy.rig.latency=[3, 1]", "from its lower to its upper end"),
        ("deploy.rig.heigth=480", 'did you mean "deploy.rig.height"'),
    ],
)
def test_what_cannot_be_deployed(setting, message):
    """One message, before anything is trained."""
    with pytest.raises(UserError, match=message.replace("[", r"\[")):
        plan(setting)


def test_an_arm_does_its_own_tasks_alone():
    """The message names them."""
    table = {"title": "t", "reproduces": ["r"], "rule": "r", "grid": {"tasks": ["toy-car"], "methods": ["oracle"]}}
    table["defaults"] = {"deploy": {"checkpoints": [500]}}
    with pytest.raises(UserError, match="an arm has nothing to do in toy-car; it has in panda-reach"):
        make_plan(parse(table, Path("a.toml")), seeds=1)


def recorded(asked):
    return SweepRecord(**{name: getattr(asked, name) for name in SweepRecord.__dataclass_fields__})


def test_a_deployment_starts_as_soon_as_its_policies_are_there():
    """Not behind the trainings of other seeds, which take hours."""
    asked = recorded(plan(seeds="3"))
    scheduler = Scheduler(
        [job.id for job in deployments_first(asked.everything, [asked])], slots=1,
        requires={job.id: job.requires for job in asked.everything},
    )  # fmt: skip
    started = []
    while (job := scheduler.next()) is not None:
        scheduler.start(job)
        scheduler.end(job, Outcome(Stage.DONE))
        started.append(job)
    runs, after = ([job.id for job in jobs] for jobs in (asked.jobs, asked.deployments))
    assert started == [each for pair in zip(runs, after, strict=True) for each in pair]


def test_a_run_is_deployed_by_hand_where_its_sweep_deploys_it(tmp_path):
    """Its own configuration does not tell; of two workplaces neither is its own, and without any it is the usual."""
    layout = Layout(tmp_path)
    for settings, expected in (((), 0.7), (("deploy.rig.blur=2",), 2.0), (("deploy.rig.blur=3",), 0.7)):
        asked = plan(*settings)
        (job,) = asked.jobs
        if settings:
            record_sweep(layout, recorded(asked))
            for each in asked.everything:
                record_config(layout.run(each.id), config_content(asked.configs[each.id]))
        assert own_rig(layout.run(job.id)).blur == expected


def test_a_record_keeps_deployments_of_what_it_asks_for(tmp_path):
    """They are read as written; those of runs that were superseded go; records without any have no such key."""
    layout, first = Layout(tmp_path), recorded(plan())
    record_sweep(layout, first)
    path = layout.sweep("sim-to-real", "paper")
    assert read_sweep(path) == first
    assert first.everything == (*first.jobs, *first.deployments)
    other = replace(recorded(plan("agent.batch=256")), variant="paper", overrides={})
    union = record_sweep(layout, other)
    assert union.deployments == other.deployments
    assert union.superseded == first.jobs
    assert deployments_of(first.jobs, union.deployments) == ()
    plain = replace(recorded(plan("deploy.checkpoints=[]")), variant="plain", overrides={})
    record_sweep(layout, plain)
    assert "deployments" not in layout.sweep("sim-to-real", "plain").read_text()
    assert read_sweep(layout.sweep("sim-to-real", "plain")) == plain
