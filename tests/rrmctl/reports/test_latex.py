"""What goes into a paper compiles, with a real TeX."""

import os
import re
import shutil
import subprocess

import pytest

from rrmctl.reports.render import LATEX_PACKAGES, to_text
from rrmctl.reports.statistics import Statistics
from rrmctl.reports.tables import claims, final, iqm, less_feedback, noisy_teacher, sim_to_real
from tests.rrmctl.reports.frames import Sweep
from tests.rrmctl.reports.test_render import RAGGED, SMOKE, made
from tests.rrmctl.reports.test_tables import deployed, little, noisy

QUICK = Statistics(replicates=100)
PAPERS = Statistics(replicates=100, plus_minus=True)


@pytest.fixture
def compiled(tmp_path):
    """A function from a table's text to the log of TeX, which fails where TeX does."""
    if shutil.which("pdflatex") is None:
        told = "no pdflatex on this machine: `make tex` installs one"
        (pytest.fail if "tex" in os.environ.get("RRMCTL_TESTS_NEED", "") else pytest.skip)(told)

    def run(text):
        packages = "".join(rf"\usepackage{{{name}}}" + "\n" for name in LATEX_PACKAGES)
        document = rf"\documentclass{{article}}{packages}\begin{{document}}" + "\n" + text + "\n" + r"\end{document}"
        (tmp_path / "table.tex").write_text(document, encoding="utf-8")
        command = ["pdflatex", "-interaction=nonstopmode", "-halt-on-error", "-file-line-error", "table.tex"]
        for _ in range(2):  # a long table settles its columns in the second run
            ran = subprocess.run(command, cwd=tmp_path, capture_output=True, check=False)
            log = ran.stdout.decode(errors="replace")
            assert ran.returncode == 0, log
        assert (tmp_path / "table.pdf").read_bytes()[:4] == b"%PDF"
        return log.replace("\n", "")

    return run


def wide(log):
    """By how many points lines stick out of the text."""
    return [float(points) for points in re.findall(r"Overfull \\hbox \(([\d.]+)pt", log)]


TABLES = {
    "iqm": lambda: made(RAGGED, SMOKE),
    "signs": lambda: made(Sweep(overrides={"a_b": "50%&#~^\\{}$<>"})),
    "final": lambda: final.make([noisy(), little()], QUICK),
    "noisy-teacher": lambda: noisy_teacher.make([noisy(profile="laptop")], QUICK),
    "noisy-teacher, ±": lambda: noisy_teacher.make([noisy()], PAPERS),
    "less-feedback": lambda: less_feedback.make([little(methods=("pebble", "rrm-proxy", "rrm-a", "rrm-b"))], QUICK),
    "sim-to-real": lambda: sim_to_real.make([deployed()], QUICK),
    "claims": lambda: claims.make([noisy(), little()], QUICK),
}


@pytest.mark.parametrize("name", TABLES)
def test_every_table_compiles_and_fits(compiled, name):
    """Each table is typeset without an error, and none sticks out of the page."""
    log = compiled(to_text(TABLES[name](), "latex"))
    assert max(wide(log), default=0.0) < 15.0


def test_a_broken_table_would_be_found(compiled):
    """The check is one: a cell too many stops TeX."""
    text = to_text(iqm.make([little()], QUICK), "latex")
    with pytest.raises(AssertionError, match="Extra alignment tab"):
        compiled(text.replace("pebble &", "pebble & & & &", 1))
