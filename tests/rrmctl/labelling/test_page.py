"""The page in a browser, with a person who sees what it shows and presses its keys."""

import signal
import time
from collections import Counter

import pytest

from rrm.teachers.labels import live, read_labels
from rrm.teachers.published import read_session, session_path
from tests.browser import axe, browser
from tests.rrmctl.labelling.serving import serving
from tests.rrmctl.labelling.studies import make_study, run_id

#: Other tests may keep the machine busy.
_PATIENCE_MS = 90_000


@pytest.fixture(scope="module")
def chromium():
    with browser() as running:
        yield running


@pytest.fixture
def open_page(chromium):
    """A page at a link; whatever it complains of fails the test."""
    contexts, complaints = [], []

    def open_(server, link, **how):
        context = chromium.new_context(viewport={"width": 1280, "height": 800}, **how)
        context.set_default_timeout(_PATIENCE_MS)
        contexts.append(context)
        page = context.new_page()
        page.on("pageerror", lambda error: complaints.append(str(error)))
        page.goto(f"http://127.0.0.1:{server.port}/#{link}")
        return page

    yield open_
    for context in contexts:
        context.close()
    assert not complaints


def state(page, name):
    """Wait until the page is in it."""
    page.locator(f"body[data-state={name}]").wait_for()


def returns(page):
    """The full true returns of both clips, as the page knows them."""
    return [float(page.locator(f"#{side} + .return data").get_attribute("data-value")) for side in ("left", "right")]


def choose(page):
    """What the simulated person presses: the larger return, the left one where both are worth the same."""
    state(page, "question")
    left, right = returns(page)
    return "ArrowRight" if right > left else "ArrowLeft"


def press(page, key):
    """A key, once the pair is there, and wait until its answer is stored."""
    state(page, "question")
    with page.expect_response("**/api/answer") as told:
        page.keyboard.press(key)
    assert told.value.ok
    return told.value.json()


def rows_of(layout):
    return read_labels(layout.run(run_id(0)).labels)


@pytest.mark.slow
def test_a_person_answers(tmp_path, open_page):
    """Practice first, with what would have been right; every key; undo; what is chosen shows; the end is said."""
    layout = make_study(tmp_path / "results", queries=5)
    with serving(layout.root, "--grace", "1000") as server:
        page = open_page(server, server.link())
        state(page, "question")
        assert page.url == f"http://127.0.0.1:{server.port}/"  # without the link's secret
        for at in range(4):
            key = choose(page)
            assert press(page, key)["done"] == at + 1
            state(page, "feedback")
            side = "left" if key == "ArrowLeft" else "right"
            assert f"Yes, the {side} one" in page.locator("#status").inner_text()
            assert "chosen" in page.locator(f"#{side}").get_attribute("class")
            page.keyboard.press("Enter")
            page.locator("body:not([data-state=feedback])").wait_for()
        for key in ("ArrowRight", "ArrowLeft", "Space", "s"):
            press(page, key)
        state(page, "question")
        assert "4 of 5" in page.locator("#count").inner_text()
        page.keyboard.press("z")
        page.get_by_text("Undone.").wait_for()
        press(page, choose(page))
        press(page, choose(page))  # the pair that the undo had put off
        state(page, "wait")
        assert "You may close this page" in page.locator("#status").inner_text()
        page.keyboard.press("Backspace")
        press(page, "ArrowLeft")
        state(page, "wait")
    rows = rows_of(layout)
    assert [row.undone for row in rows] == [False] * 3 + [True, False, True, False]
    assert [row.answer for row in rows[2:4]] == [-1, -2]
    asked = {query.index: query for query in read_session(session_path(layout.run(run_id(0)).path, 1000)).queries}
    better = asked[rows[4].index]
    assert rows[4].answer == (1 if better.second.true_return > better.first.true_return else 0)
    for row, side in ((rows[0], "right"), (rows[1], "left")):
        assert row.answer == (row.shown_left if side == "left" else 1 - row.shown_left)
        assert row.input == "key"
        assert row.latency_ms > 0


@pytest.mark.slow
def test_an_undo_that_comes_late(tmp_path, open_page):
    """The page asks for pairs while it waits: the one that an undo gives back is shown by the undo alone."""
    layout = make_study(tmp_path / "results", queries=1)

    def late(route):
        reply = route.fetch()
        time.sleep(2)  # the page's own claim is answered meanwhile
        route.fulfill(response=reply)

    with serving(layout.root, "--no-practice", "--grace", "1000") as server:
        page = open_page(server, server.link())
        press(page, "ArrowLeft")
        state(page, "wait")
        page.route("**/api/undo", late)
        page.keyboard.press("z")
        assert press(page, "ArrowRight")["done"] == 1
        state(page, "wait")
        page.keyboard.press("z")
        page.get_by_text("Undone.").wait_for()
        page.keyboard.press("z")  # nothing is left to take back
        page.get_by_text("Not undone").wait_for()
        press(page, "ArrowRight")
        state(page, "wait")
    assert [row.undone for row in rows_of(layout)] == [True, True, False]


