"""Whatever a manifest, an override or an option says, `rrmctl plan` answers with a plan or with one clear message.

The shipped manifests are mutilated as structures and as bytes, settings are overridden with what does not suit them,
options are given any text; each question goes through the command line. An answer is a plan whose runs lie inside the
results folder, or exit code 2 with a message that names what is wrong. `run` refuses what `plan` refuses, in the same
words.
"""

from __future__ import annotations

import copy
import json
import shutil
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from datetime import UTC, date, datetime, time
from pathlib import Path
from typing import Any

import pytest
import typer.main
from hypothesis import HealthCheck, assume, given, settings
from hypothesis import strategies as st
from typer.testing import CliRunner, Result

from rrm.training.run_config import RunConfig
from rrmctl.cli.app import app
from rrmctl.planning.manifest import Grid
from rrmctl.planning.profiles import profiles
from rrmctl.planning.settings import known_settings
from rrmctl.store.layout import RUN_ID, Layout

EXPERIMENTS = Path(__file__).parents[3] / "experiments"

#: A few for every day, thousands for `make test-slow`; the promises are the same.
FEW_OR_MANY = pytest.mark.parametrize("examples", [20, pytest.param(1000, marks=[pytest.mark.slow, pytest.mark.long])])
UNHURRIED = {"suppress_health_check": [HealthCheck.too_slow, HealthCheck.filter_too_much]}


def call(*arguments: str) -> Result:
    return CliRunner().invoke(app, arguments)


class Workshop:
    """A folder with the shipped manifests, a file of the user's own, and a results folder that holds one file."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.results = folder / "results"
        self.results.mkdir()
        (self.results / "mine.txt").write_text("kept")
        (folder / "loop.py").symlink_to("loop.py")
        shutil.copytree(EXPERIMENTS, folder / "experiments")
        (folder / "own.py").write_text(f"open({str(folder / 'ran')!r}, 'w')\ndef near(step): ...\nclass Learner: ...\n")

    def ask(self, name: str, *options: str) -> str | None:
        """What is said against the request; None where it was planned. Every promise is checked on the way."""
        asked = [f"--results={self.results}", f"--experiments={self.folder / 'experiments'}", *options, "--", name]
        before = self._files()
        planned = call("plan", "--json", *asked)
        if planned.exit_code == 0:
            self._check_plan(json.loads(planned.stdout))
            assert call("plan", "--jobs", *asked).exit_code == 0
        else:
            check_refusal(planned, sum(map(len, asked)))
            ran = call("run", *asked)
            assert (ran.exit_code, ran.stdout, ran.stderr) == (2, "", planned.stderr)
        assert self._files() == before
        return None if planned.exit_code == 0 else planned.stderr

    def ask_file(self, content: bytes, *options: str) -> str | None:
        """The same, of a manifest with this content."""
        path = self.folder / "broken.toml"
        path.write_bytes(content)
        said = self.ask(str(path), *options)
        assert said is None or any(place in said for place in ("broken", *(each.split("=")[0] for each in options)))
        return said

    def _check_plan(self, plan: dict[str, Any]) -> None:
        """Runs of distinct identities, and every file of theirs and of the sweep's inside the results folder."""
        jobs = [*plan["jobs"], *plan["needed"]]
        assert jobs
        assert len({job["id"] for job in jobs}) == len(jobs)
        layout = Layout(self.results)
        files = [layout.run(job["id"]).config for job in jobs]
        for place in (layout.sweep, layout.trial):
            files.append(place(plan["experiment"], plan["variant"]))
        files.append(layout.aggregate(plan["experiment"]))
        assert all(RUN_ID.fullmatch(job["id"]) for job in jobs)
        assert all(self.results.resolve() in file.resolve().parents for file in files)

    def _files(self) -> list[str]:
        """What lies about, but for the manifest; the user's own file leaves `ran` where it is run."""
        return sorted(str(path) for path in self.folder.rglob("*") if path.name != "broken.toml")


