import json
import shlex

import pytest
from typer.testing import CliRunner

from rrmctl.cli.app import app
from rrmctl.errors import UserError
from rrmctl.reports import comparability
from rrmctl.reports.iqm_curves import write_curves
from rrmctl.reports.render import FORMATS
from rrmctl.reports.select import of_profile, read_sections
from rrmctl.store.layout import Layout
from tests.rrmctl.reports import stores
from tests.rrmctl.reports.frames import RECORDED, RISING, Sweep

SEEDS = [("button-press", "pebble", seed) for seed in range(5)]
TASK = "button-press"


def rrmctl(*arguments):
    return CliRunner().invoke(app, [str(each) for each in arguments])


def shown(root, profile=None):
    return of_profile(read_sections(root), profile)


@pytest.fixture
def installed(monkeypatch):
    """What a run made now would be made with, here as most runs of these stores."""
    versions = {"rrmctl": "0.1.0", **RECORDED["versions"], "metaworld": "3.1.1", "mujoco": "3.3.0"}
    monkeypatch.setattr(comparability, "version", versions.get)
    return versions


def changed(**facts):
    return RECORDED | facts


def old(method, *seeds):
    return {(TASK, method, seed): 1 for seed in seeds}


def by_method(section):
    return {each.label.method: each for each in section.series}


def test_equal_making_is_no_matter(tmp_path):
    """Runs made alike are reported without a word about it."""
    Sweep().write(tmp_path)
    (section,) = read_sections(tmp_path)
    assert (section.mixed, section.remarks, section.problems) == ((), (), ())


def test_other_ways_of_products_are_no_matter(tmp_path):
    """Other libraries that multiply, also from an attempt on, only round otherwise."""
    facts = {"products": {"otherwise": "numpy"}}
    resumed = [{"changes": {"products": ["torch", "numpy"]}}]
    Sweep(recorded={SEEDS[1]: changed(**facts), SEEDS[2]: changed(resumed=resumed)}).write(tmp_path)
    (section,) = read_sections(tmp_path)
    assert (section.mixed, section.remarks, section.problems) == ((), (), ())


def test_other_processors_are_said(tmp_path):
    """They round otherwise, too, but a reader who compares seed by seed must know; nothing is refused."""
    resumed = changed(cpu="A", resumed=[{"changes": {"cpu": ["A", "B"]}}])
    runs = dict.fromkeys([(TASK, method, seed) for method in RISING for seed in range(5)], changed(cpu="A"))
    Sweep(recorded=runs | {SEEDS[1]: changed(cpu="B"), SEEDS[2]: resumed}).write(tmp_path)
    (section,) = read_sections(tmp_path)
    assert (section.mixed, section.problems) == ((), ())
    (remark,) = section.remarks
    assert "A: 13 runs (" in remark
    assert f"A, then B: 1 run ({TASK} pebble" in remark
    assert remark.endswith(")."), remark
    assert f"; B: 1 run ({TASK} pebble" in remark


def test_agents_of_other_settings_are_said(tmp_path):
    """As after a profile has changed between two sweeps; what an older configuration does not have is not compared."""
    Sweep().write(tmp_path)
    for at, path in enumerate(sorted(tmp_path.glob("runs/*/config.json"))):
        told = json.loads(path.read_text())
        agent = {"batch": 128, "critic_lr": 1e-3 if at == 2 else 3e-4} | ({} if at == 4 else {"tau": at})
        agent |= {"encoder": "none", "encoder_run": "an AIRL run" if at == 1 else None}
        path.write_text(json.dumps(told | {"agent": agent}))
    (section,) = read_sections(tmp_path)
    assert (section.mixed, section.problems) == ((), ())
    assert section.remarks == (f"Runs of {TASK} differ in settings of their agents: critic_lr.",)


