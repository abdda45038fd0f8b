"""`prior language`: from the prompt to a run on a frozen prior."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest
from typer.testing import CliRunner, Result

from rrm.priors.language.record import read_record, sha256
from rrmctl.cli.app import app
from rrmctl.store import load

EXPERIMENTS = Path(__file__).parents[3] / "experiments"
WHO = ["--model", "M 1", "--date", "2026-01-02"]

NEAR = "import numpy as np\n\ndef reward(step):\n    return -np.linalg.norm(step.object - step.goal)\n"
NEARER = "import math\n\ndef reward(step):\n    return math.exp(-math.dist(step.object, step.goal))\n"
BAD = "import os\n\ndef reward(step):\n    return 1.0\n"


def call(*arguments: str | Path) -> Result:
    return CliRunner().invoke(app, ["prior", "language", *map(str, arguments)])


def answers(folder: Path, **texts: str) -> list[Path]:
    paths = []
    for name, text in texts.items():
        paths.append(folder / f"{name}.py")
        paths[-1].write_text(text)
    return paths


def test_prompt() -> None:
    """The prompt is all that is printed; the skeleton is an option."""
    plain, filled = call("prompt", "toy-car"), call("prompt", "toy-car", "--skeleton")
    assert plain.exit_code == filled.exit_code == 0
    assert plain.stdout.startswith("Here is a two-dimensional task: Toy Car.")
    assert plain.stdout.endswith("enable the agent to achieve the goal.\n")
    assert filled.stdout.startswith(plain.stdout.rstrip("\n"))
    assert "def reward(step):" in filled.stdout


def test_unknown_task() -> None:
    """The nearest one is suggested; the exit code is 2."""
    result = call("prompt", "toy-cat")
    assert result.exit_code == 2
    assert 'did you mean "toy-car"' in result.stderr


def test_add(tmp_path: Path) -> None:
    """Every candidate's verdict is shown, and the frozen file with the way to use it."""
    prompt = tmp_path / "prompt.txt"
    prompt.write_text("Please.")
    files = answers(tmp_path, bad=BAD, near=NEAR, nearer=NEARER)
    result = call("add", "toy-car", *files, *WHO, "--prompt", prompt, "--into", tmp_path / "mine")
    assert result.exit_code == 0, result.stderr
    shown = result.stdout.splitlines()
    assert shown[0] == "  bad.py, line 1: `import os` (Import): only numpy and math can be imported"
    assert shown[1].startswith("* near.py: 0.9")
    assert shown[2].startswith("  nearer.py: 0.9")
    assert "toy-car.language.py:reward" in shown[-1]
    record = read_record(tmp_path / "mine" / "toy-car.language.py")
    assert (record.model, record.date, record.prompt_sha256) == ("M 1", "2026-01-02", sha256(b"Please."))


def test_add_beside_the_experiments(tmp_path: Path) -> None:
    """Without --into it lands in `priors` beside the experiments; without --prompt the skeleton's is recorded."""
    result = call("add", "toy-car", *answers(tmp_path, near=NEAR), *WHO, "--experiments", tmp_path / "experiments")
    assert result.exit_code == 0, result.stderr
    assert "* near.py: the only one left" in result.stdout
    record = read_record(tmp_path / "priors" / "toy-car.language.py")
    assert record.prompt_sha256 == sha256(call("prompt", "toy-car", "--skeleton").stdout.encode())


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--date", "yesterday", "--model", "M"], "does not match"),
        (["--date", "2026-01-02"], "--model"),
        ([*WHO, "--prompt", "nowhere.txt"], "cannot read nowhere.txt"),
    ],
)
def test_bad_options(tmp_path: Path, options: list[str], said: str) -> None:
    """Exit code 2, and nothing is written."""
    result = call("add", "toy-car", *answers(tmp_path, near=NEAR), *options, "--into", tmp_path / "mine")
    assert result.exit_code == 2
    assert said in result.stderr
    assert not (tmp_path / "mine").exists()


def test_nothing_usable(tmp_path: Path) -> None:
    """Exit code 2 with every reason."""
    result = call("add", "toy-car", *answers(tmp_path, bad=BAD), *WHO, "--into", tmp_path / "mine")
    assert result.exit_code == 2
    assert "no candidate can be used" in result.stderr
    assert "bad.py, line 1" in result.stderr


def manifest(folder: Path, prior: str, tasks: str = '"toy-car"') -> Path:
    path = folder / "mine.toml"
    path.write_text(
        f'title = "Mine"\nreproduces = ["nothing"]\nrule = "none"\nseeds = 1\n\n[grid]\ntasks = [{tasks}]\n'
        f'methods = ["sac-language", "rrm-language", "rrm-mine"]\n\n[method.rrm-mine]\nprior = "{prior}"\n'
    )
    return path


@pytest.mark.slow
def test_from_answers_to_a_run(tmp_path: Path) -> None:
    """A frozen prior in a manifest, by the task's name, and the shipped one beside it, train to the end."""
    assert call("add", "toy-car", *answers(tmp_path, near=NEAR, nearer=NEARER), *WHO, "--into", tmp_path).exit_code == 0
    path = manifest(tmp_path, "{task}.language.py:reward")
    run = [sys.executable, "-c", "from rrmctl.cli.app import main; main()", "run", str(path)]
    done = subprocess.run(
        [*run, "--profile", "smoke", "--workers", "1", "--results", str(tmp_path)],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    curves = load(tmp_path)
    assert set(curves.method) == {"sac-language", "rrm-language", "rrm-mine"}
    last = curves[curves.step == curves.step.max()].set_index("method")
    assert last.prior_mean.notna().all()
    assert last.loc["rrm-mine", "prior_mean"] != last.loc["rrm-language", "prior_mean"]


@pytest.mark.parametrize(
    ("prior", "tasks", "said"),
    [
        ("{task}.language.py:reward", '"toy-car", "door-open"', "door-open, rrm-mine: .*cannot read .*door-open"),
        ("toy-car.language.py:reward", '"door-open"', "was written for toy-car, not for door-open"),
        ("broken.language.py:reward", '"toy-car"', r"broken\.language\.py, line 1: `import os`"),
    ],
)  # fmt: skip
def test_planning_refuses(tmp_path: Path, prior: str, tasks: str, said: str) -> None:
    """A prior that is not there for a task, is another's, or holds forbidden code: exit code 2 before any run."""
    assert call("add", "toy-car", *answers(tmp_path, near=NEAR), *WHO, "--into", tmp_path).exit_code == 0
    (tmp_path / "broken.language.py").write_text(BAD)
    result = CliRunner().invoke(app, ["plan", str(manifest(tmp_path, prior, tasks))])
    assert result.exit_code == 2
    assert re.search(said, result.stderr.replace("\n", " "))