def check_refusal(result: Result, typed: int) -> None:
    """Exit code 2, one message on standard error, no traceback, nothing on standard output.

    Args:
        typed: characters of the request: what is wrong with it may be repeated.
    """
    assert result.exception is None or isinstance(result.exception, SystemExit), repr(result.exception)
    assert (result.exit_code, result.stdout) == (2, "")
    assert result.stderr.startswith("error: ")
    assert len(result.stderr) > len("error: ") + 10
    assert "Traceback" not in result.stderr
    assert len(result.stderr) < 4000 + 2 * typed
    assert not [sign for sign in result.stderr if ord(sign) < 32 and sign not in "\n\t"]


@pytest.fixture(scope="module")
def workshop(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Workshop]:
    command = typer.main.get_command(app)
    with pytest.MonkeyPatch.context() as patch:
        # Built once: building it anew takes longer than most answers.
        patch.setattr("typer.testing._get_command", lambda app: command, raising=False)
        patch.chdir(tmp_path_factory.mktemp("malformed"))
        yield Workshop(Path.cwd())


# ---- manifests as structures

#: Names that mean something to a file system, a terminal, a shell, a table or a parser.
ODD = [
    "", " ", ".", "..", "../../etc/passwd", "/etc/passwd", "/dev/zero", "~/x", "a/b", "a\\b", "C:\\x", "con", "-rf",
    "--help", "x" * 300, "x/" * 2100, "x" * 300 + ".py:f", "own.py:near", "./own.py:near", "own.py:__class__",
    "own.py:Learner", "../own.py:near", "/nowhere/own.py:near", "{task}.py:near", "loop.py:near", "os:system",
    "os.path:join", "builtins:eval", "__import__('os').system('true')", "http://localhost/x.py:f", "a\0b", "a\0.py:f",
    "a\nb", "\x1b[2J", "[/b]", "[bold]", "[link=x]", ":smile:", "%s{}", "$HOME", "$(true)", "Å", "é", "e\u0301",
    "\u202ea", "\ufeff", "\U0001f600", "PEBBLE", "Pebble", "Toy-Car", "toy-car", "button-press", "pebble", "rrm-zero",
    "sac-h2o", "oracle", "none", "nan", "a,b", "tasks", "methods", "agent.batch", "seed", "task", "reward.prior",
    "smoke", "laptop", "paper", "prior", "true",
]  # fmt: skip
TEXTS = st.sampled_from(ODD) | st.text(st.characters(codec="utf-8", exclude_categories=["Cc"]), max_size=8)
# None that would be a plan of tens of thousands of runs: those have a test of their own.
INTEGERS = st.integers(-3, 12) | st.sampled_from(
    [10**5, 10**6, 2**31, 2**32, 2**53, 2**63 - 1, -(2**63), 10**30, 10**4200]
)
SCALARS = st.one_of(
    INTEGERS,
    st.floats() | st.sampled_from([1e5, 1e300, 5e-324]),
    st.booleans(),
    TEXTS,
    st.sampled_from([date(2020, 1, 1), time(1, 2), datetime(2020, 1, 1, tzinfo=UTC), datetime(2020, 1, 1)]),
)
JUNK = st.recursive(
    SCALARS, lambda inner: st.lists(inner, max_size=3) | st.dictionaries(TEXTS, inner, max_size=3), max_leaves=6
)
KEYS = TEXTS | st.sampled_from([
    "title", "reproduces", "rule", "default_profile", "seeds", "defaults", "task", "method", "teacher", "feedback",
    "profile", "grid", *Grid.model_fields, "learner", "prior", "steps", "agent", "batch", "reward", "options",
    "imitation", "demos", "horizon", "segment", "every", "budget", "schedule", "threads", "precision",
])  # fmt: skip


def small(path: Path) -> dict[str, Any]:
    """A shipped manifest with two seeds, so that planning it is quick."""
    return tomllib.loads(path.read_text()) | {"seeds": 2}