def test_claims_are_judged_beside_an_experiment_that_is_refused(tmp_path, installed):
    """It costs its own claims, and the way out is told; asked for by itself it is refused, as in any other report."""
    Sweep().write(tmp_path)
    other = changed(versions=RECORDED["versions"] | {"torch": "2.9.0"})
    runs = {("door-unlock", "pebble", 1): other}
    Sweep(experiment="ablation-prior", tasks=("door-unlock",), recorded=runs).write(tmp_path)
    done = rrmctl("report", "claims", "--results", tmp_path, "--format", "json")
    assert done.exit_code == 0, done.output
    (report,) = json.loads(done.stdout)["reports"]
    (note,) = (note for note in report["notes"] if "do not belong" in note)
    assert note.startswith("ablation-prior: not judged. ablation-prior, profile laptop: its runs do not belong in one")
    assert "--allow-mixed" in note
    assert not any("MIXED" in note for note in report["notes"])
    whys = {row["asks"]: row["why"] for row in report["rows"]}
    assert "do not belong in one report" in whys["ablation-prior"]
    assert "do not belong" not in whys["main-results"]
    for command in (["report", "claims", "ablation-prior"], ["report", "iqm", "ablation-prior"]):
        assert rrmctl(*command, "--results", tmp_path).exit_code == 2


def test_pictures_of_one_task_are_drawn_alike(tmp_path):
    """What draws them is compared among the runs of one task: others may have been made elsewhere."""
    drawn = {name: changed(fingerprint=RECORDED["fingerprint"] | {"renderer": name}) for name in ("Mesa 1", "Mesa 2")}
    tasks = (TASK, "door-open")
    runs = {
        (task, name, seed): drawn[f"Mesa {1 + at}"]
        for at, task in enumerate(tasks) for name in RISING for seed in range(5)
    }  # fmt: skip
    Sweep(tasks=tasks, recorded=runs).write(tmp_path)
    (section,) = read_sections(tmp_path)
    assert (section.mixed, section.refusal) == ((), None)
    Sweep(tasks=tasks, recorded=runs | {SEEDS[1]: drawn["Mesa 2"]}).write(tmp_path / "mixed")
    (section,) = read_sections(tmp_path / "mixed")
    assert f"renderer of {TASK} is Mesa 1 in 14 runs" in str(section.refusal)


def test_configuration_versions_do_not_meet(tmp_path):
    """Old and new runs in one experiment are refused; the message names them and the command that trains them anew."""
    Sweep(versions=old("pebble", 0, 1, 2, 3, 4)).write(tmp_path)
    with pytest.raises(
        UserError, match=r"configuration version is 1 in 5 runs \(button-press pebble .*2 in 10 runs"
    ) as found:
        shown(tmp_path)
    command = "rrmctl run main-results --profile laptop --tasks button-press --methods pebble --seeds 0,1,2,3,4"
    assert command in str(found.value.hint)
    assert "--allow-mixed" in str(found.value.hint)


@pytest.mark.parametrize(
    ("recorded", "words"),
    [
        (changed(versions={"rrmctl": "0.2.0", "torch": "2.6.0"}), "rrmctl is 0.1.0 in 14 runs"),
        (changed(versions={"rrmctl": "0.1.0", "torch": "2.7.1"}), "torch is 2.6.0 in 14 runs"),
        (changed(fingerprint={"metaworld": "3.0.0", "mujoco": "3.3.0", "true_reward": "aaaa"}), "metaworld is 3.0.0"),
        (changed(fingerprint={"metaworld": "3.1.1", "mujoco": "3.3.0", "true_reward": "b"}), "true reward on fixed"),
        (changed(resumed=[{"changes": {"versions.torch": ["2.6.0", "2.7.1"]}}]), "2.6.0, then 2.7.1 in 1 run"),
    ],
)  # fmt: skip
def test_packages_and_simulators_do_not_meet(tmp_path, recorded, words, installed):
    """One run of another package, simulator or true reward is refused, and so is one resumed under another version."""
    Sweep(recorded={SEEDS[2]: recorded}).write(tmp_path)
    with pytest.raises(UserError, match=words) as found:
        shown(tmp_path)
    again = f"--tasks button-press --methods pebble --seeds 2, --results {tmp_path} --force`"
    assert (again in str(found.value.hint)) == ("true reward" not in words)  # that of now is not known without a run


