"""People as teachers, at the scale of seconds: what they say in files is worth as much as what is said at once."""

import dataclasses

import numpy as np
import pytest

from rrm.config import SurfConfig, TeacherConfig
from rrm.envs import make
from rrm.errors import ConfigError, LabelError, MissingResultError, WaitingError
from rrm.teachers.labels import EQUAL, FILE, FIRST, SECOND, SKIPPED, read_labels, write_labels
from rrm.teachers.published import published_steps, read_episodes, read_session, segment_id, session_path
from rrm.training.jobs import train
from rrm.training.loop import Trainer
from tests.rrm.teachers.people import answer, preferred, sealed
from tests.rrm.training.conftest import Recorder, networks, tiny  # noqa: F401 (fixtures)

HUMAN = TeacherConfig(kind="human", study="test")


class Killed(BaseException):
    """Nobody catches it, as nobody does a signal 9."""


class Fragile(Recorder):
    """Dies after some steps, and nothing is written."""

    def should_stop(self):
        if super().should_stop():
            raise Killed
        return False


def taught(config, folder, choose=preferred, recorder=None, patience=lambda: None):
    """Train to the end, answered between attempts; the rows, and how often it left."""
    recorder = recorder or Recorder()
    for attempt in range(100):
        recorder.patience = patience()
        try:
            if train(config, folder, recorder):
                return recorder.numbers(), attempt
        except WaitingError:
            assert answer(folder, choose)
        except Killed:
            pass
    raise AssertionError("it never came to its end")


@pytest.fixture
def place(tmp_path):
    """Makes folders of runs."""

    def named(name):
        (tmp_path / name).mkdir()
        return tmp_path / name

    return named


METHODS = {
    "pebble": {},
    "rrm-proxy": {"prior": "proxy", "seed": 1},
    "surf, which sees more than is shown": {"learner": "surf", "surf": SurfConfig(unlabelled=2, margin=3, crop=2)},
}


@pytest.mark.slow
@pytest.mark.parametrize("method", METHODS)
def test_answers_that_come_later_teach_the_same(method, tiny, place, tmp_path, networks):  # noqa: F811
    """Curve and networks are those of the scripted teacher, also where the run dies at random; and a replay's."""
    scripted, config, straight = tiny(**METHODS[method]), tiny(**METHODS[method], teacher=HUMAN), Recorder()
    assert train(scripted, place("scripted"), straight)
    rows, left = taught(config, place("human"))
    assert left == 3  # a session each, and no slot is held meanwhile
    rng = np.random.default_rng(0)
    stormy, left = taught(config, place("storm"), recorder=Fragile(), patience=lambda: int(rng.integers(20, 400)))
    assert left > 3
    replay = TeacherConfig(kind="replay", study="test", labels=str(tmp_path / "human" / FILE))
    again, _ = taught(tiny(**METHODS[method], teacher=replay), place("replay"))
    assert straight.numbers() == rows == stormy == again
    folders = [tmp_path / name for name in ("scripted", "human", "storm", "replay")]
    assert len({networks(folder) for folder in folders}) == 1
    for step in published_steps(folders[1]):
        files = {session_path(folder, step).read_bytes() for folder in folders[1:3]}
        assert len(files) == 1


@pytest.fixture
def waiting(tiny, place):  # noqa: F811
    """A run that waits at its first session: configuration, and folder."""
    config, folder = tiny(teacher=HUMAN), place("run")
    with pytest.raises(WaitingError, match="10 answers of its teacher"):
        train(config, folder, Recorder())
    return config, folder


def test_clips_can_be_lived_again(waiting):
    """From the state in which an episode began, the actions lead through the same observations and returns."""
    config, folder = waiting
    path = session_path(folder, 150)
    session, episodes, env = read_session(path), read_episodes(path), make(config.task, horizon=50)
    assert (session.run, session.length, session.repeat, session.horizon) == (config.identity, 10, 1, 50)
    assert [query.index for query in session.queries] == [*range(10)]
    rewards = []
    for episode in episodes:
        env.load_state_dict(episode.start)
        lived = [env.step(act) for act in episode.act]
        np.testing.assert_array_equal(episode.obs[1:], [step[0] for step in lived])
        rewards.append([step[1] for step in lived])
    shown = [segment for query in session.queries for segment in (query.first, query.second)]
    for segment in shown:
        episode, part = episodes[segment.episode], slice(segment.begin, segment.begin + session.length)
        assert segment.id == segment_id(config.task, episode.obs[part], episode.act[part])
        assert sum(rewards[segment.episode][part]) == pytest.approx(segment.true_return, abs=1e-5)
    assert {len(each.act) for each in episodes} <= {each.begin + 10 for each in shown}  # nothing beyond what is shown


def test_a_session_counts_as_a_whole_and_once_it_is_sealed(waiting):
    """While one answer lacks, or none is sealed yet, the run waits on. What was undone before counts for nothing."""
    config, folder = waiting
    for step in ({"most": 9}, {"seal": False}):
        answer(folder, lambda _: FIRST, **step)
        with pytest.raises(WaitingError):
            train(config, folder, Recorder())
    labels = read_labels(folder / FILE)
    write_labels(folder / FILE, [dataclasses.replace(label, undone=True) for label in labels])
    assert answer(folder, lambda query: [SKIPPED, EQUAL, SECOND][query.index % 3]) == 10 + 10
    with pytest.raises(WaitingError):
        train(config, folder, Recorder())
    assert published_steps(folder) == [150, 300]
    trainer = Trainer(config, {config.identity: folder})
    for _ in range(151):
        trainer.advance()
    pairs = trainer.phases[-1].source.preferences.state_dict()
    told = next(values for values in pairs.values() if getattr(values, "dtype", None) is not None and values.ndim == 1)
    assert told[:6].tolist() == [0.5, 1.0, 0.5, 1.0, 0.5, 1.0]  # of ten, four were skipped


