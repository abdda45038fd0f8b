"""What people answered to the queries of a section, as tables and figures read it."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np

from rrm.errors import LabelError
from rrm.teachers.labels import FIRST, PRACTICE, REPEAT, SECOND, SKIPPED, TRAIN, Label, read_labels
from rrmctl.errors import UserError
from rrmctl.reports.series import Section
from rrmctl.stats import Floats

#: Several people together.
EVERYBODY = "everybody"


@dataclass(frozen=True)
class Answers:
    """Answers that count, oldest first: neither taken back nor practice, and of a run's query the newest."""

    labels: tuple[Label, ...]
    undone: tuple[Label, ...] = ()  #: those that were taken back
    practice: int = 0  #: answers to practice queries

    @classmethod
    def of(cls, labels: Iterable[Label]) -> Answers:
        """What counts of every row, the rows of a file in its order."""
        every = [label for label in labels if label.annotator]  # without what nobody could be shown
        real, newest, latest = (
            [label for label in every if label.purpose != PRACTICE],
            {},
            defaultdict[str, float](float),
        )
        for label in real:  # a file's order is true, also where a clock was set back
            latest[label.run] = max(latest[label.run], label.at)
            who = "" if label.purpose == TRAIN else label.annotator
            key = (label.run, label.purpose, label.step, label.index, label.query, who)
            if not label.undone:
                newest[key] = (latest[label.run], label)
        undone = tuple(label for label in real if label.undone)
        ordered = sorted(newest.values(), key=lambda dated: dated[0])
        return cls(tuple(label for _, label in ordered), undone, len(every) - len(real))

    @property
    def people(self) -> list[str]:
        """Who answered, sorted."""
        return sorted({label.annotator for label in self.labels})

    def by(self, annotator: str) -> Answers:
        """Those of one person."""
        own, undone = (
            tuple(label for label in labels if label.annotator == annotator) for labels in (self.labels, self.undone)
        )
        return Answers(own, undone)

    def count(self, answer: int) -> int:
        """So many of this answer."""
        return sum(label.answer == answer for label in self.labels)

    def left(self) -> Floats:
        """Of answers that prefer one, whether it stood on the left."""
        return np.array([label.answer == label.shown_left for label in self.labels if _decided(label)], np.float64)

    def right(self) -> Floats:
        """Whether each prefers what has the higher true return; NaN where it prefers none or returns are equal."""
        return np.array([_right(label) for label in self.labels], np.float64)

    def shown(self) -> Floats:
        """Whether each was given with the true returns in sight."""
        return np.array([label.return_shown for label in self.labels], np.float64)

    def differences(self) -> Floats:
        """Of the two true returns, without sign."""
        return np.array([abs(label.return_second - label.return_first) for label in self.labels], np.float64)

    def seconds(self) -> Floats:
        """From the first frame to the key; a millisecond at least."""
        return np.array([max(label.latency_ms, 1.0) / 1000.0 for label in self.labels], np.float64)

    def sittings(self, values: Floats) -> list[Floats]:
        """One of the above, apart for each sitting of each person."""
        groups = defaultdict[tuple[str, str], list[float]](list)
        for label, value in zip(self.labels, values, strict=True):
            groups[label.annotator, label.session].append(float(value))
        return [np.array(group) for group in groups.values()]

    def repeated(self) -> list[bool]:
        """For queries that one person answered before: whether alike."""
        last: dict[tuple[str, str], int] = {}
        alike = []
        for label in self.labels:
            key = (label.annotator, label.query)
            if key in last and label.answer != SKIPPED != last[key]:
                alike.append(label.answer == last[key])
            last[key] = label.answer
        return alike

    def ratings(self) -> tuple[list[str], Floats]:
        """People, and what each said of every query that several answered [queries, people], NaN where nothing.

        Beside shared queries these are those that two runs have in common, as the first ones of one seed.
        """
        said: dict[str, dict[str, int]] = defaultdict(dict)
        for label in self.labels:
            if label.purpose != REPEAT and label.answer != SKIPPED:
                said[label.query].setdefault(label.annotator, label.answer)
        people, rows = self.people, [row for row in said.values() if len(row) > 1]
        matrix = [[row.get(person, np.nan) for person in people] for row in rows]
        return people, np.array(matrix, np.float64).reshape(-1, len(people))


def answers(section: Section, labels: Mapping[str, Iterable[Label]] | None = None) -> dict[str, Answers]:
    """By task what people answered to the queries of a section's runs: these labels, or those of its store.

    There shared and practice queries are of no run, so of no task: those of whoever answered a run's query count, where
    people were asked about one task alone. A damaged file raises a `UserError`.
    """
    if labels is None:
        labels = _stored(section)
    return {task: given for task, rows in labels.items() if (given := Answers.of(rows)).labels}


def _stored(section: Section) -> dict[str, list[Label]]:
    if section.source is None:
        return {}
    rows = defaultdict[str, list[Label]](list)
    try:
        for run, task in section.answered.items():
            rows[task] += read_labels(section.source.run(run).labels)
        extra = read_labels(section.source.extra_labels) if len(rows) == 1 else []
    except LabelError as error:
        raise UserError(str(error), "put back a copy of it, or move it away") from error
    theirs = {label.annotator for own in rows.values() for label in own}
    return {task: own + [each for each in extra if each.annotator in theirs] for task, own in rows.items()}


def everybody(given: Mapping[str, Answers]) -> Answers:
    """Those of all tasks together."""
    groups = given.values()
    labels = sorted((label for group in groups for label in group.labels), key=lambda label: label.at)
    undone = tuple(label for group in groups for label in group.undone)
    return Answers(tuple(labels), undone, sum(group.practice for group in groups))


def _decided(label: Label) -> bool:
    return label.answer in (FIRST, SECOND)


def _right(label: Label) -> float:
    if not _decided(label) or label.return_first == label.return_second:
        return float("nan")
    return float((label.answer == SECOND) == (label.return_second > label.return_first))