SHIPPED = [small(path) for path in sorted(EXPERIMENTS.glob("*.toml"))]


def places(tree: Any) -> Iterator[tuple[Any, Any]]:
    """Every entry of every table and list: what holds it, and its key."""
    for key, value in tree.items() if isinstance(tree, dict) else enumerate(tree):
        yield tree, key
        if isinstance(value, dict | list):
            yield from places(value)


def put(holder: Any, key: Any, value: Any) -> None:
    if isinstance(holder, list):
        holder.append(value)
    else:
        holder[key] = value


@st.composite
def mutilated(draw: st.DrawFn) -> dict[str, Any]:
    """A shipped manifest with one to three things wrong."""
    table = copy.deepcopy(draw(st.sampled_from(SHIPPED)))
    for _ in range(draw(st.integers(1, 3))):
        found = list(places(table))
        assume(found)
        holder, key = found[draw(st.integers(0, len(found) - 1))]
        match draw(st.sampled_from(["drop", "rename", "replace", "wrap", "copy", "deepen", "add"])):
            case "drop":
                del holder[key]
            case "rename":
                put(holder, draw(KEYS), holder.pop(key))
            case "replace":
                holder[key] = draw(JUNK)
            case "wrap":
                holder[key] = [holder[key]]
            case "deepen":
                holder[key] = {draw(KEYS): holder[key]}
            case "copy":
                other = found[draw(st.integers(0, len(found) - 1))][0]
                put(other, draw(KEYS), copy.deepcopy(holder[key]))
            case "add":
                put(holder, draw(KEYS), draw(JUNK))
    return table


TASKS = st.sampled_from(["toy-car", "button-press", "walker-walk"])
METHODS = st.sampled_from(["oracle", "pebble", "finetune", "rrm-zero", "rrm-imitation", "sac-h2o", "mine"])
NAMES = TASKS | METHODS | st.sampled_from(["none", "x", "paper", "smoke", "oracle", "default"])
VALUES = SCALARS | st.lists(st.integers(), max_size=2)
TREES = st.dictionaries(
    st.sampled_from(["steps", "agent", "feedback", "horizon", "reward", "batch", "oddity"]),
    VALUES
    | st.dictionaries(st.sampled_from(["batch", "segment", "every", "options", "lr", "hidden"]), VALUES, max_size=3),
    max_size=3,
)


def one_or_two(names: st.SearchStrategy[str]) -> st.SearchStrategy[list[str]]:
    return st.lists(names, min_size=1, max_size=2, unique=True)


GRIDS = st.fixed_dictionaries(
    {"tasks": one_or_two(TASKS), "methods": one_or_two(METHODS)},
    optional={
        "teachers": one_or_two(st.sampled_from(["oracle", "mistaken-10", "x"])),
        "feedback": one_or_two(st.sampled_from(["default", "x"])),
        "zip": st.just([["tasks", "methods"]]),
        "exclude": st.lists(st.fixed_dictionaries({"task": NAMES}), max_size=1),
        "include": st.lists(st.fixed_dictionaries({"method": NAMES}, optional={"set": TREES}), max_size=1),
        "set": TREES,
    },
)
OWN = st.fixed_dictionaries({"prior": TEXTS}) | st.fixed_dictionaries({"learner": TEXTS})
#: The right sections, filled with what may or may not suit them.
COMPOSED = st.fixed_dictionaries(
    {"title": st.just("T"), "reproduces": st.just(["F"]), "rule": st.just("R"), "seeds": st.just(1),
     "grid": GRIDS | st.lists(GRIDS, min_size=1, max_size=2)},
    optional={"defaults": TREES, "default_profile": st.sampled_from(list(profiles())) | TEXTS} | {
        "method": st.dictionaries(METHODS | TEXTS, TREES | OWN, max_size=2),
        **{kind: st.dictionaries(NAMES, TREES, max_size=1) for kind in ("task", "teacher", "feedback", "profile")},
    },
)  # fmt: skip