@pytest.mark.slow
def test_a_frame_that_began_before_its_pair_was_shown(tmp_path, open_page):
    """A busy browser draws it late: the clips start at their first frame all the same, and an answer at once counts."""
    layout = make_study(tmp_path / "results", queries=1)
    with serving(layout.root, "--no-practice") as server:
        page = open_page(server, server.link())
        state(page, "question")
        page.add_init_script(
            "const real = requestAnimationFrame; window.requestAnimationFrame = (tell) => real((at) => tell(at - 1e5));"
        )
        page.reload()
        state(page, "question")
        page.wait_for_timeout(200)  # some frames
        assert int(page.locator("#pair").get_attribute("data-frame")) >= 0
        press(page, "ArrowLeft")
    assert rows_of(layout)[0].loops >= 0


@pytest.mark.slow
def test_a_server_that_dies_in_the_middle_of_a_reply(tmp_path, open_page):
    """What it was asked is asked again: a clip, and a question."""
    layout = make_study(tmp_path / "results", queries=2)
    with serving(layout.root, "--no-practice", "--grace", "0") as server:
        page = open_page(server, server.link())
        state(page, "question")
        page.add_init_script(
            "const real = fetch, cut = new Set(['clips', 'claim']); window.fetch = async (path, ...how) => {"
            "  const reply = await real(path, ...how), kind = path.split('/').find((part) => cut.has(part));"
            "  if (cut.delete(kind)) for (const part of ['arrayBuffer', 'blob', 'json', 'text'])"
            "    reply[part] = () => Promise.reject(new TypeError('network error'));"
            "  return reply; };"
        )
        page.reload()
        press(page, "ArrowLeft")
        press(page, "ArrowRight")
    assert len(rows_of(layout)) == 2


@pytest.mark.slow
def test_what_the_server_does_not_understand(tmp_path, open_page):
    """It would not understand it the next time: the page says so once, and the pair is asked anew."""
    layout = make_study(tmp_path / "results", queries=1)
    with serving(layout.root, "--no-practice") as server:
        page = open_page(server, server.link())
        state(open_page(server, 300 * "a"), "gone")
        page.bring_to_front()  # a browser is idle behind another page
        state(page, "question")
        page.route("**/api/answer", lambda route: route.continue_(post_data="{}"), times=1)
        page.keyboard.press("ArrowLeft")
        page.get_by_text("Not counted: not what this server understands.").wait_for()
        press(page, "ArrowRight")
    assert [row.undone for row in rows_of(layout)] == [False]


@pytest.mark.slow
def test_what_is_no_answer(tmp_path, open_page):
    """A held key answers once, one with a modifier not at all, Space on a button presses that button alone; steps,
    speeds, pause and help answer nothing.
    """
    layout = make_study(tmp_path / "results", queries=4)
    with serving(layout.root, "--no-practice", "--no-hint") as server:
        page = open_page(server, server.link())
        state(page, "question")
        for key in ("Control+ArrowLeft", "Alt+ArrowLeft", "Meta+s", "p", ".", ",", "r", "1", "2", "3", "x", "Enter"):
            page.keyboard.press(key)
        page.keyboard.press("?")
        page.keyboard.press("ArrowLeft")  # in the dialog
        page.keyboard.press("Escape")
        page.locator("#pause").focus()
        page.keyboard.press("Space")
        page.locator("[name=speed]").first.focus()
        page.keyboard.press("ArrowRight")
        page.locator("body").click(position={"x": 2, "y": 2})
        assert page.locator("#left + .return").is_hidden()
        assert not layout.run(run_id(0)).labels.exists()
        with page.expect_response("**/api/answer"):
            for _ in range(15):
                page.keyboard.down("ArrowLeft")  # all but the first say that they repeat
        state(page, "question")
        page.keyboard.up("ArrowLeft")
        assert len(rows_of(layout)) == 1
        with page.expect_response("**/api/answer"):
            page.locator("#right").click()
        state(page, "question")
        assert page.locator("button:focus").count() == 0
    rows = rows_of(layout)
    assert [row.input for row in rows] == ["key", "pointer"]
    assert not any(row.return_shown for row in rows)


@pytest.mark.slow
def test_both_clips_show_one_moment(tmp_path, open_page):
    """Steps go through every frame, of both alike, and stop at either end."""
    layout = make_study(tmp_path / "results", queries=1, length=6)
    with serving(layout.root, "--no-practice") as server:
        page = open_page(server, server.link(), reduced_motion="reduce")
        state(page, "question")
        assert page.locator("#pause").inner_text().startswith("Play")  # who wants little motion starts it
        shown = []
        for _ in range(8):
            shown.append(int(page.locator("#pair").get_attribute("data-frame")))
            page.keyboard.press(".")
        assert shown == [0, 1, 2, 3, 4, 5, 6, 6]
        page.keyboard.press(",")
        assert page.locator("#pair").get_attribute("data-frame") == "5"


