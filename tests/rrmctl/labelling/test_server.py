"""The server as typed, with people who talk to it over HTTP: nothing is lost, nothing doubled, one message each."""

import contextlib
import http.client
import json
import os
import random
import signal
import subprocess
import sys
import threading
from collections import Counter

import pytest

from rrm.environ import environment
from rrm.teachers.labels import PRACTICE, SHARED, TRAIN, live, read_labels
from rrm.teachers.published import read_episodes, read_session, session_path
from tests.rrmctl.labelling.serving import Person, Server, request, serving
from tests.rrmctl.labelling.studies import NAME, end, make_study, publish_session, run_id


def refused(root, *options, name=NAME):
    """Exit code and words of a server that does not come up."""
    command = [sys.executable, "-m", "rrmctl", "label", name, "--results", str(root), "--port", "0", *options]
    done = subprocess.run(command, capture_output=True, text=True, env=environment(), timeout=60, check=False)
    return done.returncode, done.stderr


def label(person, count):
    """Answer so many questions."""
    said = []
    for _ in range(count):
        told = person.question()
        for clip in told["clips"]:
            assert person.see(clip)[0] == 200
        status, answer = person.answer(told)
        assert status == 200, answer
        said.append((told, answer))
    return said


@pytest.mark.slow
def test_a_session_from_its_link_to_its_seal(tmp_path):
    """Practice with what would have been right, the questions, the seal; then the next session; then the end."""
    layout = make_study(tmp_path / "results", queries=4)
    with serving(layout.root, "--grace", "0") as server:
        person = server.person()
        said = label(person, 8)
        practice = [answer for told, answer in said if told["practice"]]
        assert [told["of"] for told, _ in said] == [4] * 8
        assert {answer["better"] for answer in practice} <= {"left", "right"}
        assert all(answer["better"] is None for told, answer in said if not told["practice"])
        server.hear("all answered: toy-car pebble.*before step 1,000")
        labels = live(read_labels(layout.run(run_id(0)).labels))
        session = read_session(session_path(layout.run(run_id(0)).path, 1000))
        for asked in session.queries:
            row = labels[1000, asked.index]
            assert row.sealed
            assert row.query == asked.query
            better = 1 if asked.second.true_return > asked.first.true_return else 0
            assert row.answer == better
            assert row.camera
        extra = read_labels(layout.extra_labels)
        assert [(row.purpose, row.run) for row in extra] == [(PRACTICE, "")] * 4
        assert all((row.answer == 1) == (row.return_second > row.return_first) for row in extra)

        publish_session(layout, run_id(0), 2000, 2, seed=5, first=4)
        label(person, 2)
        end(layout, run_id(0))
        assert server.wait() == 0
        assert "every run has ended; 10 answers are stored" in server.said[-2]


@pytest.mark.slow
def test_clips_are_drawn_as_they_were_lived(tmp_path):
    """A sprite has a frame for every moment; it is the same for the same segment, and only its page may see it."""
    import cv2
    import numpy as np

    from rrm.envs import make

    layout = make_study(tmp_path / "results", queries=1, length=10)
    with serving(layout.root, "--no-practice") as server:
        person = server.person()
        told = person.question()
        status, webp = request(server.port, "GET", f"/clips/{told['clips'][0]}.webp", key=person.key)
        assert status == 200
        assert request(server.port, "GET", f"/clips/{told['clips'][0]}.webp", key="x")[0] == 401
    sheet = cv2.imdecode(np.frombuffer(webp, np.uint8), cv2.IMREAD_COLOR)[..., ::-1]
    path = session_path(layout.run(run_id(0)).path, 1000)
    [asked] = read_session(path).queries
    shown = next(each for each in (asked.first, asked.second) if each.id == told["clips"][0])
    episode = read_episodes(path)[shown.episode]
    env = make("toy-car", render_mode="rgb_array")
    env.load_state_dict(episode.start)
    pictures = [env.render()]
    for act in episode.act[: shown.begin + 10]:
        env.step(act)
        pictures.append(env.render())
    for at, picture in enumerate(pictures[shown.begin :]):
        row, column = divmod(at, 8)
        cell = sheet[row * 336 :][8:328, column * 336 :][:, 8:328]
        assert np.abs(cell.astype(int) - picture).mean() < 3, at
    assert np.abs(sheet[:8, :336].astype(int) - sheet[8, :336]).mean() < 3  # its edge goes on beyond it