def test_runs_of_the_installed_version_are_left_alone(tmp_path, installed):
    """Ten of another torch, five of the one that is installed: the ten are trained anew, though they are more."""
    installed["torch"] = "2.7.1"
    Sweep(recorded=dict.fromkeys(SEEDS, changed(versions={"rrmctl": "0.1.0", "torch": "2.7.1"}))).write(tmp_path)
    with pytest.raises(UserError) as found:
        shown(tmp_path)
    assert "--tasks button-press --methods oracle,rrm-proxy --seeds 0,1,2,3,4 " in str(found.value.hint)
    assert "pebble" not in str(found.value.hint)


def test_no_other_run_is_trained_anew(tmp_path, installed):
    """A command for each task and set of seeds: no product of all tasks, methods and seeds that are named."""
    old = changed(versions={"rrmctl": "0.1.0", "torch": "2.4.0"})
    keys = [(TASK, "pebble", 3), ("door-open", "oracle", 1), ("door-open", "rrm-proxy", 1)]
    overrides = {"agent.batch": 64, "precision": "bfloat16", "trace": True}
    sweep = Sweep(tasks=(TASK, "door-open"), recorded=dict.fromkeys(keys, old), overrides=overrides)
    sweep.write(tmp_path)
    with pytest.raises(UserError) as found:
        shown(tmp_path)
    commands = [shlex.split(each) for each in str(found.value.hint).split("`")[1::2]]
    start = ["rrmctl", "run", "main-results", "--profile", "laptop"]
    start += ["--set", "agent.batch=64", "--set", "precision=bfloat16", "--set", "trace=true"]
    assert commands == [
        [*start, "--tasks", task, "--methods", methods, "--seeds", seeds, "--results", str(tmp_path), "--force"]
        for task, methods, seeds in ((TASK, "pebble", "3,"), ("door-open", "oracle,rrm-proxy", "1,"))
    ]


@pytest.mark.slow
def test_one_variant_refuses_no_other(tmp_path):
    """Mixed runs of one profile are refused where they are asked for; the other profile is reported."""
    Sweep(versions=old("pebble", 0, 1)).write(tmp_path)
    Sweep(profile="paper", variant="paper").write(tmp_path)
    assert [each.profile for each in shown(tmp_path, "paper")] == ["paper"]
    for profile in ("laptop", None):
        with pytest.raises(UserError, match="main-results, profile laptop: its runs do not belong"):
            shown(tmp_path, profile)
    made = rrmctl("report", "iqm", "--results", tmp_path, "--profile", "paper", "--replicates", 100)
    assert made.exit_code == 0


@pytest.mark.slow
def test_a_variant_of_several_configurations_refuses_no_other(tmp_path):
    """The same where runs of one series differ in more than their seed, which no option allows."""
    Sweep(cells={SEEDS[3]: "feedfeedfeedfeed"}).write(tmp_path)
    Sweep(profile="paper", variant="paper").write(tmp_path)
    assert len(shown(tmp_path, "paper")) == 1
    with pytest.raises(UserError, match="2 different configurations"):
        of_profile(read_sections(tmp_path, allow_mixed=True), "laptop")


def test_a_methods_precision_is_its_own_but_one(tmp_path):
    """Methods may differ in precision, which is said; the runs of one method may not."""
    Sweep(precisions=dict.fromkeys(SEEDS, "bfloat16")).write(tmp_path / "methods")
    (section,) = read_sections(tmp_path / "methods")
    assert section.remarks == ("Methods differ in precision: bfloat16: pebble; float32: oracle, rrm-proxy.",)
    Sweep(precisions={SEEDS[0]: "bfloat16"}).write(tmp_path / "seeds")
    with pytest.raises(UserError, match=r"precision of pebble is bfloat16 in 1 run .*float32 in 4 runs"):
        shown(tmp_path / "seeds")


