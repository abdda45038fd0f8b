"""Results folders that came from elsewhere: whose code runs, and where things are written."""

from __future__ import annotations

from pathlib import Path

import pytest
from typer.testing import CliRunner, Result

from rrmctl.cli.app import app
from rrmctl.cli.trust import remember, require_trust
from rrmctl.errors import UserError
from rrmctl.running.config_file import code_files

EXPERIMENTS = Path(__file__).parents[3] / "experiments"


def call(*arguments: str | Path) -> Result:
    return CliRunner().invoke(app, list(map(str, arguments)))


@pytest.fixture
def results(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A sweep with a prior in a file, planned by somebody else: its run fails at once, and is to be tried again."""
    prior = tmp_path / "theirs.py"
    left = tmp_path / "ran"
    prior.write_text(f"open({str(left)!r}, 'w').close()\nraise OSError('no more')\n\ndef p(step): ...\n")
    results = tmp_path / "results"
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "theirs"))
    sweep = ("run", "toy-car", "--experiments", EXPERIMENTS, "--profile", "smoke", "--seeds", "1", "--methods", "rrm-p")
    assert call(*sweep, "--prior", f"{prior}:p", "--results", results).exit_code == 1
    (tmp_path / "ran").unlink()
    return results


@pytest.mark.slow
def test_code_of_others_runs_only_when_its_user_says_so(results: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Who planned it is not asked; another one is told which file, with code 2, until --trust; edited code is new."""
    ran, again = results.parent / "ran", ("resume", "--retry-failed", "--results", results)
    assert call(*again).exit_code == 1
    assert ran.exists()
    ran.unlink()
    monkeypatch.setenv("XDG_STATE_HOME", str(results.parent / "mine"))
    result = call(*again)
    assert result.exit_code == 2
    assert str(results.parent / "theirs.py") in result.stderr
    assert "--trust" in result.stderr
    assert not ran.exists()
    assert call(*again, "--trust").exit_code == 1
    assert ran.exists()
    ran.unlink()
    assert call(*again).exit_code == 1
    assert ran.exists()


def test_known_content_is_not_asked_about(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A file is known by its content, wherever it lies; frozen language priors and names of ours are no such code."""
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    reward = {"prior": "/a/mine.py:p", "prior_digest": "1" * 64, "learner": "pebble", "learner_digest": None}
    code = code_files({"reward": reward})
    assert code == {"/a/mine.py": "1" * 64}
    assert code_files({"reward": reward | {"prior": "/a/mine.language.py:reward"}}) == {}
    assert code_files({"reward": [], "imitation": None}) == {}
    with pytest.raises(UserError, match=r"not run from here before:\n  /a/mine\.py"):
        require_trust(tmp_path, code, trust=False, asks=False)
    require_trust(tmp_path, code, trust=True, asks=False)
    require_trust(tmp_path, {"/b/moved.py": "1" * 64}, trust=False, asks=False)
    with pytest.raises(UserError):
        require_trust(tmp_path, {"/a/mine.py": "2" * 64}, trust=False, asks=False)


def test_a_home_that_takes_no_write_asks_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What cannot be remembered is no error, nor is a record that is no file."""
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "file"))
    remember(["0" * 64])
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    (tmp_path / "rrmctl" / "trusted").mkdir(parents=True)
    remember(["0" * 64])


@pytest.mark.slow
@pytest.mark.parametrize(
    "command",
    [
        ["run", "toy-car", "--results", ""], ["status", "--results", ""], ["list", "--experiments", ""],
        ["report", "html", "--output="], ["report", "iqm", "-o", ""], ["plot", "toy-car", "-o", ""],
        ["export", "toy-car", "--to", "csv", "-o", ""], ["run", "toy-car", "--experiments="],
    ],
)  # fmt: skip
def test_an_empty_name_is_no_place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, command: list[str]) -> None:
    """A variable that is unset names no folder: exit code 2, and nothing is written into the one here."""
    monkeypatch.chdir(tmp_path)
    result = call(*command)
    assert result.exit_code == 2
    assert " is empty" in result.stderr
    assert list(tmp_path.iterdir()) == []