@pytest.mark.slow
def test_what_would_not_be_shown_as_it_was(tmp_path):
    """Said once, never shown, waited for; and with --skip-unshown counted as skipped."""
    layout = make_study(tmp_path / "results", queries=2)
    path = session_path(layout.run(run_id(0)).path, 1000)
    session, episodes = read_session(path), read_episodes(path)
    broken = session.queries[0].first.episode
    kept = {each.index for each in session.queries if broken not in (each.first.episode, each.second.episode)}
    episodes[broken].obs[:] += 1
    from rrm.teachers.published import publish

    publish(layout.run(run_id(0)).path, session, episodes)
    with serving(layout.root, "--no-practice", "--grace", "0") as server:
        person = server.person()
        server.hear("cannot be shown: lived again, the episode differs from step")
        while (told := person.claim())["state"] != "wait" or told["unshown"] < 2 - len(kept):
            if told["state"] == "question" and {person.see(clip)[0] for clip in told["clips"]} == {200}:
                person.answer(told)
    assert not any(row.sealed for row in read_labels(layout.run(run_id(0)).labels))
    with serving(layout.root, "--no-practice", "--grace", "0", "--skip-unshown") as server:
        server.hear("all answered")
    rows = live(read_labels(layout.run(run_id(0)).labels))
    assert {index for (_, index), row in rows.items() if row.answer == -2 and row.input == "unshown"} == {0, 1} - kept


@pytest.mark.slow
@pytest.mark.parametrize("when", ["answering", "after the last answer"])
def test_a_killed_server_goes_on_where_it_was(tmp_path, when):
    """On the same port, with the same pages, and what it had not sealed it seals."""
    layout = make_study(tmp_path / "results", queries=6)
    options = ("--no-practice", "--grace", "0" if when == "answering" else "1.5")
    with serving(layout.root, *options) as server:
        person = server.person()
        for _ in range(3):
            assert person.answer(person.question())[0] == 200
        told = person.question()
        if when != "answering":
            person.answer(told)
            label(person, 2)
        server.end(signal.SIGKILL)
    with serving(layout.root, *options, port=server.port) as server:
        server.link()
        if when == "answering":
            assert person.answer(told)[0] == 200  # the key pressed meanwhile
            assert person.answer(told)[0] == 200  # and sent again
            label(person, 2)
        server.hear("all answered")
    rows = read_labels(layout.run(run_id(0)).labels)
    assert Counter(row.index for row in rows) == dict.fromkeys(range(6), 1)
    assert all(row.sealed for row in rows)


@pytest.mark.slow
def test_a_killed_renderer_is_started_anew(tmp_path):
    """And its clip is drawn."""
    layout = make_study(tmp_path / "results", queries=20)
    with serving(layout.root, "--no-practice") as server:
        person = server.person()
        ended = 0
        for told in (person.question() for _ in range(20)):
            for child in children(server.process.pid):
                with contextlib.suppress(ProcessLookupError):  # it had just left
                    os.kill(child, signal.SIGKILL)
                    ended += 1
            assert [person.see(clip)[0] for clip in told["clips"]] == [200, 200]
            person.answer(told)
            if ended > 3:
                break
    assert ended > 3


def children(pid):
    found = subprocess.run(["pgrep", "-P", str(pid)], capture_output=True, text=True, check=False)
    return [int(child) for child in found.stdout.split()]


