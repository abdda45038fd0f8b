import dataclasses
import itertools
from pathlib import Path

import numpy as np
import pytest

from rrmctl.errors import UserError
from rrmctl.planning.manifest import load
from rrmctl.planning.plan import make_plan
from rrmctl.reports.claims import CLAIMS, Arm, Claim, Reading, Test, read_claims
from rrmctl.reports.report import NoDataError
from rrmctl.reports.statistics import Statistics
from rrmctl.reports.tables import claims
from rrmctl.reports.verdicts import by_chance, judge
from tests.rrmctl.reports.stores import FULL, curve, section

QUICK = Statistics(replicates=2000)
STEPS = list(range(10_000, 510_000, 10_000))
EXPERIMENTS = Path(__file__).parents[3] / "experiments"
LITTLE = "5@5000/500"
FINAL, BOX = Reading(words="last step"), Reading(words="common step", steps="common")
MEAN = Reading(words="mean over steps", steps="all")


def at_least(bound, *arms, reading=FINAL):
    return tuple(Test(Arm.of(arm), "at least", bound, reading) for arm in arms)


def below(bound, *arms, reading=FINAL):
    return tuple(Test(Arm.of(arm), "below", bound, reading) for arm in arms)


def above(other, *arms, reading=MEAN):
    return tuple(Test(Arm.of(arm), "above", Arm.of(other), reading) for arm in arms)


def claim(*tests, tasks=("button-press",), pooled=False):
    return Claim(name="c", says="it is so", where="here", experiment="e", tasks=tasks, tests=tests, pooled=pooled)


def store(ends, *, seeds=10, spread=0.1, profile="paper", states=None, task="button-press", feedback=FULL):
    """One section, in which each method rises to its end."""
    series = {
        (task, name, "oracle", feedback): curve(0.0, end / 2, end, seeds=seeds, spread=spread)
        for name, end in ends.items()
    }
    return section("e", series, steps=[100, 200, 300], profile=profile, states=states)


def verdict(tests, found):
    return judge(claim(*tests), {"e": found}, QUICK).verdict


@pytest.mark.parametrize(
    ("end", "expected"), [(0.4, "held"), (0.9, "not held"), (0.65, "not enough data"), (0.63, "not enough data")]
)
def test_a_bound_is_settled_by_the_whole_interval(end, expected):
    """Below 65 % is held where the interval ends before, not held where it begins behind, open where it contains it."""
    assert verdict(below(0.65, "sac-proxy"), store({"sac-proxy": end}, spread=0.2)) == expected
    opposite = {"held": "not held", "not held": "held"}.get(expected, expected)
    assert verdict(at_least(0.65, "sac-proxy"), store({"sac-proxy": end}, spread=0.2)) == opposite


@pytest.mark.parametrize(
    ("ours", "theirs", "expected"),
    [(0.9, 0.5, "held"), (0.5, 0.9, "not held"), (0.55, 0.5, "not enough data"), (1.0, 1.0, "not held")],
)
def test_an_order_is_settled_by_the_difference(ours, theirs, expected):
    """Above means a difference above zero: methods that are surely level are not above one another."""
    spread = 0.0 if ours == theirs else 0.3
    found = store({"rrm-proxy": ours, "pebble": theirs}, spread=spread)
    assert verdict(above("pebble", "rrm-proxy", reading=FINAL), found) == expected


def test_two_methods_are_resampled_apart():
    """The interval of a difference is wider than that of either method, as of two independent ones."""
    found = store({"rrm-proxy": 0.6, "pebble": 0.4}, spread=0.2)
    (difference,) = judge(claim(*above("pebble", "rrm-proxy", reading=FINAL)), {"e": found}, QUICK).findings
    (alone,) = judge(claim(*at_least(0.1, "pebble")), {"e": found}, QUICK).findings
    width, single = (float(each.estimate.high - each.estimate.low) for each in (difference, alone))
    assert 1.2 < width / single < 1.6


