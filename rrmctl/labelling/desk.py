"""Who is asked what, and what becomes of the answers: decided anew from the stored rows at every request.

A query is published, claimed by one page for `LEASE_S` (which the page renews), answered, and at last sealed: once all
of its session are answered and the newest answer is `grace_s` old. Until then its answer can be undone. Leases alone
live in memory. A claim's name follows from the page's secret and the rows, so that an answer to a claim of a server
that died in between is taken by the next one, and an answer that is sent twice is one.

Times in the rows are the wall clock's and order nothing. Ages are of a clock that never jumps: a recorded time is
carried over to it once, when its row is read, and never lies in the future.
"""

from __future__ import annotations

import math
from collections import Counter, defaultdict
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from dataclasses import replace
from typing import NamedTuple

from rrm.teachers.labels import FIRST, PRACTICE, REPEAT, SHARED, SKIPPED, TRAIN, Label
from rrmctl.labelling.question import (
    Claim,
    Given,
    Key,
    Question,
    Rules,
    Sitting,
    claim_name,
    key_of,
    meant,
    session_of,
)

LEASE_S = 120.0
#: So many other answers of a person lie between a pair and its repetition.
_APART = 10
#: Claims that a page may hold: the pair before the person, the next, and one that was undone.
_AT_ONCE = 4


class RefusedError(Exception):
    """An answer or the like that comes too late, or is not this page's to give."""


class _Lease(NamedTuple):
    claim: Claim
    sitting: Sitting
    until: float


