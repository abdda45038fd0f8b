"""Who is asked what, and that whatever happens in between each question ends with exactly one answer that counts."""

import itertools
from collections import Counter

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, precondition, rule

from rrm.teachers.labels import FIRST, PRACTICE, REPEAT, SECOND, SHARED, SKIPPED, TRAIN, live
from rrm.teachers.published import PublishedQuery, PublishedSession, ShownSegment
from rrmctl.labelling.desk import LEASE_S, Desk, RefusedError
from rrmctl.labelling.question import Given, Question, Rules, Sitting

LEFT = Given("left", 900.0, 1.5, 1.0, "key")
ANN, BEN = Sitting("ann", "a" * 64), Sitting("ben", "b" * 64)


def session(run, step=1000, count=4, purpose=TRAIN):
    """Questions of a session; segments of each are its own."""
    place = f"{run}{step}{purpose}"

    def shown(at, side, begin):
        return ShownSegment(f"{place}-{at}{side}", 0, begin, float(at))

    queries = tuple(PublishedQuery(at, f"{place}-{at}", shown(at, "f", 0), shown(at, "s", 5)) for at in range(count))
    whole = PublishedSession(run=run, task="toy-car", step=step, length=5, repeat=1, horizon=100, queries=queries)
    return [Question(whole, query, purpose) for query in queries]


class World:
    """A desk, what it stored, and clocks."""

    def __init__(self, questions, people=("ann", "ben"), runs=0, **rules):
        self.rules, self.questions, self.runs = Rules(people=people, **rules), questions, runs
        self.files, self.now, self.wall, self.broken = {}, 100.0, 1e9, False
        self.restart()

    def write(self, run, rows):
        if self.broken:
            raise OSError("no space")
        self.files[run] = list(rows)

    def restart(self):
        rows = list(itertools.chain(*self.files.values()))
        self.desk = Desk(self.rules, rows, self.write, clock=lambda: self.now, wall=lambda: self.wall)
        self.desk.lay(self.questions, runs=self.runs)

    def later(self, seconds, jump=0.0):
        self.now += seconds
        self.wall += seconds + jump

    def answer(self, sitting=ANN, given=LEFT):
        claim = self.desk.claim(sitting)
        return self.desk.answer(sitting, claim.id, given)


def test_an_answer_says_what_was_seen():
    """The segment that is meant, whichever side it stood on, and all that is known of the moment."""
    world = World(session("r", count=40))
    sides = Counter()
    for _ in range(40):
        claim = world.desk.claim(ANN)
        row = world.desk.answer(ANN, claim.id, LEFT, lambda q: f"camera of {q.query.first.id}")
        assert (row.answer, row.shown_left) == (claim.left, claim.left)
        assert row.camera == f"camera of {row.first}"
        assert (row.annotator, row.latency_ms, row.purpose, row.sealed) == ("ann", 900.0, TRAIN, False)
        assert row.at - row.shown_at == pytest.approx(0.9)
        sides[row.shown_left] += 1
    assert min(sides.values()) > 5  # either side, by chance
    assert world.desk.claim(ANN) is None


def test_a_question_is_before_one_page_at_a_time():
    """Until its lease lapses; a page that is loaded again gets its own back."""
    world = World(session("r", count=1), assign="query")
    claim = world.desk.claim(ANN)
    assert world.desk.claim(BEN) is None
    assert world.desk.claim(ANN) == claim
    world.later(LEASE_S - 1)
    assert world.desk.renew(ANN, [claim.id]) == [claim.id]
    world.later(LEASE_S - 1)
    assert world.desk.claim(BEN) is None
    world.later(2)
    taken = world.desk.claim(BEN)
    assert taken.question == claim.question
    assert taken.id != claim.id
    with pytest.raises(RefusedError):
        world.desk.answer(ANN, claim.id, LEFT)
    world.desk.answer(BEN, taken.id, LEFT)


