"""Who may answer: a person's link opens one page, once, and gives it a key that it keeps."""

from __future__ import annotations

import hashlib
import json
import secrets
from collections.abc import Sequence
from pathlib import Path

from rrm.files import make_folder, replace
from rrmctl.labelling.question import Sitting


class Keys:
    """Links that were not opened yet, in memory alone, and digests of the keys that were given out, in a file."""

    def __init__(self, path: Path, people: Sequence[str]) -> None:
        self._path, self._people = path, people
        self._links = {name: secrets.token_urlsafe(24) for name in people}
        try:
            kept = json.loads(path.read_bytes())
            self._known = {str(digest): str(name) for digest, name in kept.items()}
        except (OSError, ValueError, AttributeError):  # none yet, or damaged: people take a new link
            self._known = {}

    def link(self, person: str) -> str:
        """The secret of a person's next link."""
        return self._links[person]

    def exchange(self, link: str) -> tuple[str, str] | None:
        """A new key for a link, with whose it is; None for one that was opened already, or never made."""
        for person, secret in self._links.items():
            if secrets.compare_digest(secret.encode(), link.encode()):
                key = secrets.token_urlsafe(32)
                self._known[_digest(key)] = person
                self._keep()
                self._links[person] = secrets.token_urlsafe(24)
                return key, person
        return None

    def sitting(self, key: str) -> Sitting | None:
        """The page that a key is of, if its person is still asked."""
        digest = _digest(key)
        person = self._known.get(digest)
        return Sitting(person, digest) if person is not None and person in self._people else None

    def _keep(self) -> None:
        make_folder(self._path.parent)
        self._path.touch(mode=0o600)
        replace(self._path, json.dumps(self._known).encode(), durably=True)
        self._path.chmod(0o600)


def _digest(key: str) -> str:
    return hashlib.sha256(key.encode()).hexdigest()