@pytest.mark.slow
def test_without_opengl(tmp_path, no_opengl):
    """The page and the terminal say what to install; questions wait."""
    layout = make_study(tmp_path / "results", queries=1, name="toy-car")
    publish_session(layout, run_id(0), 1000, 1, name="window-open", length=3)
    with serving(layout.root, "--no-practice", env=environment(no_opengl)) as server:
        person = server.person()
        server.hear("nothing here draws pictures with OpenGL .*apt-get install libegl1")
        told = person.claim()
        assert told["state"] == "trouble"
        assert "apt-get install libegl1" in told["message"]


@pytest.mark.slow
def test_what_cannot_be_served(tmp_path):
    """One line each, exit code 2."""
    code, said = refused(tmp_path / "nothing")
    assert (code, "there is no results folder" in said) == (2, True)
    layout = make_study(tmp_path / "results")
    code, said = refused(layout.root, name="other")
    assert (code, "holds no runs of" in said) == (2, True)
    code, said = refused(layout.root, "--host", "0.0.0.0")
    assert (code, "name the one by which people reach this machine" in said) == (2, True)
    code, said = refused(layout.root, "--host", "192.0.2.1")
    assert (code, "cannot listen at 192.0.2.1:0" in said) == (2, True)
    code, said = refused(layout.root, "--annotator", "a\x07b")
    assert (code, "is no name for a table" in said) == (2, True)
    with serving(layout.root) as server:
        server.link()
        code, said = refused(layout.root)
        assert (code, f"another `rrmctl label NAME` serves {layout.root} already" in said) == (2, True)
        code, said = refused(make_study(tmp_path / "second").root, "--port", str(server.port))
        assert (code, "--port 0 takes any port that is free" in said) == (2, True)


def test_a_study_of_no_people(tmp_path):
    """Runs of scripted teachers have nothing to ask."""
    layout = make_study(tmp_path / "results")
    path = layout.sweep(NAME, "smoke")
    text = path.read_text()
    body = json.loads(text)
    del body["checksum"]
    body["jobs"][0]["teacher"] = "oracle"
    path.write_text(json.dumps(body))
    code, said = refused(layout.root)
    assert (code, "is taught by people" in said) == (2, True)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_leaving_at_once(tmp_path, number):
    """While a page waits for its question: exit code 75, and no traceback."""
    layout = make_study(tmp_path / "results", steps=())
    with serving(layout.root, "--no-practice") as server:
        person = server.person()
        assert person.claim()["state"] == "wait"

        def wait():
            with contextlib.suppress(OSError, http.client.HTTPException):
                person.claim(patient=True)

        waiting = threading.Thread(target=wait)
        waiting.start()
        assert server.end(number) == 75
        waiting.join()
        assert "Not complete: the same command goes on." in server.said
        assert not any("Traceback" in line for line in server.said)
        assert not list((layout.root / "labels").rglob("*.webp"))


def test_a_full_disk(tmp_path):
    """The page is told that the answer is not stored; once there is room it is, and once."""
    layout = make_study(tmp_path / "results", queries=1)
    with serving(layout.root, "--no-practice", "--grace", "0") as server:
        person = server.person()
        told = person.question()
        labels = layout.run(run_id(0)).labels
        labels.mkdir()  # what stands in the way of the file
        (labels / "x").touch()
        status, answer = person.answer(told)
        assert (status, "the answer could not be stored" in answer["message"]) == (507, True)
        (labels / "x").unlink()
        labels.rmdir()
        assert person.answer(told)[0] == 200
        server.hear("all answered")