def test_an_answer_that_is_sent_twice_is_one():
    """Its response may have been lost, with the server. Another answer to the same claim is refused."""
    world = World(session("r"))
    claim = world.desk.claim(ANN)
    row = world.desk.answer(ANN, claim.id, LEFT)
    for _ in range(2):
        assert world.desk.answer(ANN, claim.id, LEFT) == row
        with pytest.raises(RefusedError, match="already"):
            world.desk.answer(ANN, claim.id, LEFT._replace(chosen="right"))
        world.restart()
    assert len(world.files["r"]) == 1


def test_a_claim_outlives_the_server():
    """The key that is pressed while the server is away counts."""
    world = World(session("r"))
    claim = world.desk.claim(ANN)
    world.restart()
    assert world.desk.answer(ANN, claim.id, LEFT).query == claim.question.query.query


def test_undo():
    """The pair comes back under another name; what was said stays in the file, as undone, and no longer counts."""
    world = World(session("r"))
    first, row = world.desk.claim(ANN), world.answer()
    again = world.desk.undo(ANN, first.id)
    assert again.question == first.question
    assert again.id != first.id
    assert world.desk.undo(ANN, first.id).id == again.id  # sent twice
    world.desk.answer(ANN, again.id, LEFT._replace(chosen="skip"))
    assert [(r.undone, r.answer) for r in world.files["r"]] == [(True, row.answer), (False, SKIPPED)]
    world.restart()
    assert world.desk.undo(ANN).question == first.question  # unnamed: the newest
    with pytest.raises(RefusedError, match="nothing to undo"):
        world.desk.undo(BEN)
    with pytest.raises(RefusedError, match="nothing to undo"):
        world.desk.undo(ANN)


def test_a_session_is_sealed_when_the_last_answer_had_its_grace():
    """All in, and no undo since; sealed answers cannot be taken back."""
    world = World(session("r", count=2), grace_s=30)
    world.answer()
    world.later(100)
    assert world.desk.seal() == []
    claim = world.desk.claim(ANN)
    world.desk.answer(ANN, claim.id, LEFT)
    world.later(29)
    assert world.desk.seal() == []
    again = world.desk.undo(ANN)
    world.later(60)
    assert world.desk.seal() == []
    world.desk.answer(ANN, again.id, LEFT)
    world.later(31)
    assert world.desk.seal() == [("r", 1000)]
    assert [row.sealed for row in world.files["r"] if not row.undone] == [True, True]
    assert world.desk.seal() == []
    with pytest.raises(RefusedError, match="too late"):
        world.desk.undo(ANN)


@pytest.mark.parametrize("jump", [-1e6, 1e6])
def test_clocks_that_jump_lose_nothing(jump):
    """The grace passes by a clock that does not jump, in this server and, from its start on at the latest, the next."""
    world = World(session("r", count=1), grace_s=30)
    world.answer()
    world.later(1, jump)
    assert world.desk.seal() == []
    world.restart()
    world.later(31)
    assert world.desk.seal() == [("r", 1000)]
    world.later(1, -2 * jump)
    world.restart()
    assert world.desk.seal() == []
    assert all(row.sealed for row in world.files["r"])


def test_a_server_that_died_before_it_sealed():
    """The next one seals at once what has had its grace."""
    world = World(session("r", count=1), grace_s=30)
    world.answer()
    world.later(31)
    world.restart()
    assert world.desk.seal() == [("r", 1000)]


def test_what_is_not_stored_did_not_happen():
    """A full disk: the question stays before the page, which sends its answer again."""
    world = World(session("r", count=1))
    claim = world.desk.claim(ANN)
    world.broken = True
    with pytest.raises(OSError, match="no space"):
        world.desk.answer(ANN, claim.id, LEFT)
    assert not world.desk.rows
    world.broken = False
    world.desk.answer(ANN, claim.id, LEFT)
    world.broken = True
    with pytest.raises(OSError, match="no space"):
        world.desk.undo(ANN, claim.id)
    assert not world.desk.rows[0].undone


