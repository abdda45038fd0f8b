"""Plans: which runs an experiment means, with which settings, under which names."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from rrm.config import DrmConfig
from rrm.envs.tasks import TASKS
from rrm.training.run_config import RunConfig
from rrmctl.errors import UserError
from rrmctl.planning import manifest
from rrmctl.planning.plan import Plan, make_plan, parse_seeds, variant
from rrmctl.planning.prerequisites import Config
from rrmctl.planning.profiles import profiles
from rrmctl.store.sweeps import Job

EXPERIMENTS = Path(__file__).parents[3] / "experiments"

GRID: dict[str, Any] = {"tasks": ["toy-car"], "methods": ["oracle", "pebble"]}


def made(grid: Any = None, **sections: Any) -> manifest.Manifest:
    """A manifest of the toy task with these sections."""
    table = {"title": "T", "reproduces": ["F"], "rule": "R", "seeds": 2, "grid": grid or GRID, **sections}
    return manifest.parse(table, Path("mine.toml"))


def rows(plan: Plan) -> list[tuple[str, str, str, str, int]]:
    return [(j.task, j.method, j.teacher, j.feedback, j.seed) for j in plan.jobs]


def only(plan: Plan, method: str) -> Job:
    return next(job for job in plan.jobs if job.method == method)


def config(plan: Plan, job: Job | None = None) -> Config:
    """Of a job; of the first if none is named."""
    return plan.configs[(job or plan.jobs[0]).id]


def refused(experiment: manifest.Manifest, **options: Any) -> UserError:
    with pytest.raises(UserError) as caught:
        make_plan(experiment, **options)
    return caught.value


def test_grid_and_seeds() -> None:
    """Every combination once for every seed, seed by seed; nothing is asked of a teacher where the reward is known."""
    assert rows(make_plan(made())) == [
        ("toy-car", "oracle", "-", "-", 0),
        ("toy-car", "pebble", "oracle", "20@500/400", 0),
        ("toy-car", "oracle", "-", "-", 1),
        ("toy-car", "pebble", "oracle", "20@500/400", 1),
    ]


def test_more_seeds_keep_the_first() -> None:
    """The jobs of five seeds are among those of ten, with the same ids."""
    five, ten = (make_plan(made(), seeds=n) for n in ("5", "10"))
    assert {job.id for job in five.jobs} < {job.id for job in ten.jobs}
    assert len({job.id for job in ten.jobs}) == 20


def test_ids_are_identities() -> None:
    """A job's id is its configuration's identity, whatever the experiment is called."""
    plan = make_plan(made())
    job = plan.jobs[1]
    assert job.id == config(plan, job).identity
    assert (job.cell, job.steps, job.requires) == (config(plan, job).cell, config(plan, job).steps, ())
    other = manifest.parse(
        {"title": "U", "reproduces": ["G"], "rule": "S", "grid": {"tasks": ["toy-car"], "methods": ["pebble"]}},
        Path("other.toml"),
    )
    assert job.id == make_plan(other, seeds="1").jobs[0].id


@pytest.mark.parametrize(
    ("task", "steps", "feedback", "epochs"),
    [
        ("button-press", 500_000, "50@5000/5000", 10),
        ("door-open", 500_000, "50@5000/5000", 10),
        ("door-unlock", 500_000, "50@5000/5000", 10),
        ("window-open", 500_000, "50@5000/5000", 10),
        ("sweep-into", 1_000_000, "50@5000/10000", 10),
        ("walker-walk", 500_000, "50@20000/500", 50),
        ("quadruped-walk", 1_000_000, "50@30000/1000", 50),
    ],
)
def test_paper_budgets(task: str, steps: int, feedback: str, epochs: int) -> None:
    """Steps, feedback and reward epochs of each task are the paper's."""
    plan = make_plan(made({"tasks": [task], "methods": ["oracle", "pebble", "rrm-proxy", "sac-proxy"]}), seeds="1")
    pebble = config(plan, only(plan, "pebble"))
    assert (pebble.steps, only(plan, "pebble").feedback, pebble.reward.epochs) == (steps, feedback, epochs)
    phases = [(job.method, config(plan, job).exploration) for job in plan.jobs]
    assert [(method, phase.seed_steps, phase.unsupervised_steps) for method, phase in phases] == [
        ("oracle", 5000, 0),
        ("pebble", 1000, 9000),
        ("rrm-proxy", 2000 if task.endswith("walk") else 1000, 0),  # feedback waits for two episodes
        ("sac-proxy", 5000, 0),
    ]