def test_a_claim_holds_where_all_its_comparisons_do():
    """One refuted comparison refutes the claim; one open comparison leaves it open."""
    tests = below(0.65, "sac-proxy", "sac-h2o")
    assert verdict(tests, store({"sac-proxy": 0.3, "sac-h2o": 0.4})) == "held"
    assert verdict(tests, store({"sac-proxy": 0.3, "sac-h2o": 0.9})) == "not held"
    assert verdict(tests, store({"sac-proxy": 0.3})) == "not enough data"
    assert verdict(tests, store({"sac-proxy": 0.9})) == "not held"  # whatever the missing one would say


def test_many_comparisons_are_not_refuted_by_chance():
    """What refutes a claim by itself does not as one of fifty: one of so many is soon beyond its interval by chance."""
    found = store({"sac-proxy": 0.66}, spread=0.1, seeds=10)
    values = found.series[0].values
    low = float(judge(claim(*below(0.5, "sac-proxy")), {"e": found}, QUICK).findings[0].estimate.low)
    bound = low - 0.001
    assert values.mean() < bound
    assert verdict(below(bound, "sac-proxy"), found) == "not held"
    many = tuple(dataclasses.replace(test) for test in below(bound, *["sac-proxy"] * 50))
    assert verdict(many, found) == "not enough data"


def test_too_little_data_is_told():
    """Two seeds, a missing method, runs under way and an unknown experiment are each named as what is missing."""
    tests = below(0.65, "sac-proxy")
    running, failed = {("sac-proxy", seed): "running" for seed in range(10)}, {("sac-proxy", 3): "failed"}
    for found, why in (
        ({"e": store({"sac-proxy": 0.1}, seeds=2)}, "2 seeds; an interval needs 3"),
        ({"e": store({"pebble": 0.1})}, "no runs of sac-proxy, button-press"),
        ({"e": store({"sac-proxy": 0.1}, states=running)}, "0 of 10 planned runs are finished"),
        ({"e": store({"sac-proxy": 0.1}, states=failed)}, "9 of 10 planned runs are finished"),
        ({}, "no runs of e"),
        ({"e": store({"sac-proxy": 0.1}, profile="smoke")}, "smoke is no result"),
    ):
        judged = judge(claim(*tests), found, QUICK)
        assert judged.verdict == "not enough data"
        assert why in judged.deciding.why


@pytest.mark.parametrize(
    ("seeds", "comparisons", "expected"),
    [
        (3, 1, "open"), (4, 1, "open"), (5, 1, "settled"), (5, 2, "open"), (6, 2, "settled"), (7, 10, "open"),
        (8, 10, "settled"),
    ],
)  # fmt: skip
def test_few_seeds_refute_nothing_that_chance_would(seeds, comparisons, expected):
    """However far from the bound, all of n seeds are on one side of their median in 0.5^n of studies: where that is
    more than 5 %, or 5 % of so many comparisons, nothing is refuted; and nothing held where it is more than 5 %.
    """
    found = store({"sac-proxy": 1.0}, seeds=seeds, spread=0.0)
    tests = below(0.5, *["sac-proxy"] * comparisons)
    wanted = {"open": "not enough data", "settled": "not held"}[expected]
    judged = judge(claim(*tests), {"e": found}, QUICK)
    assert judged.verdict == wanted
    assert ("of studies" in judged.deciding.why) == (expected == "open")
    held = "held" if seeds >= 5 else "not enough data"
    assert verdict(at_least(0.5, *["sac-proxy"] * comparisons), found) == held


def test_chance_has_few_orders_of_two_methods_and_of_several_tasks():
    """Of two methods every order of their seeds is as likely; tasks whose seeds are all alike add nothing."""
    assert by_chance([[3]]) == 0.125
    assert by_chance([[3, 3]]) == pytest.approx(1 / 20)
    assert by_chance([[5, 5]]) == pytest.approx(1 / 252)
    assert by_chance([[3], [4]]) == 0.125
    assert by_chance([[3, 3], [3, 4]]) == pytest.approx(1 / 20)
    orders = [set(first) for first in itertools.combinations(range(7), 3)]
    assert by_chance([[3, 4]]) == sum(min(first) > max(set(range(7)) - first) for first in orders) / len(orders)