def toml(value: Any) -> str:
    """The value as TOML; tables in one line."""
    match value:
        case bool():
            return str(value).lower()
        case str():
            return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
        case int():
            return str(value)
        case list():
            return f"[{', '.join(map(toml, value))}]"
        case dict():
            return f"{{{', '.join(f'{toml(key)} = {toml(inner)}' for key, inner in value.items())}}}"
        case date() | time():
            return value.isoformat()
    return repr(value)  # a float: TOML spells nan and inf alike


def as_file(table: dict[str, Any]) -> bytes:
    return "".join(f"{toml(key)} = {toml(value)}\n" for key, value in table.items()).encode()


@FEW_OR_MANY
def test_mutilated_manifests(workshop: Workshop, examples: int) -> None:
    """Keys dropped, renamed, doubled, values of another type, nested nonsense, odd numbers and names."""

    @settings(max_examples=examples, **UNHURRIED)
    @given(mutilated() | COMPOSED, st.sampled_from([(), ("--profile=smoke",)]))
    def answers(table: dict[str, Any], options: tuple[str, ...]) -> None:
        workshop.ask_file(as_file(table), *options)

    answers()


# ---- manifests as bytes


@st.composite
def garbled(draw: st.DrawFn) -> bytes:
    """The text of a shipped manifest with one to three accidents."""
    path = draw(st.sampled_from(sorted(EXPERIMENTS.glob("*.toml"))))
    data = path.read_bytes().replace(b"seeds = 10", b"seeds = 2")
    for _ in range(draw(st.integers(1, 3))):
        at = draw(st.integers(0, len(data)))
        lines = data.splitlines(keepends=True)
        line = draw(st.integers(0, len(lines)))
        match draw(st.sampled_from(["cut", "flip", "bytes", "bom", "crlf", "cr", "double", "lose", "code", "line"])):
            case "cut":
                data = data[:at]
            case "flip" if at < len(data):
                data = data[:at] + bytes([data[at] ^ 1 << draw(st.integers(0, 6))]) + data[at + 1 :]
            case "bytes":
                data = data[:at] + draw(st.binary(max_size=4)) + data[at:]
            case "bom":
                data = b"\xef\xbb\xbf" + data
            case "crlf":
                data = data.replace(b"\n", b"\r\n")
            case "cr":
                data = data.replace(b"\n", b"\r")
            case "code":
                data = data.decode("utf-8", "replace").encode(draw(st.sampled_from(["utf-16", "utf-32", "utf-8-sig"])))
            case "double":
                data = b"".join(lines[:line] + lines[line : line + 1] * 2 + lines[line + 1 :])
            case "lose":
                data = b"".join(lines[:line] + lines[line + 1 :])
            case "line":
                data = b"".join([*lines[:line], f"{draw(KEYS)} = {toml(draw(JUNK))}\n".encode(), *lines[line:]])
    return data


@FEW_OR_MANY
def test_garbled_manifests(workshop: Workshop, examples: int) -> None:
    """Cut off, flipped bits, stray bytes, other encodings and line ends, lines doubled and lost."""

    @settings(max_examples=examples, **UNHURRIED)
    @given(garbled())
    def answers(content: bytes) -> None:
        workshop.ask_file(content, "--seeds=1")

    answers()


# ---- overrides


def schema_of(name: str) -> dict[str, Any]:
    """What the configuration's own JSON schema says of a setting."""
    whole = RunConfig.model_json_schema()
    found: dict[str, Any] = whole
    for part in name.split("."):
        options = [found, *found.get("anyOf", ()), *found.get("oneOf", ())]
        refs = [whole["$defs"][option["$ref"].rpartition("/")[2]] for option in options if "$ref" in option]
        found = next(section["properties"][part] for section in refs or [found] if part in section["properties"])
    return found