@pytest.mark.parametrize(
    ("name", "learner", "prior"),
    [
        ("oracle", "true", None),
        ("pebble", "pebble", None),
        ("sac-h2o", "prior", "h2o"),
        ("rrm-o2g", "pebble", "o2g"),
        ("rrm-pebble-o2g", "pebble", "o2g"),
        ("surf", "surf", None),
        ("rrm-surf-proxy", "surf", "proxy"),
        ("mrn", "mrn", None),
        ("rrm-mrn-proxy", "mrn", "proxy"),
    ],
)
def test_method_names(name: str, learner: str, prior: str | None) -> None:
    """A method's name says its learner and its prior."""
    reward = config(make_plan(made({"tasks": ["button-press"], "methods": [name]}))).reward
    assert (reward.learner, reward.prior) == (learner, prior)


def test_surfs_and_mrns_feedback() -> None:
    """Budgets of Fig. base; batch and schedule of the two methods' own code; the baselines explore first."""
    found = {}
    for name in ("surf", "mrn"):
        plan = make_plan(manifest.load(EXPERIMENTS / f"{name}.toml"), seeds="1")
        for job in plan.jobs:
            found[job.task, job.method] = job.feedback, config(plan, job).exploration.unsupervised_steps
            assert config(plan, job).reward.epochs == (20 if "surf" in job.method else 10)
    for task, name, feedback in (
        ("button-press", "surf", "50@5000/2000"),
        ("sweep-into", "surf", "50@5000/5000"),
        ("door-open", "mrn", "10@5000/1000"),
        ("button-press", "mrn", "10@5000/100"),
    ):
        assert found[task, name] == (feedback, 9000)
        assert found[task, f"rrm-{name}-proxy"] == (feedback, 0)
        assert (task, "oracle") in found