def test_a_claim_is_judged_on_the_tasks_that_were_planned():
    """A task on which nobody planned what the claim compares is left out, and said; one that is not finished is not."""
    tests, tasks = above("pebble", "rrm-proxy", reading=FINAL), ("button-press", "door-open", "door-unlock")
    labels = [(task, name, "oracle", FULL) for task in tasks[:2] for name in ("rrm-proxy", "pebble")]
    series = {label: curve(0.9 if label[1] == "rrm-proxy" else 0.1) for label in labels}
    for pooled in (False, True):
        about = claim(*tests, tasks=tasks, pooled=pooled)
        judged = judge(about, {"e": section("e", series, steps=[1])}, QUICK)
        assert (judged.verdict, judged.tasks) == ("held", tasks[:2])
        half = section("e", {label: series[label] for label in labels[:3]}, steps=[1])
        assert judge(about, {"e": half}, QUICK).tasks == tasks[:1]
        under_way = section("e", series, steps=[1], states={("pebble", 4): "queued"})
        assert judge(about, {"e": under_way}, QUICK).verdict == "not enough data"


def test_a_task_that_is_left_out_is_named_in_the_verdict():
    """A verdict on one of two tasks says so."""
    one = {label: values for label, values in ABLATION.items() if label[0] == "button-press"}
    (report,) = claims.make([section("ablation-prior", one, steps=[1, 2])], QUICK)
    verdicts = dict(zip(report.table["claim"], report.table["verdict"], strict=True))
    assert verdicts["opposite-alone-fails"] == "held (1 of 2 tasks)"
    assert verdicts["zero-trails-first"] == "not enough data"


def test_the_box_needs_seeds_for_an_interval_too():
    """Two seeds have none, of either method, whatever the other has."""
    for name in ("rrm-proxy", "pebble"):
        series = {
            ("button-press", each, "oracle", FULL): curve(0.0, end, seeds=2 if each == name else 10)
            for each, end in (("rrm-proxy", 0.9), ("pebble", 0.1))
        }
        found = section("e", series, steps=[1, 2])
        judged = judge(claim(*above("pebble", "rrm-proxy", reading=BOX)), {"e": found}, QUICK)
        assert (judged.verdict, judged.deciding.why) == ("not enough data", "2 seeds; an interval needs 3")


def test_the_step_of_the_box_needs_all_its_methods():
    """Who is read there depends on whoever is the first at 100 %: all planned runs of the panel have to be done."""
    series = {
        ("button-press", name, "oracle", FULL): curve(0.0, end, end) for name, end in
        (("rrm-proxy", 0.9), ("pebble", 0.1), ("rrm-imitation", 0.5))
    }  # fmt: skip
    tests = above("pebble", "rrm-proxy", reading=BOX)
    assert verdict(tests, section("e", series, steps=[1, 2, 3])) == "held"
    early = section("e", series, steps=[1, 2, 3], states={("rrm-imitation", 2): "interrupted"})
    judged = judge(claim(*tests), {"e": early}, QUICK)
    assert judged.verdict == "not enough data"
    assert "of rrm-imitation 4 of 5 planned runs are finished" in judged.deciding.why


