"""The runs that an experiment needs beside its own."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest

from rrm.imitation.demos import Demonstrations
from rrm.training.kinds import DemosConfig
from rrm.training.run_config import RunConfig
from rrmctl.errors import UserError
from rrmctl.planning.manifest import load, parse
from rrmctl.planning.plan import Plan, make_plan

EXPERIMENTS = Path(__file__).parents[3] / "experiments"
MAIN = load(EXPERIMENTS / "main-results.toml")


def manifest(tmp_path: Path, **table: object) -> object:
    base = {"title": "t", "reproduces": ["r"], "rule": "r"}
    return parse(base | table, tmp_path / "mine.toml")


def chain(plan: Plan) -> dict[str, str]:
    """Every run of the chain by its name."""
    return {job.method: job.id for job in plan.needed}


@pytest.mark.parametrize("scale", ["paper", "laptop", "quickstart", "smoke"])
def test_the_chain(scale: str) -> None:
    """Prior on demonstrations on the oracle of seed 0, which the experiment has already; one for all seeds."""
    plan = make_plan(MAIN, profile=scale, tasks=["button-press"], seeds=3)
    demos, airl = plan.needed
    (oracle,) = (job for job in plan.jobs if (job.method, job.seed) == ("oracle", 0))
    assert isinstance(plan.configs[demos.id], DemosConfig)
    assert isinstance(plan.configs[airl.id], RunConfig)
    assert (demos.method, airl.method, airl.seed) == ("demos", "airl", 0)
    assert demos.requires == (oracle.id,)
    assert airl.requires == (demos.id,)
    assert [job.requires for job in plan.jobs if job.method == "rrm-imitation"] == [(airl.id,)] * 3
    assert all(not job.requires for job in plan.jobs if job.method != "rrm-imitation")


def test_the_papers_numbers() -> None:
    """Appendix: a million steps after 5000 random ones, 100 steps of 128 + 128 every 1000, 50 demonstrations."""
    plan = make_plan(MAIN, tasks=["button-press"])
    demos, config = (plan.configs[job.id] for job in plan.needed)
    assert isinstance(config, RunConfig)
    assert isinstance(demos, DemosConfig)
    assert (config.steps, config.random_steps, demos.episodes) == (1_000_000, 5000, 50)
    imitation = config.imitation
    assert (imitation.every, imitation.updates, imitation.minibatch, imitation.window) == (1000, 100, 128, 20_000)
    assert (imitation.hidden, imitation.layers, imitation.lr) == (256, 3, 1e-4)


@pytest.mark.parametrize("scale", ["paper", "laptop", "quickstart", "smoke"])
@pytest.mark.parametrize("task", ["button-press", "walker-walk", "toy-car"])
def test_the_discriminator_sees_what_the_policy_did_in_twenty_rounds(scale: str, task: str) -> None:
    """Older transitions are of policies long gone; of the last round alone it would forget what earlier ones did."""
    toy = load(EXPERIMENTS / "toy-car.toml")
    chosen = {"priors": ["imitation"], "methods": ["oracle"]} if task == "toy-car" else {"tasks": [task]}
    plan = make_plan(toy if task == "toy-car" else MAIN, profile=scale, **chosen)  # type: ignore[arg-type]
    imitation = plan.configs[plan.needed[-1].id].imitation  # type: ignore[union-attr]
    assert imitation.window == 20 * imitation.every


def test_profiles_scale_the_chain() -> None:
    """Each scale trains its own prior, and a shorter one is cheaper."""
    lengths = {}
    for scale in ("paper", "laptop", "quickstart", "smoke"):
        plan = make_plan(MAIN, profile=scale, tasks=["button-press"])
        lengths[scale] = {job.method: job.steps for job in plan.needed}["airl"]
    assert lengths == {"paper": 1_000_000, "laptop": 60_000, "quickstart": 20_000, "smoke": 300}


def test_experiments_share_their_priors() -> None:
    """Steps, teacher and feedback of an experiment do not reach the chain: it is the profile's."""
    plans = [make_plan(load(EXPERIMENTS / f"{name}.toml"), tasks=["button-press"])
             for name in ("main-results", "noisy-teacher", "finetune")]  # fmt: skip
    assert len({chain(plan)["airl"] for plan in plans}) == 1
    oracles = [next(job.id for job in plan.jobs if job.method == "oracle") for plan in plans[:2]]
    assert {*oracles, chain(plans[2])["expert"]} == {oracles[0]}
    assert {job.steps for job in plans[1].jobs} == {300_000, 500_000}


def test_settings_of_the_chain_reach_it_and_those_who_need_it() -> None:
    """`imitation.*` alone, in proportion to the profile in a manifest and as it stands after --set."""
    plans = [make_plan(MAIN, profile="laptop", tasks=["button-press"], methods=["rrm-imitation"], overrides=given)
             for given in ([], ["imitation.steps=9000"], ["agent.batch=64"])]  # fmt: skip
    ids = [{job.id for job in plan.jobs} for plan in plans]
    assert not ids[0] & ids[1]
    assert chain(plans[0])["airl"] != chain(plans[1])["airl"]
    assert chain(plans[0])["demos"] == chain(plans[1])["demos"]
    assert chain(plans[0]) == chain(plans[2])
    assert plans[1].needed[-1].steps == 9000


def test_amounts_in_a_manifest_shrink_with_the_profile(tmp_path: Path) -> None:
    """Half the paper's length is half the laptop's."""
    mine = manifest(
        tmp_path,
        grid={"tasks": ["button-press"], "methods": ["rrm-imitation"]},
        defaults={"imitation": {"steps": 500_000}},
    )
    assert make_plan(mine, profile="laptop").needed[-1].steps == 30_000  # type: ignore[arg-type]


