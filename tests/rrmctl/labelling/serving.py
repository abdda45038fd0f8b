"""A real server of a study in a process of its own, and people who talk to it over HTTP."""

from __future__ import annotations

import contextlib
import http.client
import json
import queue
import re
import signal
import subprocess
import sys
import threading
import time

from rrm.environ import environment
from tests.rrmctl.labelling.studies import NAME

PATIENCE_S = 60
_END = "(its output ends)"


class Server:
    """`rrmctl label`, as typed."""

    def __init__(self, root, *options, port=0, name=NAME, env=None):
        command = [sys.executable, "-m", "rrmctl", "label", name, "--results", str(root), "--port", str(port), *options]
        self.process = subprocess.Popen(
            command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, env=env or environment()
        )
        self.lines, self.said = queue.Queue(), []
        self.reader = threading.Thread(target=self._read)
        self.reader.start()

    def _read(self):
        for line in self.process.stdout:
            self.lines.put(line.rstrip())
        self.lines.put(_END)

    def hear(self, pattern):
        """The first line from now on that holds this."""
        while (line := self.lines.get(timeout=PATIENCE_S)) != _END:
            self.said.append(line)
            if found := re.search(pattern, line):
                return found
        raise AssertionError(f"ended without {pattern!r}: {self.said}")

    def link(self, person="person-1"):
        """The secret of a person's link; the server's port is known from here on."""
        found = self.hear(rf"{person}.*: http://([^:]+):(\d+)/#(\S+)")
        self.port = int(found[2])
        return found[3]

    def person(self, name="person-1"):
        """A page at the person's link."""
        link = self.link(name)
        return Person(self.port, link)

    def end(self, number=signal.SIGTERM):
        self.process.send_signal(number)
        return self.wait()

    def wait(self):
        code = self.process.wait(timeout=PATIENCE_S)
        self.reader.join()
        self.process.stdout.close()
        while not self.lines.empty():
            self.said.append(self.lines.get())
        return code


@contextlib.contextmanager
def serving(root, *options, **how):
    server = Server(root, *options, **how)
    try:
        yield server
    finally:
        server.process.kill()
        server.wait()


class Person:
    """One page, without a browser."""

    def __init__(self, port, link):
        self.port = port
        status, told = self.post("session", {"token": link}, key="")
        assert status == 200, told
        self.key = told["key"]

    def post(self, name, body, key=None):
        return request(self.port, "POST", f"/api/{name}", json.dumps(body), key=self.key if key is None else key)

    def claim(self, held=(), patient=False):
        status, told = self.post("claim", {"held": list(held), "patient": patient})
        assert status == 200, told
        return told

    def question(self):
        """The next one, which comes."""
        deadline = time.monotonic() + PATIENCE_S
        while (told := self.claim())["state"] == "wait":
            assert time.monotonic() < deadline, told
            time.sleep(0.02)
        return told

    def see(self, clip):
        """A clip, once it is drawn."""
        while (got := request(self.port, "GET", f"/clips/{clip}.webp", key=self.key))[0] == 503:
            pass
        return got

    def answer(self, told, chosen=None):
        """As the scripted teacher would, the left one where both are worth the same."""
        better = "right" if told["returns"][1] > told["returns"][0] else "left"
        facts = {"latency_ms": 700.0, "loops": 1.0, "speed": 1.0, "input": "key"}
        return self.post("answer", {"claim": told["claim"], "chosen": chosen or better, **facts})


def request(port, method, path, body=None, key="", **headers):
    """Status and content of an answer. Headers by name, _ for -; None leaves one out."""
    sent = {"Authorization": f"Bearer {key}"}
    if method == "POST":
        sent |= {"Content-Type": "application/json", "Origin": f"http://127.0.0.1:{port}"}
    for name, value in headers.items():
        sent[name.replace("_", "-").title()] = value
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=PATIENCE_S)
    try:
        connection.request(method, path, body, {name: value for name, value in sent.items() if value is not None})
        answer = connection.getresponse()
        data = answer.read()
        return answer.status, json.loads(data) if answer.headers.get_content_type() == "application/json" else data
    finally:
        connection.close()