def test_a_method_is_not_better_for_having_chosen_the_step():
    """Two methods that take turns at 100 % are alike, whichever of them happens to be there first."""
    first, second = np.tile([0.2, 1.0, 0.2, 1.0, 0.2, 1.0], (5, 1)), np.tile([0.2, 0.2, 1.0, 0.2, 1.0, 0.2], (5, 1))
    first[:1, 1] = second[:1, 2] = 0.5  # four of five: enough, in about three of four resampled studies
    labels = [("button-press", name, "oracle", FULL) for name in ("rrm-proxy", "pebble")]
    found = section("e", dict(zip(labels, (first, second), strict=True)), steps=[1, 2, 3, 4, 5, 6])
    for ours, theirs in (("rrm-proxy", "pebble"), ("pebble", "rrm-proxy")):
        (finding,) = judge(claim(*above(theirs, ours, reading=BOX)), {"e": found}, QUICK).findings
        assert (finding.estimate.low < 0 < finding.estimate.high, finding.verdict) == (True, "not enough data")


def test_one_experiment_that_does_not_belong_together_costs_its_own_claims_alone():
    """The others are judged, and the refusal is told."""
    good = section("ablation-prior", ABLATION, steps=[1, 2])
    refusal = UserError("less-feedback: its runs do not belong in one report")
    bad = dataclasses.replace(good, experiment="less-feedback", refusal=refusal)
    (report,) = claims.make([good, bad], QUICK)
    assert "less-feedback: not judged. less-feedback: its runs do not belong in one report." in report.notes
    why = dict(zip(report.table["claim"], report.table["why"], strict=True))
    assert why["pebble-needs-feedback"] == "less-feedback: its runs do not belong in one report"
    assert "held" in set(report.table["verdict"])


def test_readings():
    """The last step, the mean over the steps, the beginning, the box's step and the spread are what they say."""
    values = np.array([[0.0, 0.2, 1.0, 0.8]] * 5)
    found = section("e", {("button-press", "pebble", "oracle", FULL): values}, steps=[100, 200, 300, 400])

    def read(reading):
        (finding,) = judge(claim(*at_least(0.1, "pebble", reading=reading)), {"e": found}, QUICK).findings
        return float(finding.estimate.estimate)

    assert read(FINAL) == pytest.approx(0.8)
    assert read(MEAN) == pytest.approx(0.5)
    assert read(BOX) == 1.0  # four of five seeds are at 100 % at step 300
    assert read(Reading(words="half", until=0.5)) == pytest.approx(0.2)
    assert read(Reading(words="first half", until=0.5, steps="all")) == pytest.approx(0.1)
    assert read(Reading(words="spread", spread=True)) == pytest.approx(0.0)


@pytest.mark.parametrize(("seeds", "expected"), [(3, 0.1), (9, np.sqrt(0.0046875)), (1, float("nan"))])
def test_few_seeds_do_not_seem_steadier(seeds, expected):
    """The deviation is an estimate of the population's (n - 1), which one seed has none of."""
    found = store({"pebble": 0.5}, seeds=seeds)
    reading = Reading(words="spread", spread=True)
    (finding,) = judge(claim(*at_least(0.0, "pebble", reading=reading)), {"e": found}, QUICK).findings
    assert float(finding.estimate.estimate) == pytest.approx(expected, nan_ok=True)


def test_schedules_are_found_at_every_scale():
    """A tenth of the questions is a tenth of them in a shorter profile too."""
    tests = below(0.6, "pebble (batch x 0.1)", "pebble (every x 4)")
    for labels in ((FULL, LITTLE, "50@20000/1250"), ("50@2500/2000", "5@2500/200", "50@10000/500")):
        ends = dict(zip(labels, (0.9, 0.2, 0.3), strict=True))
        series = {("button-press", "pebble", "oracle", name): curve(end, end) for name, end in ends.items()}
        judged = judge(claim(*tests), {"e": section("e", series, steps=[1, 2])}, QUICK)
        assert [float(each.estimate.estimate) for each in judged.findings] == pytest.approx([0.2, 0.3])
        assert judged.verdict == "held"


def test_pooled_tasks_are_one_number():
    """Tasks read at one step each are pooled as in the box figure."""
    labels = [(task, "pebble", "oracle", FULL) for task in ("button-press", "door-open")]
    found = section("e", {labels[0]: curve(0.2), labels[1]: curve(0.8)}, steps=[1])
    pooled = claim(*at_least(0.1, "pebble"), tasks=("button-press", "door-open"), pooled=True)
    (finding,) = judge(pooled, {"e": found}, QUICK).findings
    assert (float(finding.estimate.estimate), finding.estimate.n) == (pytest.approx(0.5), 5)


