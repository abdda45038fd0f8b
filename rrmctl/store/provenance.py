"""What a run is, and what it ran with: versions, machine, code, environment; and what changed on resumption."""

from __future__ import annotations

import dataclasses
import datetime
import hashlib
import importlib.metadata
import importlib.util
import json
import platform
import socket
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

from pydantic import AfterValidator, StrictInt, StrictStr

import rrm
from rrm.devices import CUDA, cards
from rrm.hardware import cpu_model
from rrm.tuning import OTHERWISE, Choice, in_words
from rrmctl.errors import UserError
from rrmctl.store.files import DamagedError, set_aside
from rrmctl.store.layout import RunFolder
from rrmctl.store.records import check_version, read_json, settings, validated, write_json
from rrmctl.store.schema import SCHEMA_VERSION

#: Packages whose version can change a number or a file.
PACKAGES = (
    "rrmctl", "torch", "numpy", "numba", "gymnasium", "metaworld", "mujoco", "dm-control", "pyarrow", "pydantic",
    "safetensors",
)  # fmt: skip

#: Facts that cannot change a run's numbers, and are not compared on resumption.
_CIRCUMSTANCES = ("started", "host", "argv", "attempt")

#: How runs multiplied that were recorded before there was a choice.
_ONLY_WAY = {OTHERWISE: "torch"}

#: What to do about a configuration that is not what it should be.
CONFIG_HINT = "run its experiment again: `rrmctl run NAME` writes it anew"

#: What the program itself reads of a configuration; the rest is checked when the run starts.
_Config = dataclasses.make_dataclass("_Config", [
    *((name, StrictStr) for name in ("id", "cell", "profile", "task", "method", "precision")),
    *((name, StrictInt) for name in ("config_version", "seed", "steps", "threads")),
])  # fmt: skip


def read_config(folder: RunFolder) -> dict[str, Any]:
    """The run's `config.json`."""
    config = read_json(folder.config, CONFIG_HINT)
    if config is None:
        raise DamagedError(f"{folder.config} is missing", CONFIG_HINT)
    validated(_Config, config, folder.config, CONFIG_HINT)
    return config


def record_config(folder: RunFolder, content: dict[str, Any]) -> str | None:
    """Write the run's `config.json` unless it says the same already; the note is of a damaged one set aside."""
    note = None
    try:
        stored = read_json(folder.config)
    except DamagedError as error:
        stored = None
        if folder.config.exists():
            note = f"{error}; set aside as {set_aside(folder.config, 'corrupt').name} and written anew"
    if stored != content:
        write_json(folder.config, content)
    return note


def collect(
    config: Mapping[str, Any], fingerprint: Mapping[str, str], products: Choice, argv: Sequence[str], attempt: int
) -> dict[str, Any]:
    """Facts about an attempt of this number that starts now, in this process.

    Args:
        fingerprint: of the environment: its packages, and a hash of its true reward on fixed states.
        products: which ways its networks' products go.
        argv: the command that asked for the run.
    """
    card = {"card": next((card.name for card in cards()), "unknown")} if config.get("device") == CUDA else {}
    return {
        "python": platform.python_version(),
        "platform": f"{platform.system()} {platform.machine()}",
        "cpu": cpu_model(),
        **card,
        "versions": {name: version(name) or "absent" for name in PACKAGES},
        "code": code_digest("rrm"),
        "config": hashlib.sha256(json.dumps(config, sort_keys=True).encode()).hexdigest()[:16],
        "fingerprint": dict(fingerprint),
        "precision": str(config["precision"]),
        "threads": int(config["threads"]),
        "products": dict(products),
        "started": datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"),
        "host": socket.gethostname(),
        "argv": list(argv),
        "attempt": attempt,
    }


def read_provenance(folder: RunFolder) -> dict[str, Any] | None:
    """The run's `provenance.json`; None where it was never started."""
    hint = "move it away; what the run ran with until now is then unknown"
    stored = read_json(folder.provenance, hint)
    if stored is not None:
        check_version(stored.get("schema_version"), folder.provenance, hint)
        validated(_Recorded, stored, folder.provenance, hint, "started argv versions resumed products")
        stored.setdefault("products", _ONLY_WAY)
    return stored