def test_a_run_is_one_persons():
    """By default nobody answers for a run that is another's, each person has their share of runs, in turns."""
    world = World([*session("r1"), *session("r2"), *session("r3"), *session("r4")], runs=4)
    mine = {sitting: [world.answer(sitting).run for _ in range(8)] for sitting in (ANN, BEN)}
    assert set(mine[ANN]) | set(mine[BEN]) == {"r1", "r2", "r3", "r4"}
    assert not set(mine[ANN]) & set(mine[BEN])
    first, second = dict.fromkeys(mine[ANN])
    assert mine[ANN] == [first, second] * 4
    assert world.desk.claim(ANN) is None
    world = World([*session("r1"), *session("r2")], runs=2)
    assert {world.answer().run for _ in range(4)} == {"r1"}
    assert world.desk.claim(ANN) is None  # the other run is Ben's share


def test_whoever_is_no_longer_asked_owns_nothing():
    """Their runs go on with others."""
    world = World(session("r"), people=("ann",))
    world.answer()
    world.rules = Rules(people=("ben",))
    world.restart()
    assert world.desk.claim(BEN) is not None


def test_anybody_may_answer_anything():
    """With `assign` query, no pair twice."""
    world = World([*session("r1"), *session("r2")], assign="query")
    rows = [world.answer(sitting) for _ in range(4) for sitting in (ANN, BEN)]
    assert len({(row.run, row.index) for row in rows}) == 8


def test_practice_and_shared_pairs_come_first():
    """For each person, once; they belong to no run."""
    world = World([*session("", 0, 2, PRACTICE), *session("", 1, 3, SHARED), *session("r")], assign="query")
    for sitting in (ANN, BEN):
        rows = [world.answer(sitting) for _ in range(5)]
        assert [row.purpose for row in rows] == [PRACTICE] * 2 + [SHARED] * 3
        assert {row.run for row in rows} == {""}
        world.restart()
    assert world.answer().purpose == TRAIN
    assert len(world.files[""]) == 10


def test_repeated_pairs_change_sides():
    """A share of a person's own pairs, long enough after, and they train nothing."""
    world = World(session("r", count=60), repeat=0.1)
    rows = []
    while (claim := world.desk.claim(ANN)) is not None:
        rows.append(world.desk.answer(ANN, claim.id, LEFT))
        world.later(1)
    again = [row for row in rows if row.purpose == REPEAT]
    assert len(again) == 6
    for row in again:
        before = next(r for r in rows if r.purpose == TRAIN and r.index == row.index)
        assert row.shown_left == 1 - before.shown_left
        assert rows.index(row) - rows.index(before) > 9
    assert len(live(world.files["r"])) == 60
    world.later(100)
    assert world.desk.seal() == [("r", 1000)]


def test_what_cannot_be_shown_is_waited_for_or_skipped():
    """Nobody is asked it; its session is sealed only once somebody decides that it counts as skipped."""
    world = World(session("r", count=2), grace_s=0)
    assert world.desk.claim(ANN).question == world.questions[0]  # before anybody knew
    world.desk.lay(world.questions, unshown={world.questions[0].query.second.id})
    row = world.answer()
    assert row.index == 1
    assert world.desk.claim(ANN) is None
    assert world.desk.seal() == []
    assert world.desk.skip_unshown() == 1
    assert world.desk.skip_unshown() == 0
    assert world.desk.seal() == [("r", 1000)]
    assert live(world.files["r"])[1000, 0].answer == SKIPPED


def test_progress():
    """Of what the person's round has now."""
    world = World([*session("", 0, 2, PRACTICE), *session("r1"), *session("r2")], runs=2)
    assert world.desk.progress(ANN, PRACTICE) == (0, 2)
    world.answer()
    assert world.desk.progress(ANN, PRACTICE) == (1, 2)
    assert world.desk.progress(BEN, PRACTICE) == (0, 2)
    world.answer()
    world.answer()
    assert world.desk.progress(ANN, TRAIN) == (1, 4)