@pytest.mark.slow
def test_a_success_rate_with_less_feedback_is_the_last_one():
    """PEBBLE "drops below 60 %" and priors "achieve at least 85 %" at the last step, as a mean over the tasks' IQMs:
    getting there late does no harm, and no hard task is pooled away.
    """
    names = ("pebble-needs-feedback", "rrm-needs-less")
    pebble, rrm = ({test.reading for test in each.tests} for each in CLAIMS if each.name in names)
    assert {reading.words for reading in pebble | rrm} == {"last step, mean over tasks"}
    series = {}
    for at, task in enumerate(("button-press", "door-open", "door-unlock", "sweep-into")):
        end = 0.5 if at == 0 else 1.0  # mean 87.5 %; the middle half of all seeds would be 100 %
        for name in ("rrm-proxy", "rrm-language"):
            for asked in (FULL, "25@5000/2500", "10@5000/1000", LITTLE, "50@10000/2500", "50@20000/1250"):
                series[task, name, "oracle", asked] = curve(0.0, 0.0, 0.0, end, seeds=5)
    (rrm_claim,) = (each for each in CLAIMS if each.name == "rrm-needs-less")
    judged = judge(rrm_claim, {"less-feedback": section("less-feedback", series, steps=[1, 2, 3, 4])}, QUICK)
    assert {float(each.estimate.estimate) for each in judged.findings} == {0.875}
    assert judged.verdict == "held"


def test_a_claim_about_one_step_can_be_judged_on_several_evaluations():
    """A score at a step is then the mean of the last ones; means over steps, and accuracies, are as ever."""
    values = np.array([[0.0, 0.2, 1.0, 0.6]] * 5)
    told = {"success": values, "true_accuracy": values}
    found = section("e", {("button-press", "pebble", "oracle", FULL): told}, steps=[100, 200, 300, 400])
    accuracy = Reading(words="accuracy", measure="true_accuracy", unit="success")
    for reading, wanted in ((FINAL, 0.8), (BOX, 0.6), (MEAN, 0.45), (accuracy, 0.6)):
        tests = claim(*at_least(0.1, "pebble", reading=reading))
        (finding,) = judge(tests, {"e": found}, Statistics(replicates=300, last=2)).findings
        assert float(finding.estimate.estimate) == pytest.approx(wanted), reading.words


def test_measured_columns_are_claimed_too():
    """Agreement with the true reward after a tenth of the training, and whether prior or residual weighs more."""
    ramp = np.linspace(0, 1, 50)
    columns = {
        "success": ramp, "true_accuracy": np.minimum(1.0, 0.5 + 6 * ramp),
        "prior_mean": np.full(50, -0.5), "residual_mean": 2 * ramp,
    }  # fmt: skip
    told = {name: np.tile(values, (5, 1)) for name, values in columns.items()}
    found = section("opposite-prior", {("button-press", "rrm-opposite", "oracle", FULL): told}, steps=STEPS)
    by_name = {each.name: judge(each, {"opposite-prior": found}, QUICK) for each in CLAIMS}
    names = ("opposite-prior-first", "opposite-accuracy", "opposite-residual-last")
    assert [by_name[name].verdict for name in names] == ["held", "held", "held"]
    assert float(by_name["opposite-residual-last"].findings[0].estimate.estimate) == pytest.approx(1.5)
    told["true_accuracy"][:, 4] = np.nan
    broken = section("opposite-prior", {("button-press", "rrm-opposite", "oracle", FULL): told}, steps=STEPS)
    (accuracy,) = (each for each in CLAIMS if each.name == "opposite-accuracy")
    assert "is not measured" in judge(accuracy, {"opposite-prior": broken}, QUICK).deciding.why