def test_fine_tuning_needs_demonstrations_alone() -> None:
    """It trains its own g."""
    plan = make_plan(load(EXPERIMENTS / "finetune.toml"), methods=["finetune"])
    assert list(chain(plan)) == ["expert", "demos"]
    config = plan.configs[plan.jobs[0].id]
    assert isinstance(config, RunConfig)
    assert config.requires == (chain(plan)["demos"],)
    assert (config.random_steps, config.first_session) == (5000, 400_000)
    assert config.sessions() == 20


def demonstrations(path: Path, value: float = 0.0) -> None:
    obs = np.full((2, 15), value, np.float32)
    Demonstrations(
        obs=obs, next_obs=obs, act=np.zeros((2, 2), np.float32), terminated=np.zeros(2, np.uint8),
        lengths=np.array([2]), returns=np.zeros(1), successes=np.ones(1), provenance={"task": "toy-car"},
    ).save(path)  # fmt: skip


def test_demonstrations_of_ones_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Nothing collects any; the content is part of the prior's identity; paths are seen from where they are written."""
    toy = load(EXPERIMENTS / "toy-car.toml")
    ids = []
    for name, value in (("a", 0.0), ("b", 0.0), ("c", 1.0)):
        (tmp_path / name).mkdir()
        monkeypatch.chdir(tmp_path / name)
        demonstrations(Path("d.safetensors"), value)
        plan = make_plan(toy, priors=["imitation"], methods=["oracle"], overrides=["imitation.demos=d.safetensors"])
        assert list(chain(plan)) == ["airl"]
        ids.append(chain(plan)["airl"])
    assert ids[0] == ids[1] != ids[2]
    shutil.copy("d.safetensors", tmp_path / "d.safetensors")
    monkeypatch.chdir("/")
    mine = manifest(
        tmp_path, grid={"tasks": ["toy-car"], "methods": ["sac-imitation"]},
        defaults={"imitation": {"demos": "d.safetensors"}},
    )  # fmt: skip
    assert chain(make_plan(mine))["airl"] == ids[2]  # type: ignore[arg-type]
    with pytest.raises(UserError, match=r"toy-car, rrm-imitation: cannot read /nowhere"):
        make_plan(toy, priors=["imitation"], methods=["oracle"], overrides=["imitation.demos=/nowhere"])


def test_what_planning_decides_cannot_be_set() -> None:
    """Identities of the chain are not a person's to give."""
    for key in ("reward.prior_run", "imitation.demos_run", "imitation.demos_digest"):
        with pytest.raises(UserError, match="cannot be set here"):
            make_plan(MAIN, overrides=[f"{key}=0123456789abcdef"])


def test_the_chain_of_an_image_task() -> None:
    """A state's expert acts as the run does, and is filmed as the run looks; whoever borrows the encoder needs all."""
    encoder = load(EXPERIMENTS / "image-encoder.toml")
    chosen = ["camera.size=40", "action_repeat=5"]
    plan = make_plan(encoder, profile="smoke", tasks=["button-press-image"], seeds=1, overrides=chosen)
    expert, demos, airl = (plan.configs[job.id] for job in plan.needed)
    assert isinstance(expert, RunConfig)
    assert isinstance(demos, DemosConfig)
    assert isinstance(airl, RunConfig)
    assert (expert.task, expert.agent.kind, expert.action_repeat) == ("button-press", "sac", 5)
    assert demos.frames == airl.spaces.frames
    assert demos.frames is not None
    assert demos.frames.planar == (3, 40, 40)
    assert (demos.sees_frames, airl.action_repeat) == (True, 5)
    borrowing = {job.method: job.requires for job in plan.jobs}
    assert borrowing.pop("oracle") == ()
    assert set(borrowing.values()) == {(airl.identity,)}
    main = make_plan(MAIN, profile="smoke", tasks=["button-press-image"], seeds=1)
    assert {job.method for job in main.jobs if job.requires} == {"rrm-imitation"}


def test_the_chain_of_an_arm() -> None:
    """Expert and prior play where the run plays: what varies there varies here, and makes other runs of them."""
    chosen = {"profile": "smoke", "methods": ["rrm-imitation"], "seeds": 1}
    grid = {"tasks": ["panda-push"], "methods": ["oracle", "rrm-imitation"]}
    arm = parse({"title": "t", "reproduces": ["r"], "rule": "r", "grid": grid}, Path("arm.toml"))
    usual = make_plan(arm, **chosen)  # type: ignore[arg-type]
    plan = make_plan(arm, **chosen, overrides=["env.friction=[0.3, 0.9]"])  # type: ignore[arg-type]
    expert, demos, airl = (plan.configs[job.id] for job in plan.needed)
    assert isinstance(demos, DemosConfig)
    for config in (expert, demos.expert, airl):
        assert isinstance(config, RunConfig)
        assert config.env.ranges() == {"friction": (0.3, 0.9)}
    assert not {job.id for job in plan.needed} & {job.id for job in usual.needed}


def test_an_encoder_of_another_shape_is_refused_before_anything_is_trained() -> None:
    """Unless the run's agent begins with a fresh one."""
    chosen = {"profile": "smoke", "tasks": ["button-press-image"], "methods": ["rrm-imitation"], "seeds": 1}
    with pytest.raises(
        UserError, match=r"agent\.encoder: that of the prior imitation has 4 channels .* has 8 channels"
    ):
        make_plan(MAIN, **chosen, overrides=["agent.channels=8"])  # type: ignore[arg-type]
    fresh = ["agent.channels=8", "agent.encoder=fresh"]
    assert make_plan(MAIN, **chosen, overrides=fresh).jobs  # type: ignore[arg-type]