SCHEMAS = {name: schema_of(name) for name in known_settings()}
WRONG_KIND = {
    "integer": ["1.5", '"1"', "true", "[1]", "{a=1}", "nan", "inf", "1979-01-01"],
    "number": ['"1"', "true", "[1]", "{a=1}", "nan", "inf", "-inf", "one"],
    "boolean": ["0", "2", '"true"', "yes", "[true]", "nan"],
    "string": ["1", "nan", "true", '["x"]', "{}", "07:32:00"],
    "array": ["1", "x", "[1.5]", '["x"]', "{}"],
    "object": ["1", "x", "[1]", "nan", "{a=nan}", "{a=1979-01-01}"],
}


def wrong_for(schema: dict[str, Any]) -> list[str]:
    """Values, as typed, that a setting of this schema cannot take."""
    kinds = [kind for kind in schema.get("anyOf", [schema]) if kind.get("type") != "null"]
    wrong = ["", "[", "9007199254740993" if kinds[0].get("type") != "object" else "1", "1e400"]
    for kind in kinds:
        wrong += WRONG_KIND.get(kind.get("type", "const"), ['"no such word"', "0"])
        wrong += [f"{kind[bound] - 1}" for bound in ("minimum", "exclusiveMinimum") if bound in kind]
        wrong += [f"{kind['exclusiveMinimum']}"] if "exclusiveMinimum" in kind else []
        wrong += [f"{kind['maximum'] + 1}"] if "maximum" in kind else []
        wrong += ['"no such word"'] if "enum" in kind else []
    pair = any(kind.get("maxItems") == 2 for kind in kinds)  # from where to where: one number stands for both
    return [value for value in wrong if not (pair and value == "1")]


@FEW_OR_MANY
def test_wrong_overrides(workshop: Workshop, examples: int) -> None:
    """A value that the configuration's schema excludes is refused, and the message names the setting."""

    @settings(max_examples=examples, **UNHURRIED)
    @given(st.sampled_from(sorted(SCHEMAS)).flatmap(
        lambda name: st.tuples(st.just(name), st.sampled_from(wrong_for(SCHEMAS[name])))
    ))  # fmt: skip
    def answers(override: tuple[str, str]) -> None:
        said = workshop.ask("toy-car", "--seeds=1", f"--set={'='.join(override)}")
        assert said is not None
        assert "--set" in said
        assert override[0] in said

    answers()


#: As a shell hands it over: any text without a null byte; bytes that are no UTF-8 arrive as lone surrogates.
TYPED = st.one_of(
    st.sampled_from(ODD), st.text(max_size=12), st.text(st.characters(categories=["Cc", "Cs", "Nd", "P"]), max_size=5)
).map(lambda text: text.replace("\0", ""))


@FEW_OR_MANY
def test_any_overrides(workshop: Workshop, examples: int) -> None:
    """Any value of any setting, any text for a key or a whole assignment."""
    values = TYPED | JUNK.map(toml).map(lambda text: text.replace("\0", ""))
    assignments = st.builds("{}={}".format, st.sampled_from(sorted(SCHEMAS)) | KEYS, values) | TYPED

    @settings(max_examples=examples, **UNHURRIED)
    @given(st.lists(assignments, min_size=1, max_size=2), st.sampled_from(["toy-car", "finetune"]))
    def answers(typed: list[str], name: str) -> None:
        options = [f"--set={text}".replace("\0", "") for text in typed]
        said = workshop.ask(name, "--seeds=1", *options)
        assert said is None or "--set" in said or any(text.partition("=")[0].strip() in said for text in typed)

    answers()


# ---- options

DIGITS = st.sampled_from([
    "0", "1", "2", "7", "007", "1_0", "١", "²", "1e3", "0x5", "1.0", "+1", "-1", "9" * 30, "9" * 5000, "1000000000",
    "10001", str(2**32), str(2**32 - 1), str(2**63),
])  # fmt: skip
SEEDS = TYPED | st.lists(DIGITS, max_size=4).map(",".join) | st.builds(
    "{}{}{}".format, DIGITS, st.sampled_from(["-", "..", ":", " ", ",", ", ", ";", "\t"]), DIGITS
)  # fmt: skip
LISTS = TYPED | st.lists(NAMES | TYPED, max_size=3).map(",".join)