@pytest.mark.parametrize("scale", list(profiles()))
def test_mrn_refines_at_every_scale(scale: str) -> None:
    """Between the first session and the one that spends the budget there are steps on the outer loss."""
    plan = make_plan(manifest.load(EXPERIMENTS / "mrn.toml"), profile=scale, seeds="1")
    for run in (config(plan, job) for job in plan.jobs):
        if run.feedback is not None:
            last = run.first_session + (run.sessions() - 1) * run.feedback.every
            assert last > (run.first_session // run.reward.mrn.every + 1) * run.reward.mrn.every


def test_mrn_refines_as_often_in_a_shorter_training() -> None:
    """Steps on the outer loss while questions are left, beside the paper's."""
    counts = []
    for scale in ("paper", "laptop"):
        plan = make_plan(manifest.load(EXPERIMENTS / "mrn.toml"), profile=scale, tasks=["button-press"], seeds="1")
        run = config(plan, only(plan, "mrn"))
        assert isinstance(run, RunConfig)
        assert run.feedback is not None
        last = run.first_session + (run.sessions() - 1) * run.feedback.every
        counts.append((last - 1) // run.reward.mrn.every - run.first_session // run.reward.mrn.every)
    assert counts == [4, 4]


@pytest.mark.parametrize("scale", ["paper", "laptop"])
def test_the_harder_task_on_images(scale: str) -> None:
    """DrM learns it, but for the prior alone, and is perturbed as often in a shorter training.

    The noise of the policy that the prior is learned from has faded in time.
    """
    chosen: dict[str, Any] = {"profile": scale, "tasks": ["sweep-into-image"], "seeds": "1"}
    plan = make_plan(manifest.load(EXPERIMENTS / "main-results.toml"), **chosen)
    alone = make_plan(manifest.load(EXPERIMENTS / "image-ablation.toml"), **chosen)
    assert {run.agent.kind for run in map(plan.configs.get, (job.id for job in plan.jobs))} == {"drm"}  # type: ignore[union-attr]
    kinds = {job.method: alone.configs[job.id].agent.kind for job in alone.jobs}  # type: ignore[union-attr]
    assert kinds == {
        "drqv2-penalty": "drqv2", "drqv2-language": "drqv2", "rrm-penalty": "drm", "rrm-language": "drm"
    }  # fmt: skip
    demos, airl = (plan.configs[job.id] for job in plan.needed[-2:])
    assert isinstance(airl, RunConfig)
    assert isinstance(airl.agent, DrmConfig)
    run = config(plan, only(plan, "oracle"))
    assert isinstance(run, RunConfig)
    assert isinstance(run.agent, DrmConfig)
    assert airl.agent.stddev_steps < airl.steps
    assert run.steps // run.agent.perturb_every == 5
    assert demos.episodes == {"paper": 500, "laptop": 100}[scale]  # type: ignore[union-attr]


def test_settings_of_a_learner() -> None:
    """They are set like any other, a profile shrinks MRN's interval, and what does not fit names its layer."""
    grid = {"tasks": ["button-press"], "methods": ["surf", "mrn"]}
    experiment = made(grid, defaults={"reward": {"mrn": {"every": 20_000}, "surf": {"threshold": 0.9}}})
    plan, laptop = make_plan(experiment, seeds="1"), make_plan(experiment, profile="laptop", seeds="1")
    surf, mrn = (config(plan, only(plan, name)).reward for name in ("surf", "mrn"))
    assert (surf.surf.threshold, mrn.mrn.every) == (0.9, 20_000)
    assert config(laptop, only(laptop, "mrn")).reward.mrn.every == 4_000
    error = refused(experiment, overrides=["reward.surf.crop=30"])
    assert "reward.surf.crop: 30 steps more or less; 10 at the most" in str(error)
    assert "is set in --set" in str(error.hint)
    assert 'unknown setting "reward.surf.treshold"; did you mean "reward.surf.threshold"' in str(
        refused(experiment, overrides=["reward.surf.treshold=0.5"])
    )


def test_sections_win_in_order() -> None:
    """Later sections win: defaults, grid, task, feedback, teacher, method, include, profile, --set."""
    names = ["agent.batch", "agent.hidden", "agent.layers", "members", "epochs", "capacity", "minibatch", "lr", "tau"]
    assert len(names) == 9
    experiment = made(
        {**GRID, "methods": ["pebble"], "set": {"agent": {"batch": 2, "hidden": 2}}},
        defaults={"agent": {"batch": 1, "hidden": 1, "layers": 1, "tau": 0.1}},
        task={"toy-car": {"agent": {"hidden": 3, "layers": 3}}},
        method={"pebble": {"agent": {"layers": 4}, "reward": {"hidden": 4}}},
        profile={"smoke": {"reward": {"hidden": 5}, "agent": {"tau": 0.2}}},
    )
    smoke = config(make_plan(experiment, profile="smoke", overrides=["agent.tau=0.3"]))
    assert (smoke.agent.batch, smoke.agent.hidden, smoke.agent.layers) == (2, 3, 4)
    assert (smoke.reward.hidden, smoke.agent.tau) == (5, 0.3)
    assert config(make_plan(experiment)).reward.hidden == 4


def test_amounts_shrink_with_the_profile() -> None:
    """A manifest's steps and feedback are at the paper's scale and keep their proportion elsewhere; sizes stay."""
    experiment = made(
        {"tasks": ["button-press"], "methods": ["pebble"], "feedback": ["default", "rare"]},
        feedback={"rare": {"every": 20_000, "batch": 25}},
        method={"pebble": {"agent": {"hidden": 300}}},
    )
    paper = [job.feedback for job in make_plan(experiment, seeds="1").jobs]
    assert paper == ["50@5000/5000", "25@20000/5000"]
    smoke = make_plan(experiment, profile="smoke", seeds="1")
    assert [job.feedback for job in smoke.jobs] == ["8@100/24", "4@400/24"]
    assert config(smoke).agent.hidden == 300


def test_profile_sections_and_set_are_literal() -> None:
    """What is said for one profile, or on the command line, is not scaled."""
    experiment = made(profile={"smoke": {"steps": 700}})
    assert config(make_plan(experiment, profile="smoke")).steps == 700
    assert config(make_plan(experiment, profile="smoke", overrides=["steps=900"])).steps == 900


def test_paired_axes() -> None:
    """Axes of a `zip` advance together while the others are crossed with them."""
    grid = {
        "tasks": ["toy-car", "walker-walk"],
        "methods": ["pebble", "rrm-zero"],
        "teachers": ["oracle", "mistaken-10"],
        "zip": [["tasks", "teachers"]],
    }
    plan = make_plan(made(grid), seeds="1")
    assert [(j.task, j.method, j.teacher) for j in plan.jobs] == [
        ("toy-car", "pebble", "oracle"),
        ("toy-car", "rrm-zero", "oracle"),
        ("walker-walk", "pebble", "mistaken-10"),
        ("walker-walk", "rrm-zero", "mistaken-10"),
    ]
    assert config(plan, plan.jobs[2]).teacher is not None
    assert config(plan, plan.jobs[2]).teacher.mistake == 0.1
    error = refused(made({**grid, "tasks": ["toy-car"]}))
    assert "there are 1 tasks, 2 teachers" in str(error)


def test_include_and_exclude() -> None:
    """Partial matches take rows out; an include adds rows for every value of the axes it leaves open."""
    grid = {
        "tasks": ["toy-car", "button-press"],
        "methods": ["oracle", "pebble"],
        "exclude": [{"task": "toy-car", "method": "pebble"}],
        "include": [{"method": "rrm-zero", "set": {"agent": {"batch": 9}}}],
    }
    plan = make_plan(made(grid), seeds="1")
    assert [(j.task, j.method) for j in plan.jobs] == [
        ("toy-car", "oracle"),
        ("button-press", "oracle"),
        ("button-press", "pebble"),
        ("toy-car", "rrm-zero"),
        ("button-press", "rrm-zero"),
    ]
    assert [config(plan, job).agent.batch for job in plan.jobs] == [64, 512, 512, 9, 9]
    assert 'exclude {method = "peble"}: no row' in str(refused(made({**GRID, "exclude": [{"method": "peble"}]})))
    everything = [{"method": "oracle"}, {"method": "pebble"}]
    assert "leaves no row" in str(refused(made({**GRID, "exclude": everything})))


def test_equal_runs_are_one_job() -> None:
    """What a teacher would say changes nothing where nobody asks: one oracle run for all teachers."""
    plan = make_plan(made({**GRID, "teachers": ["oracle", "mistaken-10", "stochastic"]}), seeds="1")
    assert [(j.method, j.teacher) for j in plan.jobs] == [
        ("oracle", "-"),
        ("pebble", "oracle"),
        ("pebble", "mistaken-10"),
        ("pebble", "stochastic"),
    ]


def test_own_teachers_and_schedules() -> None:
    """A manifest defines teachers and feedback schedules; a label names a schedule that sets more than amounts."""
    experiment = made(
        {**GRID, "methods": ["pebble"], "teachers": ["tired"], "feedback": ["default", "random"]},
        teacher={"tired": {"mistake": 0.25, "beta": 2}},
        feedback={"random": {"sampler": "uniform"}},
    )
    plan = make_plan(experiment, seeds="1")
    assert [job.feedback for job in plan.jobs] == ["20@500/400", "20@500/400 random"]
    assert config(plan).teacher is not None
    assert (config(plan).teacher.mistake, config(plan).teacher.beta) == (0.25, 2.0)


def test_two_meanings_of_one_name_are_refused() -> None:
    """Two different runs under the same names could not be told apart in a report."""
    error = refused(made({**GRID, "include": [{"method": "pebble", "set": {"agent": {"batch": 7}}}]}))
    assert "two different runs are both called toy-car / pebble / oracle / 20@500/400" in str(error)


def test_users_files(tmp_path: Path) -> None:
    """A user's file is found beside its manifest, enters the identity by content, and may move."""
    table = {
        "title": "T", "reproduces": ["F"], "rule": "R", "seeds": 1,
        "grid": {"tasks": ["toy-car"], "methods": ["mine"]}, "method": {"mine": {"prior": "p.py:f"}},
    }  # fmt: skip
    ids = []
    for folder, text in (("a", "def f(): ..."), ("b", "def f(): ..."), ("c", "def f(): return 1")):
        (tmp_path / folder).mkdir()
        (tmp_path / folder / "p.py").write_text(text)
        plan = make_plan(manifest.parse(table, tmp_path / folder / "m.toml"))
        assert config(plan).reward.prior == f"{tmp_path / folder / 'p.py'}:f"
        assert config(plan).reward.prior_digest is not None
        ids.append(plan.jobs[0].id)
    assert ids[0] == ids[1] != ids[2]
    error = refused(manifest.parse(table, tmp_path / "m.toml"))
    assert f"m.toml [method.mine]: prior '{tmp_path}/p.py:f': there is no file" in str(error)


def test_prior_option(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """--prior adds the residual method on a named prior or a user's file, whatever methods are picked."""
    (tmp_path / "mine.py").write_text("def closer(): ...")
    monkeypatch.chdir(tmp_path)
    plan = make_plan(made(), methods=["oracle"], seeds="1", priors=["zero", "mine.py:closer"])
    assert [job.method for job in plan.jobs] == ["oracle", "rrm-zero", "rrm-closer"]
    assert len(make_plan(made(), seeds="1", priors=["zero", "zero"]).jobs) == 3
    (tmp_path / "mine.py").write_text("def zero(): ...")
    taken = refused(made(), priors=["zero", "mine.py:zero"])
    assert "rrm-zero already stands for" in str(taken)
    assert taken.hint == "rename the function: the method is named after it"
    (tmp_path / "renamed.py").write_text("def null(): ...")
    assert len(make_plan(made(), methods=["oracle"], seeds="1", priors=["zero", "renamed.py:null"]).jobs) == 3
    assert 'did you mean "zero"' in str(refused(made(), priors=["zer"]))
    assert "no file" in str(refused(made(), priors=["absent.py:f"]))
    assert "mine.py defines no 'zer'; did you mean" in str(refused(made(), priors=["mine.py:zer"]))


def test_methods_may_name_what_prior_adds() -> None:
    """--methods picks among the manifest's methods and those of --prior; an unknown one is refused as ever."""
    for methods, expected in ((["rrm-zero"], ["rrm-zero"]), (["pebble", "rrm-zero"], ["pebble", "rrm-zero"])):
        plan = make_plan(made(), methods=methods, seeds="1", priors=["zero"])
        assert [job.method for job in plan.jobs] == expected
    assert 'did you mean "rrm-zero"?' in str(refused(made(), methods=["rrm-zro"], priors=["zero"]))


def test_a_learner_that_its_file_lacks(tmp_path: Path) -> None:
    """A learner is looked for in its file as a prior is, with the section that names it."""
    (tmp_path / "own.py").write_text("class Lerner: ...")
    grid = {"tasks": ["toy-car"], "methods": ["mine"]}
    error = refused(made(grid, method={"mine": {"learner": f"{tmp_path}/own.py:Learner"}}))
    assert "mine.toml [method.mine]: learner" in str(error)
    assert "own.py defines no 'Learner'; did you mean \"Lerner\"?" in str(error)


def test_filters() -> None:
    """--tasks and --methods pick from what the manifest has, and suggest what is near."""
    assert [job.method for job in make_plan(made(), methods=["pebble"], seeds="1").jobs] == ["pebble"]
    assert 'mine has no method "peble"; did you mean "pebble"?' in str(refused(made(), methods=["peble"]))
    assert 'mine has no task "toy"' in str(refused(made(), tasks=["toy"]))
    assert "--tasks names nothing" in str(refused(made(), tasks=[]))


@pytest.mark.parametrize(
    ("sections", "said"),
    [
        ({"grid": {**GRID, "tasks": ["toy-cat"]}}, 'mine.toml: unknown task "toy-cat"; did you mean "toy-car"?'),
        ({"grid": {**GRID, "methods": ["peble"]}}, 'mine.toml: unknown method "peble"; did you mean "pebble"?'),
        ({"grid": {**GRID, "methods": ["rrm-prox"]}}, 'unknown method "rrm-prox"; did you mean "rrm-proxy"?'),
        ({"grid": {**GRID, "teachers": ["oracel"]}}, 'unknown teacher "oracel"; did you mean "oracle"?'),
        ({"grid": {**GRID, "feedback": ["rare"]}}, 'unknown feedback schedule "rare"'),
        ({"task": {"toy-cat": {}}}, "[task.toy-cat]: the grid has no task of this name; did you mean"),
        ({"method": {"rrm-zero": {}}}, "[method.rrm-zero]: the grid has no method"),
        ({"profile": {"smok": {}}}, 'mine.toml [profile.smok]: no profile has this name; did you mean "smoke"?'),
        ({"default_profile": "papper"}, 'unknown profile "papper"; did you mean "paper"?'),
        ({"defaults": {"stps": 5}}, '[defaults]: unknown key "stps"; did you mean "steps"?'),
        ({"defaults": {"batch": 5}}, '[defaults]: unknown key "batch"; did you mean "agent.batch"?'),
        ({"defaults": {"agent": 5}}, "[defaults]: agent must be a table, got 5"),
        ({"defaults": {"agent": {"batch": "big"}}}, "[defaults]: agent.batch = 'big': Input should be a valid integer"),
        ({"defaults": {"agent": {"batch": 0}}}, "[defaults]: agent.batch = 0: Input should be greater than"),
        ({"defaults": {"seed": 3}}, "[defaults]: seed cannot be set here"),
        ({"defaults": {"steps": 10**30}}, "is too large"),
        ({"defaults": {"reward": {"options": {"x": float("nan")}}}}, "only text, finite numbers"),
        ({"teacher": {"oracle": {"mistke": 0.1}}}, '[teacher.oracle]: unknown key "teacher.mistke"; did you mean'),
        ({"profile": {"paper": {"agent": {"batc": 1}}}}, '[profile.paper]: unknown key "agent.batc"'),
        ({"method": {"pebble": {"learner": "peble"}}}, '[method.pebble]: unknown learner "peble"; did you mean'),
        ({"method": {"pebble": {"prior": "prox"}}}, '[method.pebble]: unknown prior "prox"; did you mean "proxy"?'),
        ({"method": {"pebble": {"learner": "prior"}}}, "trains on a prior alone"),
        ({"method": {"pebble": {"learner": "true", "prior": "zero"}}}, "takes no prior"),
        ({"seeds": []}, "mine.toml: seeds: the list of seeds is empty"),
        ({"seeds": [1, 1]}, "seed 1 is given twice"),
    ],
)
def test_mistakes_are_traced(sections: dict[str, Any], said: str) -> None:
    """A mistake is answered with file, section and key, and the nearest name that would do."""
    assert said in str(refused(made(**sections)))


@pytest.mark.parametrize(
    ("settings", "said", "source"),
    [
        ({"feedback": {"segment": 101}}, "feedback.segment: 101 steps do not fit", "mine.toml [defaults]"),
        ({"steps": 1500}, "before the first feedback", "mine.toml [defaults]"),
        ({"horizon": 5000}, "longer than toy-car's episode", "mine.toml [defaults]"),
    ],
)
def test_budgets_that_cannot_be_met(settings: dict[str, Any], said: str, source: str) -> None:
    """Settings that contradict one another are refused with the section that the culprit comes from."""
    error = refused(made(defaults=settings))
    assert said in str(error)
    assert "toy-car, " in str(error)
    assert source in str(error.hint)


def test_scaled_culprits_show_both_numbers() -> None:
    """An amount that a profile shrank is named as it is written and as it became."""
    error = refused(made(defaults={"feedback": {"segment": 100_000}}), profile="smoke")
    became = str(error).partition("feedback.segment: ")[2].split()[0]
    assert became != "100000"
    assert str(error.hint) == (f"feedback.segment = 100000, {became} in profile smoke, is set in mine.toml [defaults]")


def test_features_a_prior_needs() -> None:
    """A prior that reads what a task does not reveal is refused when planning."""
    assert "does not reveal" in str(refused(made({"tasks": ["walker-walk"], "methods": ["rrm-h2o"]})))


@pytest.mark.parametrize(
    ("given", "expected"),
    [("3", [0, 1, 2]), ("0,3,7", [0, 3, 7]), ("4,", [4]), (2, [0, 1]), ((5, 6), [5, 6]), (" 1 , 2 ", [1, 2])],
)
def test_seeds(given: Any, expected: list[int]) -> None:
    """A number counts from 0, a list is taken as it is."""
    assert parse_seeds(given, "--seeds") == expected


@pytest.mark.parametrize(
    "given", ["", "0", "-1", "1,1", "1,-2", "a", "1.5", ",", "1,,2", "9" * 30, "99999999", "²", 0, []]
)
def test_bad_seeds(given: Any) -> None:
    """No seeds, duplicates, negatives and nonsense are refused with an example of what would do."""
    with pytest.raises(UserError) as caught:
        parse_seeds(given, "--seeds")
    assert "0,3,7" in str(caught.value.hint)


@pytest.mark.parametrize(
    ("text", "key", "value"),
    [
        ("agent.batch=64", "agent.batch", 64),
        ("steps=2e4", "steps", 20_000),
        ("agent.tau = 0.5", "agent.tau", 0.5),
        ("feedback.sampler=kcenter-entropy", "feedback.sampler", "kcenter-entropy"),
        ('evaluation.success="last"', "evaluation.success", "last"),
    ],
)
def test_overrides(text: str, key: str, value: Any) -> None:
    """--set takes TOML values, bare words, and whole numbers in any spelling."""
    assert make_plan(made(), overrides=[text]).overrides == {key: value}


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("batch=3", 'unknown setting "batch"; did you mean "agent.batch"?'),
        ("agent.btch=3", 'did you mean "agent.batch"?'),
        ("agent.batch", "expected KEY=VALUE"),
        ("=3", "expected KEY=VALUE"),
        ("agent.batch=[", "not a TOML value"),
        ("agent.batch=1\nsteps=2", "not a TOML value"),
        ("agent.batch=1.5", "agent.batch = 1.5"),
        ("agent=3", "agent is a section; write agent.hidden=..."),
        ("agent={batch=3}", "agent is a section; write agent.batch=..."),
        ("profile=paper", "--profile"),
        ("reward.prior=zero", "--prior"),
        ("feedback.sampler=best", "feedback.sampler = 'best'"),
    ],
)
def test_bad_overrides(text: str, said: str) -> None:
    """An unknown key, a wrong type, or what another option decides is refused."""
    assert said in str(refused(made(), overrides=[text]))


def test_variants() -> None:
    """Profile and overrides name the variant; the order of overrides does not matter."""
    assert make_plan(made()).variant == "paper"
    one, two = {"steps": 5000, "agent.batch": 32}, {"agent.batch": 32, "steps": 5000}
    typed = make_plan(made(), profile="smoke", overrides=["steps=5000", "agent.batch=32"])
    assert variant("smoke", one) == variant("smoke", two) == typed.variant
    assert len({variant("smoke", {}), variant("paper", {}), variant("smoke", one), variant("smoke", {"steps": 1})}) == 4


def test_profile_is_part_of_a_run() -> None:
    """The same task at two scales is two runs even where no number differs."""
    assert not {job.id for job in make_plan(made()).jobs} & {job.id for job in make_plan(made(), profile="laptop").jobs}


@pytest.mark.parametrize("scale", sorted(profiles()))
@pytest.mark.parametrize("path", sorted(EXPERIMENTS.glob("*.toml")), ids=lambda path: path.stem)
def test_every_experiment_plans(path: Path, scale: str) -> None:
    """Every manifest in experiments/ makes a plan at every profile, with feedback wherever a reward is learned."""
    plan = make_plan(manifest.load(path), profile=scale)
    assert plan.jobs
    for job in plan.jobs:
        assert (config(plan, job).sessions() > 0) == config(plan, job).reward.kind.learned


@pytest.mark.parametrize("scale", sorted(profiles()))
def test_fine_tuning_is_compared_at_equal_budgets(scale: str) -> None:
    """Under one of two schedules the residual model and fine-tuning put equally many queries, at any scale."""
    plan = make_plan(manifest.load(EXPERIMENTS / "finetune.toml"), profile=scale, seeds="1")
    put: dict[str, dict[str, int]] = {}
    for job in plan.jobs:
        put.setdefault(job.feedback, {})[job.method] = plan.configs[job.id].queries()
    usual, equal = put.values()
    assert equal == dict.fromkeys(("rrm-imitation", "finetune"), equal["finetune"])
    assert 0 < equal["finetune"] <= usual["finetune"] < usual["rrm-imitation"]


def test_fine_tuning_asks_all_it_can() -> None:
    """The paper's: a thousand labels after the switch at 400,000 of 500,000 steps, and as many for its rival."""
    plan = make_plan(manifest.load(EXPERIMENTS / "finetune.toml"), seeds="1")
    queries = {(job.method, job.feedback): plan.configs[job.id].queries() for job in plan.jobs}
    few = "50@5000/1000"
    assert queries["finetune", "50@5000/5000"] == queries["finetune", few] == queries["rrm-imitation", few] == 1000


def test_mistaken_teachers_are_asked_twice() -> None:
    """With the usual budget and with that of MRN's own experiment; the stochastic one with the usual alone."""
    plan = make_plan(manifest.load(EXPERIMENTS / "noisy-teacher.toml"), seeds="1")
    mrn = make_plan(manifest.load(EXPERIMENTS / "mrn.toml"), seeds="1", tasks=["button-press"], methods=["mrn"])
    schedules: dict[str, set[str]] = {}
    for job in plan.jobs:
        schedules.setdefault(job.teacher, set()).add(job.feedback)
    both = {"50@5000/5000", mrn.jobs[0].feedback}
    assert schedules == {"-": {"-"}, "stochastic": {"50@5000/5000"}, "mistaken-10": both, "mistaken-15": both}
    assert {plan.configs[job.id].queries() for job in plan.jobs if job.feedback == "10@5000/100"} == {100}


BPREF = {  # hidden, layers, batch, step size, steps, and K, M, cap
    "button-press": ((256, 3, 512, 3e-4), 1_000_000, (5000, 50, 10_000), 10),
    "sweep-into": ((256, 3, 512, 3e-4), 1_000_000, (5000, 50, 10_000), 10),
    "walker-walk": ((1024, 2, 1024, 5e-4), 500_000, (20_000, 50, 500), 50),
    "quadruped-walk": ((1024, 2, 1024, 1e-4), 1_000_000, (30_000, 100, 1000), 50),
}


@pytest.mark.parametrize("task", BPREF)
def test_bpref_is_what_its_scripts_say(task: str) -> None:
    """Networks, step sizes, schedules and lengths of B-Pref's scripts of PEBBLE; SAC alike, after 5000 random steps."""
    agent, steps, feedback, epochs = BPREF[task]
    profile = "bpref-dmc" if TASKS[task].suite == "dmc" else "bpref"
    plan = make_plan(manifest.load(EXPERIMENTS / "main-results.toml"), profile=profile, tasks=[task], seeds="1")
    oracle, pebble = (config(plan, only(plan, name)) for name in ("oracle", "pebble"))
    for run in (oracle, pebble):
        assert (run.agent.hidden, run.agent.layers, run.agent.batch, run.agent.actor_lr) == agent
        assert (run.agent.critic_lr, run.agent.alpha_lr, run.steps) == (agent[-1], 1e-4, steps)
    assert pebble.feedback is not None
    assert (pebble.feedback.every, pebble.feedback.batch, pebble.feedback.budget) == feedback
    assert (pebble.reward.epochs, pebble.feedback.sampler) == (epochs, "disagreement")
    assert (pebble.exploration.seed_steps, pebble.exploration.unsupervised_steps) == (1000, 9000)
    assert oracle.random_steps == 5000


def test_bpref_has_the_paper_s_agent_on_other_suites() -> None:
    """Without `-dmc` only the step size, the schedule and the length differ from the paper's."""
    plan = make_plan(
        manifest.load(EXPERIMENTS / "main-results.toml"), profile="bpref", tasks=["walker-walk"], seeds="1"
    )
    run = config(plan, only(plan, "pebble"))
    assert (run.agent.hidden, run.agent.layers, run.agent.batch, run.agent.actor_lr) == (256, 3, 512, 3e-4)


def test_smoke_passes_through_everything() -> None:
    """At smoke scale there are several sessions, an unsupervised phase for PEBBLE, and evaluations before the end."""
    plan = make_plan(manifest.load(EXPERIMENTS / "main-results.toml"), profile="smoke", seeds="1")
    for job in plan.jobs:
        run = config(plan, job)
        assert run.steps <= 1000
        assert run.steps // run.evaluation.every >= 2
        assert run.sessions() >= 3 or job.method == "oracle"
        assert (run.exploration.unsupervised_steps > 0) == (job.method == "pebble" and not run.sees_frames)


def test_less_feedback() -> None:
    """Fig. less: fewer questions a session, or rarer ones, over 500,000 steps of each Meta-World task of Fig. main."""
    plan = make_plan(manifest.load(EXPERIMENTS / "less-feedback.toml"), seeds="1")
    jobs = plan.jobs
    budgets = {"50@5000/5000", "25@5000/2500", "10@5000/1000", "5@5000/500", "50@10000/2500", "50@20000/1250"}
    assert {job.steps for job in jobs} == {500_000}
    for task in ("button-press", "door-open", "door-unlock", "sweep-into"):
        for method in ("pebble", "rrm-proxy", "rrm-language"):
            assert {job.feedback for job in jobs if (job.task, job.method) == (task, method)} == budgets
    runs = [config(plan, job) for job in jobs if job.method != "pebble"]
    assert all(run.queries() == run.feedback.budget for run in runs)
    main = {job.id for job in make_plan(manifest.load(EXPERIMENTS / "main-results.toml"), seeds="1").jobs}
    assert {job.task for job in jobs if job.id in main} == {"button-press", "door-open", "door-unlock"}


def test_opposite_prior() -> None:
    """Fig. oppo: door-unlock for a million steps; button-press is that of the ablation."""
    jobs = make_plan(manifest.load(EXPERIMENTS / "opposite-prior.toml"), seeds="1").jobs
    lengths = {"button-press": 500_000, "door-unlock": 1_000_000}
    assert {(job.task, job.method): job.steps for job in jobs} == {
        (task, method): steps for task, steps in lengths.items() for method in ("pebble", "rrm-opposite")
    }
    ablation = {job.id for job in make_plan(manifest.load(EXPERIMENTS / "ablation-prior.toml"), seeds="1").jobs}
    assert {job.task for job in jobs if job.id in ablation} == {"button-press"}


def test_a_prior_a_task(tmp_path: Path) -> None:
    """{task} in a file's path is the task's name; without such a file the task is refused, and named."""
    (tmp_path / "toy-car.py").write_text("def near(step):\n    return 0.0\n")
    table = {
        "title": "T", "reproduces": ["F"], "rule": "R", "seeds": 1, "method": {"mine": {"prior": "{task}.py:near"}},
        "grid": {"tasks": ["toy-car"], "methods": ["mine"]},
    }  # fmt: skip
    plan = make_plan(manifest.parse(table, tmp_path / "mine.toml"))
    assert config(plan).reward.prior == f"{tmp_path / 'toy-car.py'}:near"
    table["grid"] = {"tasks": ["toy-car", "door-open"], "methods": ["mine"]}
    assert "door-open, mine: " in str(refused(manifest.parse(table, tmp_path / "mine.toml")))


def test_documented_manifests_plan(tmp_path: Path) -> None:
    """The examples in docs/manifests.md make plans at every scale."""
    page = (EXPERIMENTS.parent / "docs" / "manifests.md").read_text()
    examples = [block.partition("```")[0] for block in page.split("```toml\n")[1:]]
    assert len(examples) == 2
    (tmp_path / "my_priors.py").write_text("def closer(): ...")
    for text in examples:
        (tmp_path / "example.toml").write_text(text)
        for scale in profiles():
            assert make_plan(manifest.load(tmp_path / "example.toml"), profile=scale).jobs
