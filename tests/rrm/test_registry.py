"""Looking names up."""

import pytest

from rrm.errors import ConfigError, UnknownNameError
from rrm.registry import check_file, is_file_reference, lookup, source_digest

TABLE = {"join": "os.path:join", "sqrt": "math:sqrt"}


def test_a_name_loads_its_path():
    """A known name gives the object."""
    assert lookup(TABLE, "function", "sqrt")(4) == 2


def test_an_unknown_name_gets_the_nearest():
    """The message names kind, name, suggestion and what is known."""
    with pytest.raises(UnknownNameError, match='unknown function "sqr"; did you mean "sqrt"\\? known: join, sqrt'):
        lookup(TABLE, "function", "sqr")


def test_a_users_file_is_loaded(tmp_path):
    """`file.py:name` is the object of that name in the file."""
    file = tmp_path / "mine.py"
    file.write_text("def twice(x):\n    return 2 * x\n")
    assert lookup(TABLE, "function", f"{file}:twice")(3) == 6


@pytest.mark.parametrize(
    ("text", "name", "message"),
    [
        ("x = 1\n", "y", "defines no 'y'"),
        ("raise RuntimeError('oh')\n", "y", "does not import: RuntimeError: oh"),
        ("def (:\n", "y", "does not import: SyntaxError"),
        ("import sys; sys.exit(0)\n", "y", "does not import: SystemExit: 0"),
    ],
)
def test_a_bad_file_of_the_users_says_why(tmp_path, text, name, message):
    """Missing attribute and failing import are configuration errors that name the file."""
    file = tmp_path / "mine.py"
    file.write_text(text)
    with pytest.raises(ConfigError, match=message):
        lookup(TABLE, "prior", f"{file}:{name}")


def test_a_users_file_may_define_dataclasses(tmp_path):
    """Postponed annotations and dataclasses work in a user's file as in a module."""
    file = tmp_path / "mine.py"
    file.write_text(
        "from __future__ import annotations\nimport dataclasses\n@dataclasses.dataclass\nclass D:\n    x: int = 3\n"
    )
    assert lookup(TABLE, "prior", f"{file}:D")().x == 3


def test_a_missing_file_says_so(tmp_path):
    """A file that is not there is named."""
    with pytest.raises(ConfigError, match="there is no file"):
        lookup(TABLE, "prior", f"{tmp_path}/none.py:f")


@pytest.mark.parametrize(
    "text",
    [
        "def mine(x): ...",
        "async def mine(x): ...",
        "class mine: ...",
        "other, (mine, *rest) = 1, (2, 3)",
        "mine: object = 1",
        "from math import sqrt as mine",
        "import mine.inner",
        "from math import *",
        "def __getattr__(name): return 1",
        "try:\n    import x\nexcept ImportError:\n    def mine(x): ...",
        "if (mine := 1): ...",
        "mine = '\\d'",
    ],
)
def test_a_file_that_can_hold_the_name_is_let_through(tmp_path, text):
    """Defined, assigned, imported, or impossible to say without running the file."""
    (tmp_path / "own.py").write_text(text)
    check_file(f"{tmp_path}/own.py:mine", "prior")


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("def mien(x): ...", r"defines no 'mine'; did you mean \"mien\"\?"),
        ("def f():\n    mine = 1", "defines no 'mine'$"),
        ("class C:\n    def mine(self): ...", "defines no 'mine'$"),
        ("x = 1\ndef mine(x:\n", "own.py, line 2: "),
        ("x = 1\nreturn 3", "own.py, line 2: 'return' outside function"),
        ("x = '\0'", "own.py"),
    ],
)
def test_a_file_that_cannot_hold_the_name_is_refused_unrun(tmp_path, text, said):
    """A name that is not there, with the nearest, and what is not Python, with the line."""
    (tmp_path / "own.py").write_text(text)
    with pytest.raises(ConfigError, match=said):
        check_file(f"{tmp_path}/own.py:mine", "prior")


@pytest.mark.parametrize("kind", ["learner", "prior"])
def test_a_language_models_file_is_never_run(tmp_path, kind):
    """Whoever asks for it, and under whatever name it is reached: neither planning nor the run imports it."""
    own = tmp_path / "x.language.py"
    own.write_text(f"open({str(tmp_path / 'ran')!r}, 'w')\nclass Learner: pass\n")
    (tmp_path / "link.py").symlink_to(own)
    (tmp_path / "Y.Language.py").symlink_to(own)
    for name in ("x.language.py", "link.py", "Y.Language.py"):
        for use in (check_file, lambda *given: lookup({}, *reversed(given))):
            with pytest.raises(ConfigError, match=rf"{name}.*language model's code, which is never run as a {kind}"):
                use(f"{tmp_path / name}:Learner", kind)
    assert not (tmp_path / "ran").exists()


def test_a_huge_file_is_not_parsed(tmp_path):
    """Its size is enough to refuse it."""
    with (tmp_path / "own.py").open("wb") as file:
        file.truncate(3 << 30)
    with pytest.raises(ConfigError, match=r"own\.py.*longer than 10,000,000 bytes"):
        check_file(f"{tmp_path}/own.py:mine", "prior")


def test_the_digest_follows_the_content(tmp_path):
    """Equal content, equal digest, wherever the file lies; our own names have none."""
    for name in ("a.py", "b.py"):
        (tmp_path / name).write_text("x = 1\n")
    assert source_digest(f"{tmp_path}/a.py:x") == source_digest(f"{tmp_path}/b.py:x")
    (tmp_path / "a.py").write_text("x = 2\n")
    assert source_digest(f"{tmp_path}/a.py:x") != source_digest(f"{tmp_path}/b.py:x")
    assert source_digest("proxy") is None


def test_what_is_a_file_reference():
    """Only `….py:identifier` names a file."""
    assert is_file_reference("my/prior.py:fn")
    assert not is_file_reference("proxy")
    assert not is_file_reference("a.py:")
    assert not is_file_reference("a.txt:b")
