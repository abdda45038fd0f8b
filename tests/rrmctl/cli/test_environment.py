"""What lies in the working directory, and what a shell or a notebook has set, changes no plan, table, figure or run."""

import json
import os
import subprocess
import sys
from pathlib import Path

import matplotlib as mpl
import pytest

from rrm.environ import environment
from rrmctl import doctor
from rrmctl.reports.figure_layout import encode
from rrmctl.reports.figures.box import box_plot
from rrmctl.reports.figures.curves import learning_curves
from rrmctl.running.local import worker_environment
from tests.rrmctl.reports.frames import Sweep

EXPERIMENTS = str(Path(__file__).parents[3] / "experiments")
RC = "text.usetex: True\naxes.facecolor: red\nfont.size: 20\nlegend.loc: center\nlines.dash_capstyle: round\n"
#: One bad value each would do.
HOSTILE = {
    "MPLBACKEND": "module://matplotlib_inline.backend_inline",
    "MATPLOTLIBRC": "elsewhere",
    "MUJOCO_GL": "nonsense",
    "PYOPENGL_PLATFORM": "nonsense",
    "PYTHONIOENCODING": "ascii",
    "PYTHONWARNINGS": "error",
    "OMP_NUM_THREADS": "64",
    "COLUMNS": "0",
    "LINES": "1",
    "TERMINAL_WIDTH": "wide",
    "NO_COLOR": "1",
    "LC_ALL": "C",
    "TZ": "Asia/Tokyo",
}
FLAGS = {"PYTHONOPTIMIZE": "2", "PYTHONWARNINGS": "error"}
PRIOR = "def mine(step):\n    return float(step.obs[0])\n"


def rrmctl(folder: Path, *words: str, **variables: str) -> subprocess.CompletedProcess[str]:
    """The installed program, started in this folder as from a shell."""
    command = [str(Path(sys.executable).with_name("rrmctl")), *words]
    done = subprocess.run(
        command, cwd=folder, env=os.environ | variables, capture_output=True, encoding="utf-8", check=False
    )
    assert done.returncode == 0, done.stderr
    return done


@pytest.fixture
def litter(tmp_path: Path) -> Path:
    """A folder with files that are called like modules and take note of being run, and with settings of matplotlib."""
    folder = tmp_path / "litter"
    folder.mkdir()
    for name in ("types", "numpy", "torch", "json", "rrm", "rrmctl", "matplotlib", "gymnasium"):
        (folder / f"{name}.py").write_text(f"open({str(folder / 'ran')!r}, 'a').write({name!r})\n")
    (folder / "elsewhere").write_text(RC)
    (folder / "matplotlibrc").write_bytes(RC.encode() + b"# Gr\xfc\xdfe\n")
    (folder / "my_priors.py").write_text(PRIOR)
    return folder


def test_files_that_lie_around_are_no_modules(litter: Path):
    """The speed of the machine is measured beside a numpy.py; a prior in a file named by its path is found as ever."""
    told = rrmctl(litter, "plan", "toy-car", "--experiments", EXPERIMENTS, "--prior", "my_priors.py:mine").stdout
    assert "rrm-mine" in told
    assert not (litter / "ran").exists()


def test_the_doctor_tries_the_modules_that_are_installed(litter: Path, monkeypatch: pytest.MonkeyPatch):
    """What it tries in a process of its own is not what lies in the working directory."""
    monkeypatch.chdir(litter)
    assert doctor._try("import json, types, numpy; numpy.float64, json.dumps") is None
    assert not (litter / "ran").exists()


@pytest.mark.slow
def test_a_table_is_the_same_in_any_environment(litter: Path):
    """Neither width nor what Python is told changes a letter of it; JSON stays JSON, in few signs as well."""
    Sweep().write(litter / "results")
    words = ("report", "iqm", "main-results", "--replicates", "100")
    wanted = rrmctl(litter, *words, COLUMNS="200").stdout
    assert wanted == rrmctl(litter, *words, **HOSTILE | {"PYTHONIOENCODING": "utf-8"}).stdout
    (report,) = json.loads(rrmctl(litter, *words, "--format", "json", **HOSTILE).stdout)["reports"]
    assert report["title"] in wanted.splitlines()[0]