@pytest.mark.parametrize(
    "wrong",
    [
        lambda label: dataclasses.replace(label, query="0" * 16),
        lambda label: dataclasses.replace(label, index=label.index + 1),
        lambda label: dataclasses.replace(label, index=label.index + 100),
        lambda label: dataclasses.replace(label, run="0" * 16),  # at one seed all are asked the same at first
    ],
)
def test_labels_of_another_run_are_refused(wrong, waiting):
    """One line says which answer is to a question that this run did not ask there; nothing is learned."""
    config, folder = waiting
    answer(folder)
    write_labels(folder / FILE, [*map(wrong, read_labels(folder / FILE))])
    with pytest.raises(LabelError, match="holds labels of another run") as refused:
        train(config, folder, Recorder())
    assert "\n" not in str(refused.value)


def test_a_damaged_file_of_labels_is_refused_and_kept(waiting):
    """Half a file is told by its name, and stays as it is."""
    config, folder = waiting
    answer(folder)
    half = (folder / FILE).read_bytes()[:500]
    (folder / FILE).write_bytes(half)
    with pytest.raises(LabelError, match="cannot be read as labels"):
        train(config, folder, Recorder())
    assert (folder / FILE).read_bytes() == half


def test_a_run_trained_anew_asks_the_same_and_finds_its_answers(waiting, networks):  # noqa: F811
    """Of people's work nothing is lost with what was trained."""
    config, folder = waiting
    rows, _ = taught(config, folder)
    before = networks(folder)
    for path in (folder / "model.safetensors", *(folder / "queries").iterdir()):
        path.unlink()
    again = Recorder()
    assert train(config, folder, again)
    assert (again.numbers(), networks(folder)) == (rows, before)


def test_a_replay_takes_the_answers_to_its_own_twin(waiting, tiny, place):  # noqa: F811
    """Those of another seed, or only some of them, are refused; what else the file holds makes no difference."""
    config, folder = waiting
    taught(config, folder)
    replay = TeacherConfig(kind="replay", study="test", labels=str(folder / FILE))
    other, twin = tiny(teacher=replay, seed=1), tiny(teacher=replay)
    assert twin.answered == config.identity
    assert twin.cell == other.cell != config.cell
    for lacking in (other, tiny(teacher=replay.model_copy(update={"study": "another"}))):
        with pytest.raises(LabelError, match="has no answers to pebble on toy-car with seed"):
            train(lacking, place(lacking.identity), Recorder())
    labels, identity = read_labels(folder / FILE), twin.identity
    write_labels(folder / FILE, labels[:-1])
    with pytest.raises(LabelError, match=r"does not hold all answers of run .* before step 450"):
        train(tiny(teacher=replay), place("half"), Recorder())
    write_labels(folder / FILE, [*labels, dataclasses.replace(labels[0], annotator="b", purpose="repeat")])
    assert twin.identity == identity
    write_labels(folder / FILE, [dataclasses.replace(labels[0], answer=1 - labels[0].answer), *labels[1:]])
    assert twin.identity != identity


def test_a_teacher_of_people_needs_a_folder_and_a_replay_a_file(tiny, tmp_path):  # noqa: F811
    """What cannot be is said before anything is trained."""
    with pytest.raises(MissingResultError, match=r"labels\.parquet of the run"):
        Trainer(tiny(teacher=HUMAN))
    for wrong in ({"kind": "replay"}, {"labels": "some.parquet"}):
        with pytest.raises(ConfigError, match=r"teacher\.labels"):
            raise_inner(lambda wrong=wrong: tiny(teacher=TeacherConfig(**wrong)))
    with pytest.raises(LabelError, match="cannot read the answers in"):
        tiny(teacher=TeacherConfig(kind="replay", labels=str(tmp_path / "none.parquet")))


def raise_inner(make):
    """Pydantic puts ours into an error of its own."""
    from pydantic import ValidationError

    try:
        make()
    except ValidationError as error:
        raise error.errors()[0]["ctx"]["error"] from None


def test_who_teaches_is_part_of_what_a_run_is(tiny):  # noqa: F811
    """Another study asks anew; what the scripted teacher is told of people, and people of it, means nothing."""
    scripted = tiny()
    assert tiny(teacher=TeacherConfig(study="test")).identity == scripted.identity
    assert tiny(teacher=HUMAN.model_copy(update={"mistake": 0.1})).identity == tiny(teacher=HUMAN).identity
    ways = [scripted, tiny(teacher=HUMAN), tiny(teacher=TeacherConfig(kind="human", study="later"))]
    assert len({run.identity for run in ways}) == 3


def test_sealing_is_of_whole_sessions(waiting):
    """The person in these tests seals as the server does."""
    _, folder = waiting
    answer(folder, most=3, seal=False)
    assert sealed(folder) == 0
    assert answer(folder, seal=False) == 7
    assert sealed(folder) == 10
