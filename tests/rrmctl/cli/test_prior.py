"""`prior language`: from the prompt to a run on a frozen prior."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from typer.testing import CliRunner, Result

from rrmctl.cli.app import app
from rrmctl.store import load
from tests.rrm.priors.language.steps import recorded, sha256

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
    record = recorded(tmp_path / "mine" / "toy-car.language.py")
    assert (record.model, record.date, record.prompt_sha256) == ("M 1", "2026-01-02", sha256(b"Please."))


def test_add_beside_the_experiments(tmp_path: Path) -> None:
    """Without --into it lands in `priors` beside the experiments; without --prompt the skeleton's is recorded."""
    result = call("add", "toy-car", *answers(tmp_path, near=NEAR), *WHO, "--experiments", tmp_path / "experiments")
    assert result.exit_code == 0, result.stderr
    assert "* near.py: the only one left" in result.stdout
    record = recorded(tmp_path / "priors" / "toy-car.language.py")
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


#: Candidates that once hung `add` or training, ate memory or ended with a traceback, and what is said of them.
HOSTILE = {
    "loops": (
        "def reward(step):\n    if step.object[1] > 2.1:\n"
        + "".join(f"{'    ' * (n + 2)}for i{n} in range(100):\n" for n in range(10))
        + "    " * 12 + "pass\n    return step.object[0]\n",
        "would take more than 15,000 operations",
    ),
    "wide": (
        "def reward(step):\n    x = step.obs\n    for i in range(40):\n"
        "        x = x == (" + "x, " * 32 + ")\n    return 0.0\n",
        "at step 0 raised ValueError: an array of shape",
    ),
    "hex": ("def reward(step):\n    return 0x" + "f" * 3600 + "\n", "numbers are 1,000,000,000 at the most"),
}  # fmt: skip


def test_a_good_candidate_among_hostile_ones(tmp_path: Path) -> None:
    """Each is refused for its own reason, and the good one is kept."""
    files = answers(tmp_path, near=NEAR, **{name: text for name, (text, _) in HOSTILE.items()})
    result = call("add", "toy-car", *files, *WHO, "--into", tmp_path / "mine")
    assert result.exit_code == 0, result.stderr
    assert "* near.py: the only one left" in result.stdout
    for name, (_, said) in HOSTILE.items():
        assert re.search(rf"{name}\.py.*{said}", result.stdout)


@pytest.mark.slow
def test_what_is_no_file_of_code(tmp_path: Path) -> None:
    """A pipe, a device and a huge file: none is read without end, be it a candidate, the prompt or a frozen prior."""
    os.mkfifo(tmp_path / "pipe.language.py")
    with (tmp_path / "huge.language.py").open("wb") as file:
        file.truncate(3 << 30)
    (tmp_path / "zero.language.py").symlink_to("/dev/zero")
    (near,) = answers(tmp_path, near=NEAR)
    for name in ("pipe", "huge", "zero"):
        odd = tmp_path / f"{name}.language.py"
        for result in (
            call("add", "toy-car", near, odd, *WHO, "--into", tmp_path / "mine"),
            call("add", "toy-car", near, *WHO, "--prompt", odd, "--into", tmp_path / "mine"),
            CliRunner().invoke(app, ["plan", str(manifest(tmp_path, f"{odd}:reward"))]),
            CliRunner().invoke(app, ["plan", "toy-car", "--prior", f"{odd}:reward"]),
        ):
            assert result.exit_code == 2
            assert re.search(r"cannot\s+read", result.stderr)
            assert re.search(r"not\s+a\s+regular\s+file|longer\s+than", result.stderr)


def test_a_language_models_file_is_no_learner(tmp_path: Path) -> None:
    """Planning refuses it, and nothing runs it."""
    (tmp_path / "pwn.language.py").write_text(f"open({str(tmp_path / 'ran')!r}, 'w')\nclass Learner: pass\n")
    path = manifest(tmp_path, "zero")
    path.write_text(
        path.read_text().replace("[method.rrm-mine]", '[method.rrm-mine]\nlearner = "pwn.language.py:Learner"')
    )
    result = CliRunner().invoke(app, ["run", str(path), "--results", str(tmp_path / "results")])
    assert result.exit_code == 2
    assert "never run as a learner" in " ".join(result.stderr.split())
    assert not (tmp_path / "ran").exists()


def test_a_language_prior_is_one_wherever_its_file_lies(tmp_path: Path) -> None:
    """A link with the name of a language prior leads to code that is rebuilt, not run."""
    (tmp_path / "elsewhere.py").write_text(f"open({str(tmp_path / 'ran')!r}, 'w')\ndef reward(step): return 0.0\n")
    (tmp_path / "mine.language.py").symlink_to(tmp_path / "elsewhere.py")
    result = CliRunner().invoke(app, ["plan", str(manifest(tmp_path, "mine.language.py:reward"))])
    assert result.exit_code == 2
    assert "mine.language.py, line 1: `open" in " ".join(result.stderr.split())
    assert not (tmp_path / "ran").exists()


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
