"""Who may import whom, that the command line answers at once, and that every table entry stands for something."""

from __future__ import annotations

import ast
import json
import os
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from graphlib import TopologicalSorter
from pathlib import Path

import pytest

from rrm.config import TeacherConfig
from rrm.envs import TASKS
from rrm.priors import PRIORS
from rrm.registry import lookup
from rrm.rewards import LEARNERS
from rrm.teachers import TEACHERS
from rrmctl.planning import profiles
from tests.robot import robot

ROOT = Path(__file__).parents[1]

#: Modules of rrmctl that know the library; everything else reads what they leave behind.
KNOW_RRM = {
    *(
        "planning.methods",
        "planning.settings",
        "planning.grid",
        "planning.prerequisites",
    ),  # names and settings become configurations
    "planning.cost",  # agents differ in what an update of theirs costs
    *("running.experts", "running.pictures"),  # demonstrations that people ask for, and what an agent sees
    "running.deployments",  # and episodes at a workplace
    "running.film",  # policies play to be seen
    *("running.config_file", "running.worker"),  # a configuration's way into the process that trains
    *("labelling.renderer", "labelling.practice"),  # episodes are lived again to be seen, and made to be practised on
    "cli.deploy",  # cameras are calibrated by the library
    "cli.prior",  # candidates of a language model become priors of the library
}
#: Light, and the one place for what they say: the version, tasks and how they are scored, errors, files, the machine.
FACTS = {
    *("rrm", "rrm.envs.tasks", "rrm.errors", "rrm.files", "rrm.parquet", "rrm.environ", "rrm.toml"),
    *("rrm.hardware", "rrm.devices", "rrm.precision", "rrm.tuning", "rrm.rendering"),
    *("rrm.teachers.labels", "rrm.teachers.published"),  # what people are asked, and what they answered
}

#: Floors of either package: a module imports from floors below its own, or from its own room (the first part of its
#: name); what no floor names is the ground that all stand on. Wherever the import stands: at the top of the file, in a
#: function, or for types alone.
FLOORS = {
    "rrm": {
        "runs": 7,
        "training": 6,
        "priors": 5, "sources": 5,
        "imitation": 4, "teachers": 4, "queries": 4,
        "agents": 3, "rewards": 3,
        "buffers": 2, "nets": 2, "robot": 2,
        "envs": 1, "losses": 1,
    },
    "rrmctl": {
        "__main__": 6,
        "cli": 5,
        "export": 4,
        "reports": 3, "running": 3, "doctor": 3, "labelling": 3,
        "planning": 2,
        "store": 1, "stats": 1,
    },
}  # fmt: skip
#: Where a name or a text becomes something that runs, and how: names in our own tables, `file.py:function` of the
#: user's, what is rebuilt from a language model's words, and our own folders of commands.
DYNAMIC = {
    "rrm": {"import_module"},
    "rrm.envs.tasks": {"import_module"},
    "rrm.registry": {"import_module", "compile", "exec_module"},
    "rrm.priors.language.translate": {"compile", "exec"},
    "rrmctl.reports.plugins": {"import_module"},
}
#: Readers of files that can hold code, and what runs text.
RUNS = {
    "eval",
    "exec",
    "compile",
    "__import__",
    "import_module",
    "exec_module",
    "load_module",
    "run_path",
    "run_module",
}
UNSAFE = {"pickle", "marshal", "shelve", "dill", "cloudpickle", "joblib", "yaml", "runpy", "code", "imp"}
HEAVY = {
    *("torch", "numpy", "pandas", "pyarrow", "pydantic", "matplotlib", "scipy", "jinja2"),
    *("mujoco", "metaworld", "dm_control", "pybullet", "starlette", "uvicorn"),
}