@FEW_OR_MANY
def test_any_options(workshop: Workshop, examples: int) -> None:
    """Seeds as numbers, lists, ranges and nonsense; tasks, methods, priors, profiles and experiments of any name."""
    one = st.one_of(
        st.tuples(st.sampled_from(["--tasks", "--methods", "--prior", "--profile"]), LISTS),
        st.tuples(st.just("--prior"), st.sampled_from(["zero", "own.py:near", "../own.py:near"]) | TYPED),
    )

    @settings(max_examples=examples, **UNHURRIED)
    @given(SEEDS | st.just("1"), st.lists(one, max_size=2), st.sampled_from(["toy-car", "quickstart"]) | TYPED)
    def answers(seeds: str, typed: list[tuple[str, str]], name: str) -> None:
        said = workshop.ask(name, f"--seeds={seeds}", *map("=".join, typed))
        places = ["--seeds", *(option for option, _ in typed), "no experiment", "no file", "is a folder", "too long"]
        assert said is None or any(place in said for place in places)

    answers()


# ---- what was found once

GOOD = 'title = "T"\nreproduces = ["F"]\nrule = "R"\nseeds = 1\ngrid = {tasks = ["toy-car"], methods = ["mine"]}\n'
MINE = GOOD + "[method.mine]\n"
DEMOS = MINE + 'learner = "finetune"\nimitation.demos = '
NUL, ESC = r"\u0000", r"\u001b[2J"
ENDLESS = f"[defaults]\nsteps = {2**53}\nfeedback.every = 1\nfeedback.budget = {2**53}"


@pytest.mark.parametrize(
    ("text", "said"),
    [
        pytest.param(f"{GOOD}seeds2 = {'9' * 5000}", "digits", id="an integer of 5000 digits"),
        pytest.param(f"{GOOD}defaults.steps = 0x{'f' * 5000}", "defaults.steps", id="one in hexadecimals"),
        pytest.param(f"{GOOD}defaults.reward.options{'.a' * 5000} = 1", "nested", id="dotted 5000 deep"),
        pytest.param(f"{GOOD}default_profile{'.a' * 5000} = 1", "nested", id="a deep table in a message"),
        pytest.param(f"{GOOD}x = {'[' * 5000}", "nested", id="brackets 5000 deep"),
        pytest.param(f'{MINE}prior = "a{NUL}.py:f"', "method.mine.prior", id="null byte in the path of a prior"),
        pytest.param(f'{MINE}learner = "a{NUL}.py:f"', "method.mine.learner", id="of a learner"),
        pytest.param(f'{DEMOS}"a{NUL}"', "method.mine.imitation.demos", id="of demonstrations"),
        pytest.param(f'{MINE}prior = "{"x" * 300}.py:f"', "File name too long", id="too long a path of a prior"),
        pytest.param(f'{DEMOS}"{"x" * 300}"', "File name too long", id="of demonstrations"),
        pytest.param(f'{MINE}prior = "loop.py:f"', "loop.py", id="a circle of links as a prior"),
        pytest.param(f'{DEMOS}"loop.py"', "loop.py", id="as demonstrations"),
        pytest.param(f'{DEMOS}"/dev/zero"', "/dev/zero", id="demonstrations without end"),
        pytest.param(f'{GOOD}"{ESC}" = 1', r"\x1b[2J", id="escape sequence in a key"),
        pytest.param(GOOD.replace('"T"', f'"{ESC}"'), "title", id="in the title"),
        pytest.param(f'{GOOD}"{"x" * 5000}" = 1', "xxx", id="key of 5000 letters"),
        pytest.param(
            GOOD.replace("mine", "[/b]") + '[method."[/b]"]\nlearner = "pebble"', "[/b]", id="markup for a name"
        ),
        pytest.param(
            GOOD.replace("mine", "..") + '[method.".."]\nlearner = "pebble"', "'..'", id="a folder for a name"
        ),
        pytest.param(GOOD.replace("mine", "pebble") + ENDLESS, "feedback.every", id="sessions without end"),
        pytest.param(GOOD.replace("T", "T" * 300_000), "longer than", id="a very large file"),
        pytest.param(f'{GOOD}default_profile = "x"', "broken.toml: default_profile", id="which profile is unknown"),
    ],
)
def test_manifests_that_were_not_answered_well(workshop: Workshop, text: str, said: str) -> None:
    """Once a traceback, a plan, a loop without end, a message that nobody could read, or one that named no place."""
    answer = workshop.ask_file(text.encode())
    assert answer is not None
    assert said in answer