class Desk:
    """The state of a study's labels.

    Args:
        write: stores all rows of a run ("" for those of none), durably; nothing changes here where it raises.
        clock: never jumps, seconds.
        wall: seconds since the epoch.
    """

    def __init__(
        self,
        rules: Rules,
        rows: Iterable[Label],
        write: Callable[[str, Sequence[Label]], None],
        *,
        clock: Callable[[], float],
        wall: Callable[[], float],
        tool: str = "",
    ) -> None:
        self.rules, self._write, self._clock, self._wall, self._tool = rules, write, clock, wall, tool
        self._rows: list[Label] = []
        self._seen: dict[Key, float] = {}  # by session: when its newest row was written, by the clock
        self._leases: dict[Key, _Lease] = {}
        self._questions: tuple[Question, ...] = ()
        self._unshown: frozenset[str] = frozenset()
        self._runs = 0
        now, today = clock(), wall()
        newest: defaultdict[str, float] = defaultdict(lambda: -math.inf)  # of each run: its own order is the true one
        dated = []
        for row in rows:
            newest[row.run] = max(newest[row.run], row.at)
            dated.append((newest[row.run], row))
            written = now - max(0.0, today - row.at)
            self._seen[session_of(row)] = max(self._seen.get(session_of(row), -math.inf), written)
        self._adopt([row for _, row in sorted(dated, key=lambda pair: pair[0])])

    def lay(self, questions: Iterable[Question], *, unshown: Collection[str] = (), runs: int = 0) -> None:
        """What is published now: practice, what everybody is asked, and the queries of runs, in this order.

        Args:
            unshown: segments that cannot be shown; their questions stay open, and nobody is asked them.
            runs: of the study, so many in the end.
        """
        self._questions, self._unshown, self._runs = tuple(questions), frozenset(unshown), runs

    @property
    def rows(self) -> Sequence[Label]:
        """Every row, oldest first."""
        return self._rows

    def claim(self, sitting: Sitting, held: Collection[str] = ()) -> Claim | None:
        """What the person is asked next; one that the page holds and does not know of first. None: nothing now."""
        mine = [lease.claim for lease in self._current() if lease.sitting == sitting]
        for claim in mine:
            if claim.id not in held:
                return self._take(sitting, claim)
        if len(mine) >= _AT_ONCE:
            raise RefusedError("this page holds questions enough")
        question = next(self._next(sitting), None)
        return None if question is None else self._take(sitting, self._claim(sitting, question))

    def renew(self, sitting: Sitting, ids: Collection[str]) -> list[str]:
        """Those of the page's claims that it still has."""
        mine = [lease.claim for lease in self._current() if lease.sitting == sitting and lease.claim.id in ids]
        return [self._take(sitting, claim).id for claim in mine]

    def answer(
        self, sitting: Sitting, claim_id: str, given: Given, camera: Callable[[Question], str] = lambda _: ""
    ) -> Label:
        """Store an answer. Raises RefusedError where the question is answered, or somebody else's by now."""
        for row, name in self._mine(sitting):
            if name == claim_id and not row.undone:
                if row.answer != meant(given, row.shown_left):
                    raise RefusedError("it was answered already, in another way")
                return row
        claim = self._find(sitting, claim_id)
        row = self._row(claim.question, meant(given, claim.left), sitting.annotator, given)
        row = replace(row, shown_left=claim.left, session=sitting.id, camera=camera(claim.question))
        self._store(row.run, [*self._rows, row])
        self._seen[session_of(row)] = self._clock()
        self._leases.pop(claim.question.key(sitting.annotator), None)
        return row

    def undo(self, sitting: Sitting, claim_id: str = "") -> Claim:
        """Take an answer of this page back, the newest where none is named, and ask again. RefusedError: too late."""
        mine = list(self._mine(sitting))
        named = (
            [row for row, name in mine if name == claim_id] if claim_id else [row for row, _ in mine if not row.undone]
        )
        if not named:
            raise RefusedError("there is nothing to undo")
        row = named[-1]
        question = self._question(row)
        if row.sealed or question is None:
            raise RefusedError("it is too late: the robot learns from this answer already")
        if not row.undone:
            self._store(row.run, [replace(each, undone=True) if each is row else each for each in self._rows])
        elif (key := question.key(sitting.annotator)) in self._answered or self._held_by_others(sitting, key):
            raise RefusedError("it was undone already, and answered since")
        return self._take(sitting, self._claim(sitting, question))

    def skip_unshown(self) -> int:
        """Store for the runs' questions that cannot be shown that nobody answered them; how many."""
        nobody = Given("skip", 0.0, 0.0, 1.0, "unshown")
        rows = [self._row(q, SKIPPED, "", nobody) for q in self.unshown() if not self.is_answered(q)]
        for run in {row.run for row in rows}:
            self._store(run, [*self._rows, *(row for row in rows if row.run == run)])
        return len(rows)

    def unshown(self) -> list[Question]:
        """The runs' questions that cannot be shown."""
        return [q for q in self._questions if q.purpose == TRAIN and not self._shows(q)]

    def is_answered(self, question: Question) -> bool:
        """Whether a run's question has its answer."""
        return question.key("") in self._answered

    def seal(self) -> list[tuple[str, int]]:
        """Seal what can no longer be undone; the sessions, by run and step."""
        now, sealed = self._clock(), []
        for (run, step), asked in self.sessions().items():
            rows = [self._answered.get(question.key("")) for question in asked]
            answers = {id(row) for row in rows if row and not row.sealed}
            age = now - self._seen.get((run, str(step)), now)
            if all(rows) and answers and age >= self.rules.grace_s:
                self._store(run, [replace(r, sealed=True) if id(r) in answers else r for r in self._rows])
                sealed.append((run, step))
        return sealed

    def upcoming(self) -> Iterator[Question]:
        """What pages hold, and what every person could be asked next, the most urgent first."""
        yield from [lease.claim.question for lease in self._current()]
        for person in self.rules.people:
            yield from self._next(Sitting(person, ""))

    def sessions(self) -> dict[tuple[str, int], list[Question]]:
        """The runs' queries by session."""
        by_session: defaultdict[tuple[str, int], list[Question]] = defaultdict(list)
        for question in self._questions:
            if question.purpose == TRAIN:
                by_session[question.session.run, question.session.step].append(question)
        return by_session

    def unsealed(self) -> list[Question]:
        """The runs' queries of sessions that are not sealed yet."""
        return [
            question
            for asked in self.sessions().values()
            if not all((row := self._answered.get(each.key(""))) and row.sealed for each in asked)
            for question in asked
        ]

    def progress(self, sitting: Sitting, purpose: str) -> tuple[int, int]:
        """How many the person's round has that are answered, and in all."""
        me = sitting.annotator
        if purpose in (PRACTICE, SHARED):
            asked = [question for question in self._questions if question.purpose == purpose]
        else:
            owners = self.owners()
            asked = [q for q in self.unsealed() if self.rules.assign == "query" or owners.get(q.session.run) == me]
        return sum(question.key(me) in self._answered for question in asked), len(asked)

    def owners(self) -> dict[str, str]:
        """Whose each run is, as far as people begun; of those who are still asked."""
        owners: dict[str, str] = {}
        for row in self.rows:
            if row.purpose == TRAIN and row.annotator in self.rules.people:
                owners.setdefault(row.run, row.annotator)
        for lease in self._current():
            if lease.claim.question.purpose == TRAIN:
                owners.setdefault(lease.claim.question.session.run, lease.sitting.annotator)
        return owners

    def _next(self, sitting: Sitting) -> Iterator[Question]:
        """What the person can be asked, the most urgent first."""
        me = sitting.annotator
        leased = {key for key in self._leases if self._leases[key].until > self._clock()}
        for question in self._questions:
            if question.purpose != TRAIN and self._free(question, me, leased):
                yield question
        yield from self._repetitions(me, leased)
        asked = [q for q in self._questions if q.purpose == TRAIN]
        answered = Counter(q.session.run for q in asked if not self._free(q, me, leased))
        owners = self.owners()
        share = math.ceil(max(self._runs, len({q.session.run for q in asked})) / len(self.rules.people))
        full = sum(owner == me for owner in owners.values()) >= share

        def theirs(question: Question) -> bool:
            owner = owners.get(question.session.run)
            return self.rules.assign == "query" or owner == me or (owner is None and not full)

        can = [q for q in asked if theirs(q) and self._free(q, me, leased)]
        yield from sorted(can, key=lambda q: (answered[q.session.run], owners.get(q.session.run) != me))

    def _free(self, question: Question, me: str, leased: Collection[Key]) -> bool:
        key = question.key(me)
        return key not in self._answered and key not in leased and self._shows(question)

    def _shows(self, question: Question) -> bool:
        return not {question.query.first.id, question.query.second.id} & self._unshown

    def _repetitions(self, me: str, leased: Collection[Key]) -> Iterator[Question]:
        own = [row for row in self._answered.values() if row.purpose == TRAIN and row.annotator == me]
        repeated = sum(row.purpose == REPEAT and row.annotator == me for row in self._answered.values())
        waiting = sum(key[:2] == (REPEAT, me) for key in leased)
        if math.floor(len(own) * self.rules.repeat) <= repeated + waiting:
            return
        for row in sorted(own, key=lambda row: row.at)[:-_APART]:
            question = self._question(row)
            if question and self._free(again := question._replace(purpose=REPEAT), me, leased):
                yield again

    def _claim(self, sitting: Sitting, question: Question) -> Claim:
        key = question.key(sitting.annotator)
        name = claim_name(sitting, key, self._turns[key])
        if question.purpose == REPEAT and (before := self._answered.get(question._replace(purpose=TRAIN).key(""))):
            return Claim(name, question, 1 - before.shown_left)
        first = claim_name(sitting, key, 0)  # by lot, and after an undo as before
        return Claim(name, question, int(first[0], 16) & 1)

    def _find(self, sitting: Sitting, claim_id: str) -> Claim:
        for lease in self._current():
            if lease.sitting == sitting and lease.claim.id == claim_id:
                return lease.claim
        for question in self._next(sitting):  # of a server before this one, or of a lease that lapsed
            if (claim := self._claim(sitting, question)).id == claim_id:
                return claim
        raise RefusedError("this question is no longer yours")

    def _take(self, sitting: Sitting, claim: Claim) -> Claim:
        self._leases[claim.question.key(sitting.annotator)] = _Lease(claim, sitting, self._clock() + LEASE_S)
        return claim

    def _held_by_others(self, sitting: Sitting, key: Key) -> bool:
        return any(key == each.claim.question.key(each.sitting.annotator) and each.sitting != sitting
                   for each in self._current())  # fmt: skip

    def _current(self) -> Iterator[_Lease]:
        now = self._clock()
        self._leases = {
            key: lease
            for key, lease in self._leases.items()
            if lease.until > now and key not in self._answered and self._shows(lease.claim.question)
        }
        return iter(self._leases.values())

    def _mine(self, sitting: Sitting) -> Iterator[tuple[Label, str]]:
        """The page's rows, oldest first, and the names of the claims that they answered."""
        for row, turn in zip(self._rows, self._turn, strict=True):
            if row.session == sitting.id:
                yield row, claim_name(sitting, key_of(row), turn)

    def _question(self, row: Label) -> Question | None:
        return next((q for q in self._asked(row) if q.key(row.annotator) == key_of(row)), None)

    def _asked(self, row: Label) -> Iterator[Question]:
        for question in self._questions:
            yield question._replace(purpose=REPEAT) if row.purpose == REPEAT else question

    def _row(self, question: Question, answer: int, annotator: str, given: Given) -> Label:
        (session, query, purpose), now = question, self._wall()
        return Label(
            run=session.run, step=session.step, index=query.index, query=query.query,
            first=query.first.id, second=query.second.id, answer=answer, shown_left=FIRST,
            return_first=query.first.true_return, return_second=query.second.true_return,
            return_shown=self.rules.hint, annotator=annotator, purpose=purpose, latency_ms=given.latency_ms,
            loops=given.loops, speed=given.speed, input=given.input, shown_at=now - given.latency_ms / 1000, at=now,
            tool=self._tool,
        )  # fmt: skip

    def _store(self, run: str, rows: list[Label]) -> None:
        self._write(run, [row for row in rows if row.run == run])
        self._adopt(rows)

    def _adopt(self, rows: list[Label]) -> None:
        self._rows = rows
        self._answered = {key_of(row): row for row in rows if not row.undone}
        self._turns: Counter[Key] = Counter()  # answers so far, undone ones included
        self._turn: list[int] = []  # of each row, how many came before it
        for key in map(key_of, rows):
            self._turn.append(self._turns[key])
            self._turns[key] += 1