def modules() -> dict[str, Path]:
    """Every module of both packages, by dotted name."""
    found = {}
    for path in (path for package in ("rrm", "rrmctl") for path in (ROOT / package).rglob("*.py")):
        parts = path.relative_to(ROOT).with_suffix("").parts
        found[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = path
    return found


MODULES = modules()


def _for_types_only(tree: ast.Module) -> set[ast.AST]:
    """What no run of the module comes to."""
    blocks = (node for node in ast.walk(tree) if isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING")
    return {inner for block in blocks for statement in block.body for inner in ast.walk(statement)}


def imports(name: str, *, types: bool = False) -> set[str]:
    """The modules that `name` imports, wherever it does; ours by the most precise name there is.

    Args:
        types: also what it imports for type checkers alone.
    """
    found = set()
    tree = ast.parse(MODULES[name].read_text())
    for node in set(ast.walk(tree)) - (set() if types else _for_types_only(tree)):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{name}: relative import"
            inner = {f"{node.module}.{alias.name}" for alias in node.names}
            ours = inner & set(MODULES)
            found |= ours | ({node.module} if len(ours) < len(inner) and node.module else set())
    return found


def ours(name: str, *, types: bool = False) -> set[str]:
    return {module for module in imports(name, types=types) if module.split(".")[0] in ("rrm", "rrmctl")}


def test_the_library_does_not_know_the_program() -> None:
    """`rrm` never imports `rrmctl`, not even inside a function."""
    assert [m for m in MODULES if m.startswith("rrm.") and any(i.startswith("rrmctl") for i in imports(m))] == []


def test_few_modules_of_the_program_know_the_library() -> None:
    """Planning and the worker import `rrm`; pool, scheduler, store and reports do not."""
    knowing = {
        module.removeprefix("rrmctl.")
        for module in MODULES
        if module.startswith("rrmctl") and any(i.split(".")[0] == "rrm" for i in ours(module) - FACTS)
    }
    assert knowing == KNOW_RRM


@pytest.mark.slow
def test_python_is_started_in_one_way() -> None:
    """Whoever starts a process gives it the environment of `rrm.environ`: no file that lies around is a module."""
    starting = {name for name in MODULES if "subprocess" in imports(name)} - {"rrmctl.running.supervisor"}
    assert starting - {"rrm.environ"} <= {name for name in MODULES if "rrm.environ" in imports(name)}


def test_statistics_stand_alone() -> None:
    """`rrmctl.stats` imports nothing of ours but itself."""
    for module in (m for m in MODULES if m.startswith("rrmctl.stats")):
        assert {i for i in ours(module) if not i.startswith("rrmctl.stats")} == set(), module


def test_no_circles() -> None:
    """Imports form no circle, those inside functions included: they would hide it from Python, not mend it."""
    TopologicalSorter({module: ours(module, types=True) - {module} for module in MODULES}).prepare()


@pytest.mark.parametrize("package", sorted(FLOORS))
def test_floors(package: str) -> None:
    """Rooms import from floors below, and no tie goes up by way of a function."""

    def room(module: str) -> str:
        return ".".join(module.split(".")[1:2])

    floors = FLOORS[package]
    assert set(floors) <= {room(module) for module in MODULES if module.split(".")[0] == package}
    wrong = [
        f"{module} imports {other}"
        for module in MODULES
        if module.split(".")[0] == package and module != package  # its front door opens into every room
        for other in ours(module, types=True)
        if other.split(".")[0] == package and room(other) != room(module)
        if floors.get(room(other), 0) >= max(floors.get(room(module), 0), 1)
    ]
    assert wrong == []


@pytest.mark.parametrize("room", ["agents", "rewards", "nets"])
def test_learning_knows_no_environment(room: str) -> None:
    """Agents and reward learners receive batches; they import no environment and no buffer."""
    for module in (m for m in MODULES if m.startswith(f"rrm.{room}")):
        assert not {i for i in ours(module) if i.startswith(("rrm.envs", "rrm.buffers"))}, module


def test_environments_know_no_torch() -> None:
    """A simulator, or an arm, can be used without the learning library."""
    rooms = ("rrm.envs", "rrm.robot")
    assert [m for m in MODULES if m.startswith(rooms) and "torch" in {i.split(".")[0] for i in imports(m)}] == []


@pytest.mark.parametrize(
    "code",
    [
        "from typer.testing import CliRunner; from rrmctl.cli.app import app; CliRunner().invoke(app, ['--help'])",
        "import rrmctl.cli.app",
    ],
)
def test_help_answers_at_once(code: str) -> None:
    """Nothing heavy is loaded by the command line itself."""
    report = "; import json, sys; print(json.dumps(sorted({m.split('.')[0] for m in sys.modules})))"
    done = subprocess.run([sys.executable, "-c", code + report], capture_output=True, text=True, check=True)
    assert set(json.loads(done.stdout.splitlines()[-1])) & HEAVY == set()


def _called(name: str) -> Iterator[tuple[ast.Call, str, str]]:
    """Every call in a module: the call, what it is called on by name, and the function's own name."""
    for node in ast.walk(ast.parse(MODULES[name].read_text())):
        match node:
            case ast.Call(func=ast.Name(id=function)):
                yield node, "", function
            case ast.Call(func=ast.Attribute(value=value, attr=function)):
                yield node, ast.unparse(value), function


@pytest.mark.slow
def test_nothing_that_is_read_can_run() -> None:
    """No file's content becomes code but in the places that exist for it, and no format that can hold code is read."""
    running = {
        module: found
        for module in MODULES
        if (found := {function for _, owner, function in _called(module) if function in RUNS and owner != "re"})
    }
    assert running == DYNAMIC
    assert [module for module in MODULES if {i.split(".")[0] for i in imports(module)} & UNSAFE] == []


def test_arrays_are_read_without_pickles() -> None:
    """`np.load` says so each time, and `torch.load`, which cannot promise it of itself, is not called."""
    for module in MODULES:
        for call, owner, function in _called(module):
            if function == "load" and owner in ("np", "numpy", "torch"):
                said = {keyword.arg: ast.unparse(keyword.value) for keyword in call.keywords}
                assert (owner, said.get("allow_pickle")) == ("np", "False"), module
            assert function not in ("read_pickle", "unsafe_load"), module


def test_labels_are_served_without_torch() -> None:
    """Nor with a simulator: the process that draws has them."""
    code = (
        "import rrmctl.labelling.serving, sys; print({'torch', 'mujoco', 'metaworld', 'gymnasium'} & set(sys.modules))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == "set()\n"


def test_planning_needs_no_torch(tmp_path: Path) -> None:
    """Ten thousand jobs are planned without the learning library or a simulator, and nothing is measured."""
    code = (
        "from pathlib import Path; from rrmctl.planning.manifest import load;"
        "from rrmctl.planning.plan import make_plan;"
        "make_plan(load(Path('experiments/main-results.toml'))); import sys;"
        "print([m for m in ('torch', 'mujoco', 'metaworld', 'pandas') if m in sys.modules])"
    )
    own = os.environ | {"XDG_CACHE_HOME": str(tmp_path)}
    done = subprocess.run([sys.executable, "-c", code], env=own, capture_output=True, text=True, check=True, cwd=ROOT)
    assert done.stdout == "[]\n"
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("name", sorted(PRIORS))
def test_every_prior_loads(name: str) -> None:
    """Each name in the table of priors stands for something that can be called."""
    assert callable(lookup(PRIORS, "prior", name))


@pytest.mark.parametrize("name", sorted(LEARNERS))
def test_every_learner_loads(name: str) -> None:
    """Each name in the table of learners stands for a class."""
    assert isinstance(lookup(LEARNERS, "learner", name), type)


@pytest.mark.parametrize("name", sorted(TEACHERS))
def test_every_teacher_is_complete(name: str) -> None:
    """Each preset is a valid configuration."""
    TeacherConfig.model_validate(TEACHERS[name])


@pytest.mark.sim
@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=robot if TASKS[name].extra else ()) for name in sorted(TASKS)]
)
def test_every_task_loads(name: str) -> None:
    """Each task's class can be imported, and its features lie inside the observation."""
    task = TASKS[name]
    assert isinstance(lookup({name: task.entry_point}, "task", name), type)
    assert all(0 <= part.start < part.stop <= task.spaces.obs for part in task.features.values())