@pytest.mark.parametrize(
    ("name", "options", "said"),
    [
        ("x" * 300 + ".toml", (), "File name too long"),
        ("x" * 300, (), "File name too long"),
        ("", (), 'no experiment ""'),
        ("toy-car", ("--profile=",), 'unknown profile ""'),
        ("toy-car", ("--results=" + "x" * 300,), "File name too long"),
        ("toy-car", ("--tasks=\x1b[2J",), r"\x1b[2J"),
        ("toy-car", ("--set=agent.batch=\x1f",), r"\x1f"),
        ("toy-car", ("--set=" + "x" * 5000,), "--set"),
        ("toy-car", ("--set=agent.batch=" + "9" * 5000,), "agent.batch"),
        ("toy-car", ("--set=agent.batch=0x" + "f" * 5000,), "agent.batch"),
        ("toy-car", ("--set=reward.options={a" + ".a" * 5000 + "=1}",), "nested"),
        ("finetune", (r'--set=imitation.demos="a\u0000"',), "imitation.demos"),
        ("finetune", ("--set=imitation.demos=/dev/zero",), "/dev/zero"),
        ("toy-car", ("--prior=" + "x" * 300 + ".py:f",), "File name too long"),
        ("toy-car", ('--set=reward.options={a="\udcff"}',), "reward.options"),
    ],
    ids=lambda value: ascii(value)[:30],
)
def test_options_that_were_not_answered_well(
    workshop: Workshop, name: str, options: tuple[str, ...], said: str
) -> None:
    """Likewise of what is typed."""
    answer = workshop.ask(name, "--seeds=1", *options)
    assert answer is not None
    assert said in answer


def test_long_names_are_refused_before_anything_is_written(workshop: Workshop) -> None:
    """An experiment whose name is too long for a file of the store is never begun."""
    path = Path(f"{'x' * 129}.toml")
    path.write_text(GOOD.replace("mine", "oracle"))
    assert "128" in str(workshop.ask(str(path)))


def test_texts_are_shown_as_they_are_written(workshop: Workshop) -> None:
    """Brackets and colons in a manifest's texts and in overrides are no markup; a byte-order mark is no mistake."""
    text = (
        GOOD.replace('"T"', '"T [/b] :smile: [red]x"').replace("mine", "toy")
        + '[method.toy]\nlearner = "own.py:Learner"'
    )
    Path("texts.toml").write_text(text, encoding="utf-8-sig")
    shown = call("plan", "texts.toml", "--results=results", '--set=reward.options={a = ["[/b] :smile:"]}')
    assert shown.exit_code == 0, shown.stderr
    assert "T [/b] :smile: [red]x" in shown.stdout
    assert '["[/b] :smile:"]' in shown.stdout
    listed = call("list", "--experiments=.")
    assert "[/b] :smile: [red]x" in listed.stdout


# ---- bounds