@pytest.mark.slow
def test_two_tabs_a_reload_and_a_closed_one(tmp_path, open_page):
    """The same pair again after a reload; another one in another tab; what a closed tab held is asked by the next."""
    layout = make_study(tmp_path / "results", queries=4)
    with serving(layout.root, "--no-practice") as server:
        page = open_page(server, server.link())
        state(page, "question")
        first = returns(page)
        page.reload()
        state(page, "question")
        assert returns(page) == first
        other = open_page(server, server.link())
        state(other, "question")
        assert returns(other) != first
        press(other, choose(other))
        press(page, choose(page))
        state(page, "question")
        again = page.context.new_page()  # without the key, which a tab keeps for itself
        again.goto(f"http://127.0.0.1:{server.port}/")
        state(again, "gone")
        assert "Open the link" in again.locator("#status").inner_text()
        state(other, "question")
    assert len({row.index for row in rows_of(layout)}) == 2
    with serving(layout.root, "--no-practice", "--grace", "0") as server:  # its leases are gone
        page = open_page(server, server.link())
        for _ in range(2):
            press(page, choose(page))
        server.hear("all answered")
    assert Counter(row.index for row in rows_of(layout)) == dict.fromkeys(range(4), 1)


@pytest.mark.slow
def test_a_lost_server(tmp_path, open_page):
    """Killed while the page is open: it says so, keeps what was pressed, and goes on by itself."""
    layout = make_study(tmp_path / "results", queries=3)
    with serving(layout.root, "--no-practice") as server:
        page = open_page(server, server.link())
        press(page, choose(page))
        chosen = choose(page)
        server.end(signal.SIGKILL)
        page.keyboard.press(chosen)
        state(page, "lost")
        assert "Nothing is lost" in page.locator("#status").inner_text()
    with serving(layout.root, "--no-practice", "--grace", "0", port=server.port) as server:
        state(page, "question")
        press(page, choose(page))
        server.hear("all answered")
    assert Counter(row.index for row in rows_of(layout)) == dict.fromkeys(range(3), 1)


@pytest.mark.slow
def test_forty_pairs(tmp_path, open_page):
    """As the scripted teacher would answer them."""
    layout = make_study(tmp_path / "results", queries=40)
    with serving(layout.root, "--no-practice", "--grace", "0") as server:
        page = open_page(server, server.link())
        for _ in range(40):
            press(page, choose(page))
        server.hear("all answered")
    rows = live(rows_of(layout))
    for asked in read_session(session_path(layout.run(run_id(0)).path, 1000)).queries:
        first, second = asked.first.true_return, asked.second.true_return
        assert first == second or rows[1000, asked.index].answer == int(second > first)


@pytest.mark.slow
@pytest.mark.parametrize("theme", ["light", "dark"])
@pytest.mark.parametrize("width", [390, 1280])
def test_its_size(tmp_path, open_page, theme, width):
    """Nothing goes over the edge, and every button is large enough for a finger."""
    layout = make_study(tmp_path / "results", queries=1)
    with serving(layout.root, "--no-practice") as server:
        page = open_page(server, server.link(), color_scheme=theme)
        page.set_viewport_size({"width": width, "height": 800})
        state(page, "question")
        assert page.evaluate("() => document.documentElement.scrollWidth") <= width
        for button in page.locator("main button:visible").all():
            box = button.bounding_box()
            assert min(box["width"], box["height"]) >= 44


@pytest.mark.slow
@pytest.mark.parametrize("theme", ["light", "dark"])
def test_axe_finds_nothing(tmp_path, open_page, theme):
    """Neither in practice, nor with what would have been right, nor in a question, its help, or while nothing is
    asked.
    """
    layout = make_study(tmp_path / "results", queries=1)
    with serving(layout.root) as server:
        page = open_page(server, server.link(), color_scheme=theme, bypass_csp=True)
        page.add_script_tag(content=axe())

        def violations():
            found = page.evaluate("async () => (await axe.run()).violations")
            return [(each["id"], [node["html"] for node in each["nodes"]]) for each in found]

        for _ in range(4):
            state(page, "question")
            found = violations()
            press(page, choose(page))
            state(page, "feedback")
            assert found + violations() == []
            page.keyboard.press("Enter")
        state(page, "question")
        page.keyboard.press("?")
        found = violations()
        page.keyboard.press("Escape")
        assert found + violations() == []
        press(page, "s")
        state(page, "wait")
        assert violations() == []


@pytest.mark.slow
def test_it_cannot_be_framed(tmp_path, open_page, chromium):
    """Nor is it found under another name of this machine's."""
    layout = make_study(tmp_path / "results", queries=1)
    with serving(layout.root, "--no-practice") as server:
        server.link()
        page = chromium.new_page()
        page.set_content(f'<iframe src="http://127.0.0.1:{server.port}/"></iframe>')
        page.wait_for_load_state("networkidle")
        assert not any("127.0.0.1" in frame.url for frame in page.frames)
        page.close()
