"""What became of the episodes of a deployment: `episodes.parquet`, a row each, replaced after every one."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field, fields
from pathlib import Path
from typing import TYPE_CHECKING, Self

from rrm.errors import EpisodesError
from rrm.files import UnfitFileError, read_bounded
from rrm.parquet import read_table, write_table
from rrm.robot.deployment import Episode

if TYPE_CHECKING:
    import pyarrow as pa

FILE = "episodes.parquet"
VERSION = 1
_VERSION_KEY, _SOURCE_KEY, _TIME_KEY = b"rrm.episodes_version", b"rrm.episodes_of", b"rrm.episodes_wall_s"
_LARGEST = 1 << 28  # bytes
_TYPES = {"str": "string", "int": "int64", "float": "float64", "bool": "bool_"}


@dataclass
class Record:
    """Episodes of one or several policies of a run, by the step that each policy comes from."""

    path: Path
    source: str  #: stands for what was deployed where: episodes of another are refused
    episodes: dict[int, list[Episode]] = field(default_factory=dict)  #: of each step as played: 0, 1, 2 ...
    wall_s: float = 0.0  #: time that playing them took, as far as it was told

    @classmethod
    def read(cls, path: Path, source: str | None = None) -> Self:
        """What is there, of this source (None: whatever it is of); nothing where there is no file.

        Raises:
            EpisodesError: it cannot be gone on with.
            OSError: it cannot be read now.
        """
        import pyarrow as pa

        try:
            data = read_bounded(path, _LARGEST)
        except FileNotFoundError:
            return cls(path, source or "")
        except UnfitFileError as error:
            raise EpisodesError(f"{path} cannot be read as episodes: {error.strerror}") from error
        try:
            table = read_table(data)
        except (pa.ArrowException, OSError, ValueError) as error:
            raise EpisodesError(f"{path} cannot be read as episodes: {error}") from error
        known = table.schema.metadata or {}
        version = known.get(_VERSION_KEY, b"none").decode(errors="replace")
        if version != str(VERSION) or table.schema.remove_metadata() != _schema().remove_metadata():
            raise EpisodesError(f"{path} holds no episodes as this version knows them (version {version}, {VERSION})")
        of = known.get(_SOURCE_KEY, b"").decode(errors="replace")
        if source not in (None, of):
            raise EpisodesError(f"{path} holds episodes of other networks, or at another workplace")
        record = cls(path, of, wall_s=_seconds(known.get(_TIME_KEY, b"")))
        for row in table.to_pylist():
            record.episodes.setdefault(row.pop("step"), []).append(Episode(**row))
        if any(episode.number != at for played in record.episodes.values() for at, episode in enumerate(played)):
            raise EpisodesError(f"{path} lacks episodes before its last")
        return record

    def of(self, step: int) -> list[Episode]:
        """Those of one policy, in the order of their numbers."""
        return self.episodes.get(step, [])

    def add(self, step: int, episode: Episode, took_s: float = 0.0) -> None:
        """Take one, durably on return. An `OSError` names the file."""
        import pyarrow as pa

        self.wall_s += took_s
        self.episodes.setdefault(step, []).append(episode)
        rows = [{"step": at} | asdict(each) for at, played in sorted(self.episodes.items()) for each in played]
        about = {_VERSION_KEY: str(VERSION), _SOURCE_KEY: self.source, _TIME_KEY: f"{self.wall_s:.3f}"}
        schema = _schema().with_metadata(about)
        write_table(self.path, pa.Table.from_pylist(rows, schema=schema))


def _seconds(text: bytes) -> float:
    """Those that a file tells; 0 where it tells none."""
    try:
        seconds = float(text)
    except ValueError:
        return 0.0
    return seconds if 0.0 <= seconds < float("inf") else 0.0


def _schema() -> pa.Schema:
    import pyarrow as pa

    columns = [(each.name, getattr(pa, _TYPES[str(each.type)])()) for each in fields(Episode)]
    return pa.schema([("step", pa.int64()), *columns])
