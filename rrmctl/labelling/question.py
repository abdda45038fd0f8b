"""What people are asked, and how: rules, a person at a page, a question, a claim to it, and what is said to it."""

from __future__ import annotations

import hashlib
import hmac
import json
from dataclasses import dataclass
from typing import Literal, NamedTuple

from rrm.teachers.labels import EQUAL, FIRST, SECOND, SKIPPED, TRAIN, Label
from rrm.teachers.published import PublishedQuery, PublishedSession

#: What stands for a question, or for a session.
Key = tuple[str, ...]


@dataclass(frozen=True, kw_only=True)
class Rules:
    """How a study is put before its people."""

    people: tuple[str, ...]
    assign: Literal["run", "query"] = "run"  #: one person answers all of a run, or anybody anything
    grace_s: float = 30.0
    repeat: float = 0.0  #: share of a person's pairs that are asked again, sides changed
    hint: bool = True  #: whether the true returns are shown


class Sitting(NamedTuple):
    """One page of a person."""

    annotator: str
    secret: str  #: digest of the page's key

    @property
    def id(self) -> str:
        """What stands in the rows."""
        return hashlib.sha256(f"session {self.secret}".encode()).hexdigest()[:16]


class Question(NamedTuple):
    """A published query, and what it is for."""

    session: PublishedSession
    query: PublishedQuery
    purpose: str

    def key(self, annotator: str) -> Key:
        """What one answer is enough for: of a run's query by anybody, of others by each person."""
        place = (self.session.run, str(self.session.step), str(self.query.index), self.query.query)
        return (self.purpose, "" if self.purpose == TRAIN else annotator, *place)


class Claim(NamedTuple):
    """A question that is before a person."""

    id: str
    question: Question
    left: int  #: which segment stands on the left


class Given(NamedTuple):
    """What a page says of an answer."""

    chosen: Literal["left", "right", "equal", "skip"]
    latency_ms: float
    loops: float
    speed: float
    input: str


def meant(given: Given, left: int) -> int:
    """What an answer says of the segments, one of which stood on the left."""
    return {"left": left, "right": FIRST + SECOND - left, "equal": EQUAL, "skip": SKIPPED}[given.chosen]


def session_of(row: Label) -> Key:
    """The session that a row belongs to."""
    return (row.run, str(row.step))


def key_of(row: Label) -> Key:
    """The `Question.key` that a row answers."""
    place = (row.run, str(row.step), str(row.index), row.query)
    return (row.purpose, "" if row.purpose == TRAIN else row.annotator, *place)


def claim_name(sitting: Sitting, key: Key, turn: int) -> str:
    """What a page's claim to a question is called, after so many answers to it. Nobody else can guess it."""
    return hmac.new(sitting.secret.encode(), json.dumps([*key, turn]).encode(), hashlib.sha256).hexdigest()[:32]