@dataclasses.dataclass(frozen=True)
class _Resumption:
    changes: dict[str, tuple[Any, Any]]  #: before and after, by name


def _complete(products: Choice) -> Choice:
    if OTHERWISE not in products:
        raise ValueError(f'it lacks "{OTHERWISE}"')
    return products


@dataclasses.dataclass(frozen=True)
class _Recorded:
    """What others read of a file, of whatever version of the program."""

    started: Annotated[StrictStr, AfterValidator(datetime.datetime.fromisoformat)] = ""
    argv: tuple[StrictStr, ...] = ()
    versions: dict[str, Any] = dataclasses.field(default_factory=dict)
    products: Annotated[dict[str, StrictStr], AfterValidator(_complete)] = dataclasses.field(
        default_factory=lambda: _ONLY_WAY
    )
    resumed: tuple[_Resumption, ...] = ()


def asked_by(folder: RunFolder) -> list[str]:
    """The command that asked for the run's first attempt; empty where that is not known."""
    try:
        return list((read_provenance(folder) or {}).get("argv", []))
    except UserError:
        return []


def record(folder: RunFolder, facts: Mapping[str, Any]) -> list[str]:
    """Write the provenance of a run's first attempt, or add that of a later one.

    Where earlier attempts have left something and their provenance is gone, what is written is marked `lost`.

    Returns:
        What differs from the attempt before, one line each, such as `versions.torch: 2.6.0 -> 2.7.1`.
    """
    stored = read_provenance(folder)
    if stored is None:
        lost = {"lost": True} if folder.curve.exists() or folder.checkpoint.exists() else {}
        write_json(folder.provenance, {"schema_version": SCHEMA_VERSION, **facts, **lost, "resumed": []})
        return []
    old, new = _flat(stored), _flat(facts)
    for entry in stored.get("resumed", []):
        old |= {name: after for name, (_, after) in entry["changes"].items()}
    pairs = {name: (old.get(name, "absent"), new.get(name, "absent")) for name in sorted(old | new)}
    changes = {name: pair for name, pair in pairs.items() if pair[0] != pair[1]}
    resumed = {name: facts[name] for name in _CIRCUMSTANCES} | {"changes": changes}
    write_json(folder.provenance, stored | {"resumed": [*stored.get("resumed", []), resumed]})
    return [f"{name}: {before} -> {after}" for name, (before, after) in changes.items()]


def made_with(stored: Mapping[str, Any] | None) -> dict[str, str]:
    """The compared facts of a run by dotted name, as its file has them; `a, then b` where a later attempt differed."""
    if stored is None:
        return {}
    facts = {name: f"unknown, then {value}" if stored.get("lost") else value for name, value in _flat(stored).items()}
    for entry in stored.get("resumed", []):
        for name, (before, after) in entry["changes"].items():
            facts[name] = f"{facts.get(name, before)}, then {after}"
    return facts


def version(package: str) -> str | None:
    """Of a package as it runs here; None where it is not installed. Ours is the sources', however they came here."""
    if package == "rrmctl":
        return rrm.__version__
    try:
        return importlib.metadata.version(package)
    except importlib.metadata.PackageNotFoundError:
        return None


def code_digest(package: str) -> str:
    """Digest over the names and contents of a package's Python files, found without importing it."""
    spec = importlib.util.find_spec(package)
    assert spec is not None
    assert spec.submodule_search_locations is not None
    digest = hashlib.sha256()
    for root in map(Path, spec.submodule_search_locations):
        for path in sorted(root.rglob("*.py")):
            content = hashlib.sha256(path.read_bytes()).hexdigest()
            digest.update(f"{path.relative_to(root).as_posix()} {content}\n".encode())
    return digest.hexdigest()[:16]


def _flat(facts: Mapping[str, Any]) -> dict[str, str]:
    """The compared facts as text, by dotted name; the ways of products are one of them."""
    left_out = (*_CIRCUMSTANCES, "resumed", "lost", "schema_version")
    compared = {name: value for name, value in facts.items() if name not in left_out}
    compared["products"] = in_words(facts["products"])
    return {name: str(value) for name, value in settings(compared).items()}