#: Questions whose answer would take days or all memory, were it worked out: manifest, options, what is said.
ENTRY = '{method = "n1"}, '
MANY = [f"n{number}" for number in range(3000)]
BOMBS: dict[str, tuple[str, list[str], str]] = {
    "seeds": ("", ["--seeds=1000000000"], "any number from 1 to 10000"),
    "a range": ("", ["--seeds=0-1000000000"], "expected a number of seeds"),
    "a list of seeds": ("", [f"--seeds={','.join(map(str, range(20_000)))}"], "at most 10000"),
    "seeds in the manifest": (GOOD.replace("seeds = 1", "seeds = 1000000000"), [], "any number from 1 to 10000"),
    "a seed given twice": (GOOD.replace("seeds = 1", f"seeds = {[*range(9_999), 0]}"), [], "seed 0 is given twice"),
    "axes": (GOOD[: GOOD.index("grid")] + f"[grid]\ntasks = {MANY}\nmethods = {MANY}\nfeedback = {MANY}", [], "rows"),
    "a name given twice": (GOOD.replace('"mine"', ", ".join(map(repr, [*MANY * 9]))), [], "named twice"),
    "includes": (GOOD.replace('["mine"]', f"{MANY[:100]}, include = [{ENTRY * 3000}]"), [], "rows"),
    "grids": (
        f"{GOOD[: GOOD.index('grid')]}" + f"[[grid]]\ntasks = {MANY[:70]}\nmethods = {MANY[:70]}\n" * 200, [], "rows"
    ),
    "runs": (
        GOOD.replace('["mine"]', f'["pebble"], feedback = {MANY[:50]}')
        + "".join(f"[feedback.{name}]\nbatch = {at + 1}\n" for at, name in enumerate(MANY[:50])),
        ["--seeds=10000"],
        "500,000 runs",
    ),
    "sessions": (GOOD.replace("mine", "pebble") + ENDLESS, [], "feedback.every"),
    "a file without end": ("", ["--set=imitation.demos=/dev/zero"], "/dev/zero"),
}  # fmt: skip
LIMITED = """
import json, resource, sys
from typer.testing import CliRunner
resource.setrlimit(resource.RLIMIT_CPU, (120, 120))
resource.setrlimit(resource.RLIMIT_AS, (3 << 30, 3 << 30))
from rrmctl.cli.app import app
answers = [CliRunner().invoke(app, ["plan", *arguments]) for arguments in json.load(sys.stdin)]
print(json.dumps([[answer.exit_code, answer.stderr, repr(answer.exception)] for answer in answers]))
print([name for name in ("torch", "mujoco", "metaworld", "pandas") if name in sys.modules])
"""


@pytest.mark.slow
def test_no_request_takes_all_time_or_memory(tmp_path: Path) -> None:
    """What would be expanded without end is refused before; within bounds on time and memory, and without torch."""
    requests = []
    for number, (text, options, _) in enumerate(BOMBS.values()):
        path = tmp_path / f"bomb{number}.toml"
        path.write_text(text or (EXPERIMENTS / "finetune.toml").read_text())
        requests.append([str(path), f"--results={tmp_path / 'results'}", *options])
    done = subprocess.run(
        [sys.executable, "-c", LIMITED], input=json.dumps(requests), capture_output=True, text=True, check=True
    )
    answers, heavy = done.stdout.splitlines()
    for name, (_, _, said), (code, message, error) in zip(BOMBS, BOMBS.values(), json.loads(answers), strict=True):
        assert code == 2, (name, error)
        assert said in message, name
    assert heavy == "[]"


# ---- nothing is run


@pytest.mark.parametrize("key", ["prior", "learner"])
@pytest.mark.parametrize(
    "name",
    [
        "this:s",
        "this.s",
        "rrm.priors.proxy:zero",
        "os:system",
        "__import__('this')",
        "this.py",
        "own:near",
        "own.pyc:f",
    ],
)
def test_manifests_name_no_code_but_a_function_in_a_file(workshop: Workshop, key: str, name: str) -> None:
    """Modules, expressions and other files are unknown names, never looked up; a file of the user's is only read."""
    assert f'unknown {key} "{name}"' in str(workshop.ask_file(f'{MINE}{key} = "{name}"'.encode()))
    assert "this" not in sys.modules
    assert workshop.ask_file(f'{MINE}prior = "own.py:near"'.encode()) is None
    assert not Path("ran").exists()