#: Success first and last, as the paper tells it of the experiments on images.
SEEN = {
    "main-results": {
        "pebble": (0.0, 0.2), "rrm-penalty": (0.1, 0.5), "rrm-language": (0.1, 0.7), "rrm-imitation": (0.2, 0.9)
    },
    "image-ablation": {
        "drqv2-penalty": (0.0, 0.0), "drqv2-language": (0.0, 0.02),
        "rrm-penalty": (0.0, 1.0), "rrm-language": (0.0, 1.0),
    },
    "image-encoder": {
        "pebble": (0.0, 0.2), "rrm-penalty": (0.1, 0.9), "rrm-language": (0.1, 0.9), "rrm-imitation": (0.7, 0.8)
    },
}  # fmt: skip


@pytest.mark.parametrize(("experiment", "arms"), SEEN.items())
def test_claims_about_images(experiment, arms):
    """All hold where the curves are as the paper tells them, none where success and failure change places."""
    about = [each for each in CLAIMS if each.experiment == experiment and each.tasks[0].endswith("-image")]
    labels = itertools.product(about[0].tasks, arms)
    told = {(task, method, "oracle", FULL): curve(*arms[method], seeds=7) for task, method in labels}
    otherwise = {label: 1 - values for label, values in told.items()}
    for series, expected in ((told, "held"), (otherwise, "not held")):
        found = {experiment: section(experiment, series, steps=[1, 2])}
        assert [judge(each, found, QUICK).verdict for each in about] == [expected] * len(about)


def planned(name):
    """A section with three seeds of everything that a manifest plans, made up."""
    plan = make_plan(load(EXPERIMENTS / f"{name}.toml"), seeds=(0, 1, 2))
    labels = dict.fromkeys((job.task, job.method, job.teacher, job.feedback) for job in plan.jobs)
    rng = np.random.default_rng(0)
    return section(name, {label: rng.random((3, len(STEPS))) for label in labels}, steps=STEPS)


@pytest.mark.slow
@pytest.mark.parametrize("experiment", sorted({each.experiment for each in CLAIMS}))
def test_every_claim_is_one_of_a_manifest(experiment):
    """What a claim compares is what its experiment plans: with all runs there, no comparison misses any."""
    found = planned(experiment)
    for each in (each for each in CLAIMS if each.experiment == experiment):
        judged = judge(each, {experiment: found}, Statistics(replicates=100))
        assert judged.tasks == each.tasks
        assert all(finding.estimate.n == 3 for finding in judged.findings), each.name


ENTRY = {"arms": ["pebble"], "below": 0.5, "reading": "final"}
CLAIM = {"name": "c", "says": "so", "where": "here", "experiment": "e", "tasks": ["button-press"]}


@pytest.mark.parametrize(
    ("claim", "entry", "error"),
    [
        ({"say": "so"}, {}, ValueError),
        ({}, {"belo": 0.5}, ValueError),
        ({}, {"at least": 0.5}, ValueError),
        ({}, {"reading": "nowhere"}, KeyError),
        ({}, {"arms": ["pebble (batches x 0.1)"]}, ValueError),
        ({}, {"arms": ["pebble (mistaken-10"]}, ValueError),
    ],
)
def test_a_file_of_claims_holds_nothing_unknown(claim, entry, error):
    """A key, relation, reading or arm that is none is refused, and what is left is a claim."""
    readings = {"final": {"words": "last step"}}
    (read,) = read_claims({"readings": readings, "claims": [CLAIM | {"tests": [ENTRY]}]})
    assert read.tests == below(0.5, "pebble")
    with pytest.raises(error):
        read_claims({"readings": readings, "claims": [CLAIM | {"tests": [ENTRY | entry]} | claim]})
    for key, value in (("step", "all"), ("steps", "al"), ("measure", "label accuracy"), ("unit", "percent")):
        with pytest.raises(ValueError, match=key):
            read_claims({"readings": {"final": {"words": "last step", key: value}}, "claims": []})


