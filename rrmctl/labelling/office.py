"""What the server does all the while: look for new questions, have their clips drawn, seal what is answered."""

from __future__ import annotations

import asyncio
import itertools
import time
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import rrm
from rrm.teachers.labels import PRACTICE, SHARED, TRAIN, Label
from rrmctl.errors import UserError
from rrmctl.labelling.clips import Clips, Wanted
from rrmctl.labelling.desk import Desk
from rrmctl.labelling.keys import Keys
from rrmctl.labelling.question import Given, Question, Rules, Sitting
from rrmctl.store.provenance import read_config
from rrmctl.store.status import RunState

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from rrm.teachers.published import PublishedSession
    from rrmctl.labelling.study import Study
    from rrmctl.store.status import Status

#: Between two looks at the runs, seconds.
_LOOK_S = 1.0
#: So long pages may take to hear that the study is over, seconds.
_LAST_S = 2.0
#: Nothing more will be asked by a run that is one of these.
_ENDED = (RunState.DONE, RunState.FAILED, RunState.BLOCKED)
#: Segments where no configuration says how long they are.
_SEGMENT = 50


class Office:
    """The desk, with what lies on it and who stands before it.

    Args:
        practice: whether people practise first.
        shared: pairs that everybody is asked.
        skip_unshown: whether what cannot be shown counts as skipped, in place of being waited for.
        say: prints a line for whoever started the server.
        address: of the server, before the secret of a link.
    """

    def __init__(
        self,
        study: Study,
        rules: Rules,
        *,
        practice: bool,
        shared: int,
        skip_unshown: bool,
        say: Callable[[str], None],
        address: str,
    ) -> None:
        self.study, self._say, self._address = study, say, address
        self._practice, self._shared, self._skip = practice, shared, skip_unshown
        self.keys = Keys(study.layout.label_keys, rules.people)
        self.clips = Clips(study.layout.clips, say)
        self.desk = Desk(
            rules, study.rows(), study.write, clock=time.monotonic, wall=time.time, tool=f"rrmctl {rrm.__version__}"
        )
        self.ready = False  #: it has looked what there is
        self.over = False  #: nothing will be asked any more
        self.closing: Callable[[], bool] = lambda: False  #: whether the server is leaving: nothing waits any longer
        self._states: dict[str, Status] = {}
        self._said: set[str] = set()

    def link(self, person: str) -> str:
        """What a person opens, once."""
        return f"{self._address}/#{self.keys.link(person)}"

    def admit(self, link: str) -> str | None:
        """The key for a link, and a new link for when its page is gone."""
        if (given := self.keys.exchange(link)) is None:
            return None
        key, person = given
        self._say(f"{person} is here; should that page be closed: {self.link(person)}")
        return key

    def answer(self, sitting: Sitting, claim: str, given: Given) -> Label:
        """Store an answer, see `Desk.answer`."""
        facts = self.clips.facts
        return self.desk.answer(sitting, claim, given, lambda q: facts.get(q.query.first.id, {}).get("camera", ""))

    async def drawn(self, segment: str, patience_s: float) -> bool:
        """Wait for a clip; False where it is not there in time, never will be, or the server is leaving."""
        deadline = time.monotonic() + patience_s
        while not (there := await self.clips.drawn(segment, 0.5)):
            if self.closing() or time.monotonic() >= deadline or not self.clips.wants(segment):
                break
        return there

    def waiting(self, sitting: Sitting) -> dict[str, Any]:
        """What a page is told that is asked nothing now."""
        mine = self.desk.progress(sitting, TRAIN)
        others = any(not self.desk.is_answered(question) for question in self.desk.unsealed())
        return {
            "state": "wait", "minutes": self.study.minutes(self._states), "done": mine[0], "of": mine[1],
            "others": others, "begun": bool(self.desk.rows),
            "unshown": len(self.desk.unshown()), "grace": self.desk.rules.grace_s,
        }  # fmt: skip

    async def work(self) -> None:
        """Until every run of the study has ended."""
        await self._make_extra()  # comes before all questions of runs
        while not self.over:
            self.look()
            await asyncio.sleep(_LOOK_S)
        await asyncio.sleep(_LAST_S)

    def look(self) -> None:
        """Once: what is published, what can be sealed, what is to be drawn."""
        self.study.look()
        self._states = self.study.states()
        self.desk.lay(self._questions(), unshown=self.clips.refused, runs=len(self.study.jobs))
        for path, why in self.study.damage.items():
            self._once(f"its questions are not asked: {why}", path)
        try:
            if self._skip and (count := self.desk.skip_unshown()):
                self._say(f"{count} questions that cannot be shown are skipped")
            for run, step in self.desk.seal():
                job = self.study.jobs[run]
                self._say(f"all answered: {job.label}, before step {step:,}")
        except UserError as error:
            self._once(f"the answers could not be stored, which is tried again: {error}", error)
        self.ready = True
        wanted = itertools.chain(self.desk.upcoming(), self.desk.unsealed())
        self.clips.want(
            Wanted(self._files[id(question.session)], segment)
            for question in wanted
            for segment in (question.query.first, question.query.second)
        )
        self.over = all(status.state in _ENDED for status in self._states.values())

    def _questions(self) -> Iterator[Question]:
        self._files: dict[int, Path] = {}
        for purpose, asked in ((PRACTICE, self._practice), (SHARED, bool(self._shared))):
            for task in self.study.tasks if asked else ():
                path, session = self.study.of_nobody(task, purpose)
                if session is not None:
                    yield from self._of(path, session, purpose)
        for path, session in self.study.published():
            yield from self._of(path, session, TRAIN)

    def _of(self, path: Path, session: PublishedSession, purpose: str) -> Iterator[Question]:
        self._files[id(session)] = path
        for query in session.queries:
            yield Question(session, query, purpose)

    async def _make_extra(self) -> None:
        for task in self.study.tasks if self._practice or self._shared else ():
            run = next(job.id for job in self.study.jobs.values() if job.task == task)
            feedback = read_config(self.study.layout.run(run)).get("feedback") or {}
            folder = self.study.layout.extra_queries(task)
            told = await self.clips.make(
                folder=str(folder), task=task, length=feedback.get("segment", _SEGMENT), shared=self._shared
            )
            if told:
                self._once(f"there is no practice on {task}: {told.get('refused') or told.get('trouble')}", folder)

    def _once(self, message: str, about: object) -> None:
        if (mark := f"{about}{message}") not in self._said:
            self._said.add(mark)
            self._say(message)