def test_a_methods_device_is_its_own_but_one(tmp_path):
    """Likewise; what was configured before there was a choice is on the processor."""
    Sweep(devices=dict.fromkeys(SEEDS, "cpu")).write(tmp_path / "alike")
    (section,) = read_sections(tmp_path / "alike")
    assert (section.mixed, section.remarks) == ((), ())
    Sweep(devices=dict.fromkeys(SEEDS, "cuda")).write(tmp_path / "methods")
    (section,) = read_sections(tmp_path / "methods")
    assert section.remarks == ("Methods differ in device: cpu: oracle, rrm-proxy; cuda: pebble.",)
    Sweep(devices={SEEDS[0]: "cuda"}).write(tmp_path / "seeds")
    with pytest.raises(UserError, match=r"device of pebble is cpu in 4 runs .*cuda in 1 run"):
        shown(tmp_path / "seeds")


def test_a_method_is_trained_on_one_kind_of_card(tmp_path):
    """Where cards are recorded they are compared."""
    cards = {key: changed(card=f"NVIDIA {'A' if key[2] else 'B'}") for key in SEEDS}
    Sweep(devices=dict.fromkeys(SEEDS, "cuda"), recorded=cards).write(tmp_path)
    with pytest.raises(UserError, match=r"card of pebble is NVIDIA A in 4 runs .*NVIDIA B in 1 run"):
        shown(tmp_path)


def test_environments_differ_by_task(tmp_path):
    """Two tasks have two true rewards and two simulators, and may stand in one table."""
    toy = changed(fingerprint={"true_reward": "bbbb"})
    keys = [("toy-car", method, seed) for method in RISING for seed in range(5)]
    Sweep(tasks=(TASK, "toy-car"), recorded=dict.fromkeys(keys, toy)).write(tmp_path)
    (section,) = read_sections(tmp_path)
    assert section.mixed == ()


def test_states_of_the_code_are_said(tmp_path):
    """The digest of the sources changes with every commit: it is told and refuses nothing."""
    Sweep(recorded={SEEDS[0]: changed(code="beef"), SEEDS[1]: changed(code="feed")}).write(tmp_path)
    (section,) = read_sections(tmp_path)
    assert section.remarks == ("The runs were made by 3 states of the code (digests of its sources).",)


def test_runs_of_which_nothing_is_known_are_named(tmp_path):
    """A run without provenance cannot be compared, and a note says which."""
    Sweep(recorded={SEEDS[0]: {}}).write(tmp_path)
    (section,) = read_sections(tmp_path)
    assert section.remarks[0].startswith("Nothing was recorded of how these were made")
    assert "1 run (button-press pebble" in section.remarks[0]


@pytest.mark.slow
@pytest.mark.parametrize("form", FORMATS)
def test_a_mixed_table_says_so_in_every_form(tmp_path, form):
    """`--allow-mixed` shows the table; each form says that it is mixed and how."""
    Sweep(versions=old("pebble", 0, 1, 2, 3, 4)).write(tmp_path)
    options = ("--results", tmp_path, "--format", form, "--replicates", 100)
    refused = rrmctl("report", "iqm", "main-results", *options)
    assert refused.exit_code == 2
    assert "do not belong in one report" in refused.stderr
    shown = rrmctl("report", "iqm", "main-results", "--allow-mixed", *options)
    assert shown.exit_code == 0
    text = " ".join(shown.stdout.split())
    assert "MIXED: configuration version is 1 in 5 runs" in text
    if form == "json":
        assert json.loads(shown.stdout)["reports"][0]["mixed"]


