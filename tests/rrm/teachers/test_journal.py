"""The journal of a run's feedback."""

import numpy as np

from rrm.interfaces import Answer
from rrm.teachers.journal import Journal
from tests.rrm.buffers.test_experience import lived

PAIRS = np.array([[0, 7], [1, 2], [0, 7]])


def test_answers_are_used_in_the_order_of_the_questions():
    """Whatever the order in which they come; two equal questions take two answers, and one to nothing changes none."""
    journal = Journal()
    first, other, again = journal.ask(lived([6, 6]), PAIRS, 3, step=40)
    assert first.id == again.id != other.id
    assert (journal.asked_at, len(journal), journal.labels) == (40, 3, 0)
    for answer in (Answer("0" * 16, 1.0), Answer(other.id, np.nan), Answer(first.id, 0.0), Answer(first.id, 0.5)):
        journal.answer(answer)
    assert journal.open == []
    pairs, preference = journal.apply(41)
    np.testing.assert_array_equal(PAIRS, pairs)
    np.testing.assert_array_equal([0.0, np.nan, 0.5], preference)
    assert (journal.asked_at, len(journal), journal.labels) == (None, 3, 2)


def test_a_restored_journal_knows_what_is_open():
    """Questions, answers and steps come back; what is answered already is not open."""
    journal, restored = Journal(), Journal()
    experience = lived([6, 6])
    for answer in [Answer(query.id, 1.0) for query in journal.ask(experience, PAIRS[:2], 3, step=10)]:
        journal.answer(answer)
    journal.apply(10)
    asked = journal.ask(experience, PAIRS, 3, step=20)
    journal.answer(Answer(asked[1].id, 0.0))
    restored.load_state_dict(journal.state_dict())
    assert restored.open == journal.open == [asked[0], asked[2]]
    assert (restored.asked_at, len(restored), restored.labels) == (20, 5, 2)
    for each in (journal, restored):
        each.answer(Answer(asked[0].id, 1.0))
        each.answer(Answer(asked[0].id, np.nan))
    np.testing.assert_array_equal(journal.apply(20)[1], restored.apply(20)[1])


def test_an_id_is_what_both_segments_show():
    """The same steps elsewhere in the experience have the same id."""
    once, twice = lived([6]), lived([6])
    twice.append(once_more(once), 0.0)
    assert Journal().ask(once, PAIRS[1:2], 3, 0)[0].id == Journal().ask(twice, PAIRS[1:2], 3, 5)[0].id


def once_more(experience):
    from rrm.types import Transition

    obs, act = experience.obs[0].numpy(), experience.act[0].numpy()
    return Transition(obs, act, obs, 0.0, 0.0, 0.0, False, False)
