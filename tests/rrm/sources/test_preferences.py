"""Feedback of a teacher who takes their time."""

import dataclasses

import pytest

from rrm.errors import WaitingError
from rrm.training.build import assemble
from rrm.training.jobs import train
from rrm.training.loop import Trainer
from tests.rrm.training.conftest import Recorder, tiny  # noqa: F401 (a fixture)


class Slow:
    """Another teacher's answers, kept back until `patience` calls have been made, and in another order."""

    def __init__(self, teacher, patience):
        self.teacher, self.patience, self.asked = teacher, patience, []

    def ask(self, queries):
        self.asked += queries

    def answers(self):
        self.patience -= 1
        if self.patience >= 0:
            return []
        self.teacher.ask(self.asked)
        self.asked = []
        return self.teacher.answers()[::-1]

    def observe_return(self, true_return, length):
        self.teacher.observe_return(true_return, length)

    def state_dict(self):
        return self.teacher.state_dict()

    def load_state_dict(self, state):
        self.teacher.load_state_dict(state)


def slow(patience):
    """A run's parts, with the scripted teacher made slow."""

    def assembled(config, streams, results):
        parts = assemble(config, streams, results)
        source = parts.phases[-1].source
        source.teacher = Slow(source.teacher, patience)
        return parts

    return assembled


def test_nothing_of_a_step_happens_while_answers_are_missing(tiny):  # noqa: F811
    """The run waits before its first session, says for what, and ends as one whose teacher answers at once."""
    quick, waiting = Trainer(tiny()), Trainer(tiny(), assembled=slow(4))
    for _ in range(150):
        quick.advance()
        waiting.advance()
    for _ in range(4):
        with pytest.raises(WaitingError, match="10 answers of its teacher"):
            waiting.advance()
    assert waiting.step == 150
    for _ in range(200):
        quick.advance()
        waiting.advance()
    rows = [dataclasses.replace(t.evaluate(), wall_s=0, steps_per_s=0) for t in (quick, waiting)]
    assert repr(rows[0]) == repr(rows[1])


@pytest.mark.slow
def test_a_run_that_waits_is_checkpointed_and_goes_on(tiny, tmp_path):  # noqa: F811
    """Each attempt leaves a checkpoint and asks anew what is open alone; the curve is that of the quick teacher."""
    straight, pieces = Recorder(), Recorder()
    train(tiny(), tmp_path / "a", straight)
    waits = 0
    for patience in (1, 1, 0):
        try:
            finished = train(tiny(), tmp_path / "b", pieces, assembled=slow(patience))
        except WaitingError:
            waits += 1
    assert (waits, finished) == (2, True)
    assert straight.numbers() == pieces.numbers()
