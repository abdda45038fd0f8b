"""Where manifests come from: with the program, from a folder of the user's, by path."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from rrmctl.errors import UserError
from rrmctl.planning.experiments import SHIPPED, available, find, replaced
from tests.rrmctl.planning.test_manifest import GOOD, write


def test_find(tmp_path: Path) -> None:
    """A name is looked up in the folder and among the shipped, a path is taken as it is, a near miss is suggested."""
    path = write(tmp_path, GOOD, "mine.toml")
    assert find("mine", tmp_path) == path
    assert find("toy-car", tmp_path) == SHIPPED / "toy-car.toml"
    assert find(str(path), None) == path
    with pytest.raises(UserError, match='did you mean "main-results"'):
        find("main-result", tmp_path)
    with pytest.raises(UserError, match="no file"):
        find("absent.toml", tmp_path)
    (tmp_path / "inner.toml").mkdir()
    for folder in (tmp_path, tmp_path / "inner.toml"):
        with pytest.raises(UserError, match="is a folder"):
            find(str(folder), tmp_path)


def test_a_folder_that_is_not_there(tmp_path: Path) -> None:
    """One that is named must be there; one that nobody named need not."""
    with pytest.raises(UserError) as caught:
        available(tmp_path / "absent")
    assert "--experiments" in str(caught.value.hint)


def test_what_is_shipped_is_known_everywhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """In a folder without manifests there are the shipped ones, and none of them is called replaced."""
    monkeypatch.chdir(tmp_path)
    assert list(available(None)) == sorted(path.stem for path in SHIPPED.glob("*.toml"))
    assert replaced(available(None)) == []
    monkeypatch.chdir(SHIPPED.parent)
    assert replaced(available(None)) == []


def test_ones_own_add_to_them_and_win(tmp_path: Path) -> None:
    """Manifests in `experiments` join the shipped ones, and `list` tells which stands in place of a shipped one."""
    (tmp_path / "experiments").mkdir()
    write(tmp_path / "experiments", GOOD)
    write(tmp_path / "experiments", GOOD.replace('"T"', '"Not the toy"'), "toy-car.toml")
    command = [sys.executable, "-m", "rrmctl", "list"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=True)
    lines = {line.split()[0]: line for line in done.stdout.splitlines()}
    assert {"mine", "main-results"} < set(lines)
    assert lines["toy-car"].rstrip().endswith("Not the toy")
    assert lines["note:"] == "note: toy-car is experiments/toy-car.toml, in place of the one that comes with rrmctl"


def test_whatever_lies_in_the_folder_is_answered_at_once(tmp_path: Path) -> None:
    """Pipes, devices, folders, links to nothing and dotted keys without end hide no good manifest and take no time."""
    write(tmp_path, GOOD)
    write(tmp_path, "a." * 36_000 + "a = 1", "dots.toml")
    write(tmp_path, "#" * 2**18 + "#", "large.toml")
    (tmp_path / "latin.toml").write_bytes(b"title = '\xe9'")
    (tmp_path / "folder.toml").mkdir()
    os.mkfifo(tmp_path / "pipe.toml")
    for name, target in {"device": "/dev/zero", "nothing": "nowhere", "itself": "itself.toml"}.items():
        (tmp_path / f"{name}.toml").symlink_to(target)
    limited = "import resource; resource.setrlimit(resource.RLIMIT_AS, (2**30, 2**30));"
    code = f"{limited} from rrmctl.cli.app import main; main()"
    done = subprocess.run(
        [sys.executable, "-c", code, "list", "--experiments", tmp_path],
        capture_output=True, text=True, timeout=60, check=False,
    )  # fmt: skip
    assert done.returncode == 2
    assert "\nmine " in done.stdout
    assert "Traceback" not in done.stderr
    told = {Path(line.split(".toml")[0]).name: line.rsplit(": ", 1)[1] for line in done.stderr.splitlines()}
    assert told == {
        "dots": "a key of more than 20 parts in line 1", "latin": "invalid continuation byte at byte 9",
        "large": "longer than 262,144 bytes",
        "folder": "not a regular file", "pipe": "not a regular file", "device": "not a regular file",
        "nothing": "No such file or directory", "itself": "Too many levels of symbolic links",
    }  # fmt: skip