def test_arms_are_written_as_they_are_shown():
    """A method, its teacher, or its feedback by its proportion to the fullest schedule."""
    assert Arm.of("rrm-proxy")[1:] == ("rrm-proxy", None, None)
    assert Arm.of("pebble (mistaken-10)") == Arm("pebble (mistaken-10)", "pebble", "mistaken-10", None)
    fields = ("full feedback", "batch x 0.1", "every x 4", "budget x 0.2")
    schedules = [Arm.of(f"pebble ({words})").budget for words in fields]
    assert schedules == [(1.0, 1.0, 1.0), (0.1, 1.0, None), (1.0, 4.0, None), (1.0, 1.0, 0.2)]
    assert Arm.of("mrn (mistaken-10, batch x 0.2)")[1:] == ("mrn", "mistaken-10", (0.2, 1.0, None))
    for words in ("mrn ()", "mrn (mistaken-10, )", "mrn (batch x 0.2, mistaken-10)", "mrn (mistaken-10batch x 0.2)"):
        with pytest.raises(ValueError, match="is no method"):
            Arm.of(words)


def test_claims_have_names_of_their_own():
    """Names are unique, and claims of one experiment stand together."""
    assert len({each.name for each in CLAIMS}) == len(CLAIMS)
    changes = [a.experiment != b.experiment for a, b in itertools.pairwise(CLAIMS)]
    assert sum(changes) + 1 == len({each.experiment for each in CLAIMS})


ABLATION = {
    ("door-unlock", "sac-opposite", "-", "-"): curve(0, 0.0, seeds=10),
    ("button-press", "sac-opposite", "-", "-"): curve(0, 0.0, seeds=10),
    ("door-unlock", "rrm-opposite", "oracle", FULL): curve(0, 0.5, seeds=10),
    ("button-press", "rrm-opposite", "oracle", FULL): curve(0, 1.0, seeds=10),
}


def test_the_table_lists_every_claim_with_its_verdict():
    """Each claim is a row with the comparison that decides; the frame has a row for each comparison."""
    (report,) = claims.make([section("ablation-prior", ABLATION, steps=[1, 2])], QUICK)
    verdicts = {row[1]: row[2] for row in report.grid.rows}
    assert len(report.grid.rows) == len(CLAIMS)
    assert verdicts["... despite SAC not being able to learn from it"] == "held"
    assert verdicts["with an opposite proxy reward RRM still achieves a 100 % success rate"] == "not held"
    assert len(report.table) == sum(len(c.tests) * (1 if c.pooled else len(c.tasks)) for c in CLAIMS)
    failed = report.table[(report.table["claim"] == "opposite-reaches-100") & report.table["decides"]].iloc[0]
    assert (failed["task"], failed["found"], failed["low"], failed["n"]) == ("door-unlock", 0.5, 0.5, 10)
    assert report.notes[0].startswith(f"{len(CLAIMS)} claims: ")


def test_other_profiles_are_named_in_the_verdict():
    """Profiles are judged apart, and a verdict that is not of the paper's scale says so, as do overrides."""
    paper = section("ablation-prior", ABLATION, steps=[1, 2])
    laptop = section("ablation-prior", ABLATION, steps=[1, 2], profile="laptop", overrides={"agent.batch": 64})
    first, second = claims.make([paper, laptop], QUICK)
    assert set(first.table["verdict"]) == {"held", "not held", "not enough data"}
    assert "held (profile laptop, agent.batch=64)" in set(second.table["verdict"])
    assert all(name.endswith("(profile laptop, agent.batch=64)") for name in second.table["verdict"])


def test_experiments_without_claims_have_no_table():
    """Of an experiment the prose does not speak of there is nothing to judge."""
    with pytest.raises(NoDataError, match="claims nothing"):
        claims.make([section("toy-car", {("toy-car", "pebble", "oracle", FULL): curve(1.0)}, steps=[1])], QUICK)