def test_profiles_speak_of_what_exists() -> None:
    """Every suite and task that a profile sets something for is one."""
    suites = {task.suite for task in TASKS.values()}
    for name, table in tomllib.loads(profiles.PATH.read_text()).items():
        assert set(table.get("suite", {})) <= suites, name
        assert set(table.get("task", {})) <= set(TASKS), name


def test_arrow_starts_no_threads() -> None:
    """A thread of Arrow's that is still at work when the process ends aborts it: what reads or converts says so."""
    calls = {
        f"{name}: {ast.unparse(node)}"
        for name, path in MODULES.items()
        for node in ast.walk(ast.parse(path.read_text()))
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute) and "pyarrow" in path.read_text()
        and (node.func.attr in {"to_pandas", "read_table", "read"} and "file.read()" not in ast.unparse(node))
        and "use_threads" not in {keyword.arg for keyword in node.keywords}
    }  # fmt: skip
    assert calls == set()


@pytest.mark.slow
def test_one_idea_has_one_home() -> None:
    """Near names are found, consoles made, and words compared with that of nothing asked, in one module each."""
    trees = [(module, node) for module, path in MODULES.items() for node in ast.walk(ast.parse(path.read_text()))]
    comparing = {
        module
        for module, node in trees
        if isinstance(node, ast.Compare)
        for side in (node.left, *node.comparators)
        if "-" in (getattr(part, "value", "") for part in (side, *getattr(side, "elts", ())))
    }
    making = {
        module
        for module, node in trees
        if isinstance(node, ast.FunctionDef) and node.returns and ast.unparse(node.returns) == "Console"
    }
    assert {module for module in MODULES if "difflib" in imports(module)} == {"rrm.errors"}
    assert making == {"rrmctl.terminal"}
    assert comparing == set()  # `rrmctl.labels` has a name for it