class Studies(RuleBasedStateMachine):
    """People claim, answer, send again, undo, leave and come back while servers die, disks fill and clocks jump."""

    def __init__(self):
        super().__init__()
        self.world = World([*session("r1", count=3), *session("r2", count=2)], assign="query", grace_s=10, repeat=0.5)
        self.claims = []
        self.sealed = {}

    @rule(sitting=st.sampled_from([ANN, BEN]), known=st.booleans())
    def claim(self, sitting, known):
        held = [claim.id for who, claim in self.claims if who == sitting] if known else []
        try:
            claim = self.world.desk.claim(sitting, held)
        except RefusedError:
            return
        if claim:
            self.claims.append((sitting, claim))

    @precondition(lambda self: self.claims)
    @rule(data=st.data(), chosen=st.sampled_from(["left", "right", "equal", "skip"]))
    def answer(self, data, chosen):
        sitting, claim = data.draw(st.sampled_from(self.claims))
        try:
            row = self.world.desk.answer(sitting, claim.id, LEFT._replace(chosen=chosen))
        except (RefusedError, OSError):
            return
        assert (row.run, row.index) == (claim.question.session.run, claim.question.query.index)
        assert row in self.world.files[row.run]  # durable before anybody is told

    @rule(sitting=st.sampled_from([ANN, BEN]), data=st.data())
    def undo(self, sitting, data):
        named = [claim.id for who, claim in self.claims if who == sitting]
        try:
            claim = self.world.desk.undo(sitting, data.draw(st.sampled_from(["", *named])))
        except (RefusedError, OSError):
            return
        self.claims.append((sitting, claim))

    @rule(seconds=st.sampled_from([0, 5, 11, LEASE_S + 1]), jump=st.sampled_from([0, 0, -1e5, 1e5]))
    def later(self, seconds, jump):
        self.world.later(seconds, jump)

    @rule()
    def die(self):
        self.world.broken = False
        self.world.restart()

    @rule()
    def disk(self):
        self.world.broken = not self.world.broken

    @rule()
    def seal(self):
        try:
            self.world.desk.seal()
        except OSError:
            return

    @invariant()
    def nothing_is_doubled_or_unsealed(self):
        stored = list(itertools.chain(*self.world.files.values()))
        counting = Counter(
            (r.purpose, r.run, r.step, r.index, r.purpose == REPEAT and r.annotator) for r in stored if not r.undone
        )
        assert set(counting.values()) <= {1}
        now = {(r.run, r.index): r for r in stored if r.sealed}
        assert self.sealed.items() <= now.items()  # what a run may have read stays as it is
        self.sealed = now
        for run in {run for run, _ in now}:
            assert all(row.sealed for row in live(self.world.files[run]).values())
        assert not any(row.sealed and row.undone for row in stored)

    def teardown(self):
        """Whatever happened, people can bring the study to its end."""
        self.world.broken = False
        self.world.later(LEASE_S + 1)
        for sitting in (ANN, BEN):
            for _ in range(40):
                if (claim := self.world.desk.claim(sitting)) is not None:
                    self.world.desk.answer(sitting, claim.id, LEFT)
        self.world.later(11)
        self.world.desk.seal()
        self.nothing_is_doubled_or_unsealed()
        assert len(self.sealed) == 5


Studies.TestCase.settings = settings(max_examples=60, stateful_step_count=30)
TestStudies = Studies.TestCase


@given(st.integers(0, 2**32))
def test_a_claim_cannot_be_guessed_from_another(number):
    """Names follow from the page's secret."""
    world = World(session("r"))
    other = Sitting("ann", f"{number:064x}")
    assert world.desk.claim(ANN).id != world.desk.claim(other).id
    with pytest.raises(RefusedError):
        world.desk.answer(other, world.desk.claim(ANN).id, LEFT)


assert {FIRST, SECOND} == {0, 1}