@pytest.mark.slow
def test_undo_over_the_wire(tmp_path):
    """The pair comes back, also to a page that does not know what it said, until it counts."""
    layout = make_study(tmp_path / "results", queries=2)
    with serving(layout.root, "--no-practice", "--grace", "1000") as server:
        person = server.person()
        told = person.question()
        person.answer(told, "skip")
        status, back = person.post("undo", {"claim": told["claim"]})
        assert (status, back["clips"]) == (200, told["clips"])
        assert back["claim"] != told["claim"]
        assert person.answer(back, "equal")[0] == 200
        assert person.post("undo", {})[1]["clips"] == told["clips"]
    rows = read_labels(layout.run(run_id(0)).labels)
    assert [(row.answer, row.undone) for row in rows] == [(-2, True), (-1, True)]


@pytest.mark.slow
def test_shared_and_repeated_pairs(tmp_path):
    """Everybody answers the same pairs first; a share of their own comes again; neither trains."""
    layout = make_study(tmp_path / "results", runs=2, queries=20)
    people = "--annotator", "ann,ben"
    with serving(layout.root, "--no-practice", *people, "--shared", "3", "--repeat", "10", "--grace", "0") as server:
        links = [server.link("ann"), server.link("ben")]
        for person in [Person(server.port, link) for link in links]:
            label(person, 3 + 20 + 2)
    shared = [row for row in read_labels(layout.extra_labels) if row.purpose == SHARED]
    assert Counter(row.annotator for row in shared) == {"ann": 3, "ben": 3}
    assert len({row.query for row in shared}) == 3
    for run in (run_id(0), run_id(1)):
        rows = read_labels(layout.run(run).labels)
        assert Counter(row.purpose for row in rows)[TRAIN] == 20
        assert len({row.annotator for row in rows}) == 1
        assert sum(row.purpose == "repeat" for row in rows) == 2


@pytest.mark.slow
@pytest.mark.long
def test_a_thousand_answers_by_four_people(tmp_path):
    """At once, with undone and skipped ones, while servers are killed: each question ends with one answer."""
    layout = make_study(tmp_path / "results", runs=10, queries=100)
    people = ("a", "b", "c", "d")
    options = ("--no-practice", "--grace", "0.2", "--annotator", ",".join(people), "--assign", "query")
    server = Server(layout.root, *options)
    port, lock = None, threading.Event()
    links = {}
    for person in people:
        links[person] = server.link(person)
    port = server.port
    failed = []

    def work(name):
        rng, person = random.Random(name), Person(port, links[name])
        told = {}
        while told.get("state") != "over":
            try:
                told = person.claim()
                if told["state"] == "question":
                    claim = told["claim"]
                    status, _ = person.answer(told, rng.choice(["left", "right", "equal", "skip", None]))
                    if status == 200 and rng.random() < 0.05:
                        person.post("undo", {"claim": claim})
                elif lock.wait(0.05):
                    return
            except (OSError, http.client.HTTPException, json.JSONDecodeError):
                lock.wait(0.05)  # the server is away, perhaps in the middle of an answer
            except Exception as error:
                failed.append(error)
                raise

    threads = [threading.Thread(target=work, args=(name,)) for name in people]
    for thread in threads:
        thread.start()
    layout_rows = lambda: [row for at in range(10) for row in read_labels(layout.run(run_id(at)).labels)]  # noqa: E731
    for share in (200, 500, 800):
        while sum(not row.undone for row in layout_rows()) < share and any(map(threading.Thread.is_alive, threads)):
            lock.wait(0.1)
        server.end(signal.SIGKILL)
        server = Server(layout.root, *options, port=port)
        server.link("d")
    while sum(row.sealed for row in layout_rows()) < 1000 and any(map(threading.Thread.is_alive, threads)):
        lock.wait(0.2)
    lock.set()
    for thread in threads:
        thread.join()
    server.end(signal.SIGKILL)
    assert failed == []
    rows = layout_rows()
    assert Counter((row.run, row.index) for row in rows if not row.undone) == {
        (run_id(at), index): 1 for at in range(10) for index in range(100)
    }
    assert len({row.annotator for row in rows}) == 4
