"""What the documents show is what the program does."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
PAGE = (ROOT / "docs" / "extending.md").read_text()
SMOKE = ["--profile", "smoke", "--seeds", "1", "--workers", "1", "--set", "steps=450"]


def blocks(language):
    return re.findall(rf"```{language}\n(.*?)```", PAGE, re.DOTALL)


@pytest.fixture
def workshop(tmp_path):
    """A folder with the page's two files and a manifest with its two tables."""
    for code in blocks("python"):
        name = re.match(r"# (\w+\.py)\n", code).group(1)
        (tmp_path / name).write_text(code)
        assert len(code.splitlines()) < 40
    (tmp_path / "mine.toml").write_text(
        'title = "Mine"\nreproduces = ["nothing"]\nrule = "none"\nseeds = 1\n\n'
        '[grid]\ntasks = ["toy-car"]\nmethods = ["rrm-closer", "smooth"]\n\n' + "\n".join(blocks("toml"))
    )
    return tmp_path


def rrmctl(folder, *arguments):
    environment = os.environ | {"COLUMNS": "200"}
    command = [sys.executable, "-c", "from rrmctl.cli.app import main; main()", *arguments]
    return subprocess.run(command, cwd=folder, capture_output=True, text=True, env=environment, check=False)


@pytest.mark.slow
def test_ones_own_prior_and_learner_run_in_a_sweep(workshop):
    """The documented prior and learner, in files of the user's, run without touching the project's."""
    done = rrmctl(workshop, "run", "mine.toml", *SMOKE)
    assert done.returncode == 0, done.stderr
    table = rrmctl(workshop, "report", "iqm", "mine", "--format", "csv").stdout
    assert "rrm-closer" in table
    assert "smooth" in table


@pytest.mark.slow
def test_ones_own_prior_joins_an_experiment(workshop):
    """`--prior file.py:function` adds the method rrm-function to a manifest of ours."""
    done = rrmctl(
        workshop, "run", "toy-car", "--experiments", str(ROOT / "experiments"), "--prior", "my_priors.py:closer",
        "--methods", "oracle", *SMOKE,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert "rrm-closer" in rrmctl(workshop, "report", "iqm", "toy-car", "--format", "csv").stdout