@pytest.mark.slow
def test_mixed_curves_are_drawn_on_demand_and_never_kept(tmp_path):
    """`plot` takes the option too; the aggregated file, which has no room for a note, is not written."""
    Sweep(versions=old("pebble", 0, 1, 2, 3, 4)).write(tmp_path)
    assert rrmctl("plot", "main-results", "--results", tmp_path).exit_code == 2
    assert rrmctl("plot", "main-results", "--results", tmp_path, "--allow-mixed").exit_code == 0
    for allowed in (False, True):  # the file is of all variants
        with pytest.raises(UserError, match="not kept"):
            write_curves(Layout(tmp_path), read_sections(tmp_path, allow_mixed=allowed))
    assert not (tmp_path / "aggregates").exists()


def test_what_was_trained_anew_takes_the_place_of_the_old(tmp_path):
    """After a sweep with a newer version the old runs are left out, which is said; they are not planned nor absent."""
    Sweep(versions={(TASK, m, s): 1 for m in RISING for s in range(5)}).write(tmp_path)
    (before,) = read_sections(tmp_path)
    Sweep().write(tmp_path)
    (section,) = read_sections(tmp_path)
    assert (section.planned, section.contained, section.absent, section.mixed) == (15, 15, (), ())
    assert set(by_method(section)["pebble"].runs).isdisjoint(by_method(before)["pebble"].runs)
    assert section.problems == (
        "15 runs are left out: of other settings, files or versions than what was asked for since.",
    )


def test_the_old_runs_are_left_out_from_the_moment_others_are_asked_for(tmp_path):
    """While no run of the newer version is done there is nothing to report, and the new ones are named as absent."""
    keys = [(TASK, m, s) for m in RISING for s in range(5)]
    Sweep(versions=dict.fromkeys(keys, 1)).write(tmp_path)
    Sweep(states=dict.fromkeys(keys, "queued"), lengths=dict.fromkeys(keys, 0)).write(tmp_path)
    (section,) = read_sections(tmp_path)
    assert (section.contained, len(section.absent), {each.state for each in section.absent}) == (0, 15, {"queued"})
    with pytest.raises(UserError, match="of the planned ones 15 queued; 15 runs are left out: "):
        shown(tmp_path)


def test_half_a_new_sweep_is_a_mixture(tmp_path):
    """Where only some seeds were trained anew, the rest are of the old version, and the two do not meet."""
    Sweep(versions={(TASK, m, s): 1 for m in RISING for s in range(5)}).write(tmp_path)
    Sweep(curves={"pebble": RISING["pebble"][:2]}).write(tmp_path)
    with pytest.raises(UserError, match=r"configuration version is 1 in 13 runs .* 2 in 2 runs"):
        shown(tmp_path)
    (section,) = read_sections(tmp_path, allow_mixed=True)
    assert by_method(section)["pebble"].seeds == (0, 1, 2, 3, 4)
    assert (section.planned, section.contained) == (15, 15)


def test_policies_are_deployed_where_nothing_is_trained():
    """Trained on a server and deployed at an arm, with another torch: that is said, and refused within either alone."""
    section = stores.deployed()

    def made(series, torch):
        facts = {"torch": torch, "device": "cpu"} | ({"opencv": "4.12"} if series is section.deployments else {})
        return {run: comparability.Making({}, facts, "c0de", None) for each in series for run in each.runs}

    makings = made(section.series, "2.6.0") | made(section.deployments, "2.7.1")
    assert comparability.mixture(section, makings) == {}
    (remark,) = comparability.remarks(section, makings)
    assert remark == "Policies were trained with torch 2.6.0 and deployed with 2.7.1."
    assert not [*comparability.remarks(section, makings | made(section.deployments, "2.6.0"))]

    first = section.deployments[0].runs[0]
    mixed = comparability.mixture(section, makings | {first: made(section.deployments, "2.8.0")[first]})
    assert [*mixed] == ["torch of the deployments"]
