"""The record of deployed episodes: what is added is there again, and what it cannot go on with it refuses."""

import dataclasses

import pyarrow.parquet as pq
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rrm.errors import EpisodesError
from rrm.robot.deployment import Episode
from rrm.robot.record import Record

_OF_TYPE = {
    "int": st.integers(0, 2**40), "float": st.floats(), "bool": st.booleans(),
    "str": st.text(st.characters(exclude_categories=["Cs"])),
}  # fmt: skip
_FIELDS = {field.name: _OF_TYPE[field.type] for field in dataclasses.fields(Episode) if field.name != "number"}
EPISODES = st.lists(st.tuples(st.sampled_from([100, 2000]), st.fixed_dictionaries(_FIELDS)))


def episode(number, **fields):
    given = dict.fromkeys(("total", "total_seen", "views", "markers", "error_px"), 1.5)
    given |= dict.fromkeys(("steps", "acted", "held", "breakdowns"), 3) | {"success": True, "success_seen": False}
    return Episode(number=number, **given | fields)


@pytest.fixture
def record(tmp_path):
    """Of two policies: two episodes of one, and one of the other."""
    record = Record(tmp_path / "episodes.parquet", "these networks")
    for step, number in ((200, 0), (100, 0), (200, 1)):
        record.add(step, episode(number))
    return record


@pytest.mark.slow
@settings(max_examples=25)
@given(rows=EPISODES)
def test_what_is_added_is_there_again(tmp_path_factory, rows):
    """Every number and text, NaN and infinity too, in its order, by policies."""
    path = tmp_path_factory.mktemp("record") / "episodes.parquet"
    for step, fields in rows:
        record = Record.read(path, "source")
        record.add(step, Episode(number=len(record.of(step)), **fields))
    read = Record.read(path, "source")
    for step in (100, 2000):
        added = [Episode(number=at, **fields) for at, fields in enumerate(f for s, f in rows if s == step)]
        assert repr(read.of(step)) == repr(added)


def test_the_time_that_playing_took_adds_up(record):
    """Over all that go on with the file; one that tells no time, or nonsense, begins at none."""
    assert Record.read(record.path).wall_s == 0.0
    for took, total in ((1.5, 1.5), (0.25, 1.75)):
        again = Record.read(record.path)
        again.add(200, episode(len(again.of(200))), took)
        assert Record.read(record.path).wall_s == total
    table = pq.read_table(record.path)
    for told in ({}, {b"rrm.episodes_wall_s": b"-inf"}, {b"rrm.episodes_wall_s": b"soon"}):
        about = {key: value for key, value in table.schema.metadata.items() if key != b"rrm.episodes_wall_s"}
        pq.write_table(table.replace_schema_metadata(about | told), record.path)
        assert Record.read(record.path).wall_s == 0.0


def test_it_knows_its_source_and_refuses_another(record):
    """Who does not care what it is of reads it all the same, and is told."""
    assert Record.read(record.path, record.source).episodes == record.episodes
    assert Record.read(record.path) == record
    with pytest.raises(EpisodesError, match=r"episodes.parquet holds episodes of other networks, or at another"):
        Record.read(record.path, "others")


def test_nothing_is_there_before_the_first(tmp_path):
    assert Record.read(tmp_path / "episodes.parquet", "source").episodes == {}


def test_damage_is_found_wherever_it_is(record):
    """A byte anywhere, a shorter file, another file or a folder in its place: never wrong numbers or another error."""
    good = record.path.read_bytes()
    for place in range(0, len(good), 37):
        record.path.write_bytes(good[:place] + bytes([good[place] ^ 0x55]) + good[place + 1 :])
        try:
            assert Record.read(record.path).episodes == record.episodes  # a byte that says nothing
        except EpisodesError as error:
            assert str(record.path) in str(error)  # noqa: PT017 (either is right)
    for data in (b"", good[:-9], b"PAR1 or so"):
        record.path.write_bytes(data)
        with pytest.raises(EpisodesError, match="cannot be read as episodes"):
            Record.read(record.path, record.source)
    record.path.unlink()
    record.path.mkdir()
    with pytest.raises(EpisodesError, match="not a regular file"):
        Record.read(record.path, record.source)


def test_episodes_that_are_not_all_of_them_are_refused(record):
    """Whoever goes on counts those that are there."""
    table = pq.read_table(record.path)
    for part, message in ((table.slice(0, 1), ""), (table.slice(2, 1), "lacks episodes"), (table.drop(["lost"]), "no")):
        pq.write_table(part, record.path)
        if message:
            with pytest.raises(EpisodesError, match=message):
                Record.read(record.path, record.source)
        else:
            assert Record.read(record.path, record.source).of(100) == record.of(100)


def test_a_file_that_cannot_be_read_now_is_not_taken_for_a_damaged_one(record, tmp_path):
    """What it holds is not known: nobody may set it aside for that."""
    loop = tmp_path / "loop"
    loop.symlink_to(loop)
    with pytest.raises(OSError, match="symbolic links"):
        Record.read(loop, record.source)