@pytest.mark.parametrize("words", [("report", "iqm", "--replicates", "100"), ("status",)])
def test_a_closed_output_is_no_error(litter: Path, words: tuple[str, ...]):
    """`rrmctl ... >&-` does what it does, and says nothing."""
    Sweep().write(litter / "results")
    program = str(Path(sys.executable).with_name("rrmctl"))
    done = subprocess.run(["sh", "-c", '"$0" "$@" >&-', program, *words], cwd=litter, capture_output=True, check=False)
    assert (done.returncode, done.stderr) == (0, b"")


def test_a_table_that_nobody_looks_at_is_wide(litter: Path):
    """Where colours are forced, as on build servers, names and numbers are not folded either."""
    curves = {f"rrm-a-prior-with-a-rather-long-name-{n}": [[0.0, 0.5, 1.0]] for n in range(2)}
    Sweep(curves=curves).write(litter / "results")
    told = rrmctl(litter, "report", "iqm", "main-results", FORCE_COLOR="1", COLUMNS="40").stdout
    assert all(name in told for name in curves)


@pytest.mark.slow
def test_a_figure_is_the_same_in_any_environment(litter: Path):
    """`rrmctl plot` from a notebook, or beside a matplotlibrc, draws what it draws elsewhere."""
    results = litter / "results"
    Sweep().write(results)
    words = ("--figure", "curves", "--format", "svg", "--results", str(results), "-o")
    clean = litter / "clean"
    clean.mkdir()
    rrmctl(clean, "plot", "main-results", *words, str(clean))
    rrmctl(litter, "plot", "main-results", *words, str(litter), **HOSTILE)
    name = "main-results-laptop.svg"
    assert (litter / name).read_bytes() == (clean / name).read_bytes()


@pytest.mark.parametrize("figure", [learning_curves, box_plot])
def test_a_notebook_s_settings_are_not_a_figure_s(figure):
    """Settings of matplotlib that hold around it, however strange, leave no trace in the file, legend included."""
    wanted = encode(figure(*Sweep().frames()), "svg")
    strange = {"text.usetex": True, "axes.facecolor": "red", "font.size": 20, "savefig.pad_inches": 3,
               "lines.dash_capstyle": "round", "lines.scale_dashes": False, "figure.facecolor": "black"}  # fmt: skip
    with mpl.rc_context(strange):
        assert encode(figure(*Sweep().frames()), "svg") == wanted


def test_what_processes_of_ours_do_not_heed():
    """Neither renderer nor backend nor flags of Python come from the user's shell; the rest of it does."""
    told = worker_environment(2, HOSTILE | FLAGS | {"PATH": "/bin", "PYTHONPATH": "/mine"})
    assert told["MUJOCO_GL"] == "disabled"
    assert told["OMP_NUM_THREADS"] == "2"
    assert (told["PATH"], told["PYTHONPATH"]) == ("/bin", "/mine")
    assert not {"MPLBACKEND", "PYOPENGL_PLATFORM", "PYTHONOPTIMIZE", "PYTHONWARNINGS"} & set(told)


def test_flags_of_python_do_not_reach_a_child():
    """Asserts of the user's prior hold, and warnings stay warnings, under any PYTHONOPTIMIZE and PYTHONWARNINGS."""
    code = "import sys, warnings; warnings.warn('x'); print(sys.flags.optimize, sys.flags.safe_path)"
    done = subprocess.run(
        [sys.executable, "-c", code], env=environment(os.environ | FLAGS), capture_output=True, check=True
    )
    assert done.stdout.split() == [b"0", b"True"]


@pytest.mark.slow
def test_a_run_is_the_same_in_any_environment(litter: Path):
    """A sweep on a simulator, with a prior in a file of the user's, runs through whatever the shell has set."""
    words = ("--tasks", "button-press", "--methods", "oracle", "--prior", "my_priors.py:mine", "--seeds", "1")
    rrmctl(
        litter, "run", "main-results", *words, "--profile", "smoke", "--experiments", EXPERIMENTS, "--workers", "1",
        **HOSTILE,
    )  # fmt: skip
    assert "rrm-mine" in rrmctl(litter, "report", "iqm", "main-results", "--format", "csv").stdout
    assert not (litter / "ran").exists()
