"""A person who answers like the scripted teacher, straight through the files, in place of the page and its server."""

import dataclasses
import itertools

from rrm.teachers.labels import FILE, FIRST, SECOND, TRAIN, Label, live, read_labels, write_labels
from rrm.teachers.published import published_steps, read_session, session_path


def label(session, query, answer, *, annotator="a", at=0.0, **fields):
    """A row about a published query."""
    return Label(
        run=session.run, step=session.step, index=query.index, query=query.query,
        first=query.first.id, second=query.second.id, answer=answer, shown_left=FIRST,
        return_first=query.first.true_return, return_second=query.second.true_return, return_shown=False,
        annotator=annotator, purpose=TRAIN, latency_ms=1000.0, loops=1.0, speed=1.0, input="key",
        shown_at=at, at=at, **fields,
    )  # fmt: skip


def preferred(query):
    """The scripted teacher's answer."""
    return SECOND if query.first.true_return < query.second.true_return else FIRST


def answer(folder, choose=preferred, *, most=None, seal=True, **fields):
    """Answer what is open in a run's folder, so many queries at most, and seal it; how many were answered."""
    labels, told = read_labels(folder / FILE), 0
    for session in (read_session(session_path(folder, step)) for step in published_steps(folder)):
        there = live(labels)
        left = [query for query in session.queries if (session.step, query.index) not in there]
        for query in itertools.islice(left, most):
            labels.append(label(session, query, choose(query), at=float(len(labels)), **fields))
            told += 1
    if told:
        write_labels(folder / FILE, labels)
    return told + (sealed(folder) if seal else 0)


def sealed(folder):
    """Seal every session all of whose queries are answered, as the server does; how many rows that were open."""
    labels = read_labels(folder / FILE)
    done, there = set(), live(labels)
    for session in (read_session(session_path(folder, step)) for step in published_steps(folder)):
        if all((session.step, query.index) in there for query in session.queries):
            done.add(session.step)
    new = [each for (step, _), each in there.items() if step in done and not each.sealed]
    if new:
        write_labels(folder / FILE, [dataclasses.replace(e, sealed=True) if e in new else e for e in labels])
    return len(new)
