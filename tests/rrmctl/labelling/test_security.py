"""What the server keeps out, each by a request to a real one."""

import socket
import stat

import pytest

from tests.rrmctl.labelling.serving import Person, request, serving
from tests.rrmctl.labelling.studies import make_study


@pytest.fixture(scope="module")
def root(tmp_path_factory):
    folder = tmp_path_factory.mktemp("study") / "results"
    make_study(folder, queries=3)
    return folder


@pytest.fixture(scope="module")
def server(root):
    with serving(root, "--no-practice", "--annotator", "ann,ben") as running:
        running.first = running.link("ann")
        running.second = running.link("ben")
        running.ann = Person(running.port, running.first)
        yield running


def raw(port, text):
    """The status of what the server answers to these bytes."""
    with socket.create_connection(("127.0.0.1", port), timeout=30) as connection:
        connection.sendall(text)
        return int(connection.makefile("rb").readline().split()[1])


@pytest.mark.parametrize("host", ["evil.example", "evil.example:{port}", "127.0.0.1.evil.example", ""])
def test_another_name_of_this_machine(server, host):
    """DNS rebinding: a page of elsewhere that had its name point here is not answered."""
    host = host.format(port=server.port)
    assert raw(server.port, f"GET / HTTP/1.1\r\nHost: {host}\r\nConnection: close\r\n\r\n".encode()) == 400


@pytest.mark.parametrize("host", ["127.0.0.1", "localhost:1234"])
def test_its_own_names_at_any_port(server, host):
    """As seen through `ssh -L`."""
    assert raw(server.port, f"GET / HTTP/1.1\r\nHost: {host}\r\nConnection: close\r\n\r\n".encode()) == 200


@pytest.mark.parametrize(
    "origin", [None, "null", "http://evil.example", "https://127.0.0.1:{port}", "http://127.0.0.1:1"]
)
def test_a_request_of_another_page(server, origin):
    """CSRF: whatever it asks."""
    origin = origin and origin.format(port=server.port)
    for name in ("session", "claim", "answer", "undo", "renew"):
        assert request(server.port, "POST", f"/api/{name}", "{}", key=server.ann.key, origin=origin)[0] == 403


@pytest.mark.parametrize("kind", [None, "text/plain", "application/x-www-form-urlencoded", "multipart/form-data"])
def test_what_a_form_can_send(server, kind):
    """JSON alone, which no form sends."""
    assert request(server.port, "POST", "/api/claim", "{}", key=server.ann.key, content_type=kind)[0] == 415


def test_a_link_opens_one_page(server):
    """The second use is refused; the new one that is printed then opens the next page."""
    status, told = request(server.port, "POST", "/api/session", f'{{"token": "{server.first}"}}')
    assert (status, told["message"]) == (403, "this link was opened already: take the new one that the server printed")
    Person(server.port, server.link("ann"))


@pytest.mark.parametrize("key", ["", "x", "\u00e9", "a" * 2000])
def test_without_a_key(server, key):
    """Nothing but the page itself."""
    for name in ("claim", "answer", "undo", "renew"):
        assert request(server.port, "POST", f"/api/{name}", "{}", key=key.encode())[0] in (401, 422)
        assert request(server.port, "POST", f"/api/{name}", "{}", key=None, authorization=None)[0] == 401
    assert (
        request(server.port, "GET", "/clips/0123456789abcdef.webp", authorization=f"Basic {server.ann.key}")[0] == 401
    )


def test_no_secret_is_kept(server, root):
    """Of keys and links the store has digests alone, for its owner; the server prints links, and no key."""
    told = "\n".join(server.said)
    for path in (path for path in root.rglob("*") if path.is_file()):
        content = path.read_bytes()
        assert not any(secret.encode() in content for secret in (server.ann.key, server.first, server.second)), path
    assert server.ann.key not in told
    keys = root / "labels" / "keys.json"
    assert stat.S_IMODE(keys.stat().st_mode) == 0o600


def test_what_browsers_are_told(server):
    """On every answer, errors included; and no cookie, which a server at another port would be sent as well."""
    for path, host in (("/", "127.0.0.1"), ("/page.js", "127.0.0.1"), ("/nothing", "127.0.0.1"), ("/", "evil.example")):
        with socket.create_connection(("127.0.0.1", server.port), timeout=30) as connection:
            connection.sendall(f"GET {path} HTTP/1.1\r\nHost: {host}\r\nConnection: close\r\n\r\n".encode())
            head = connection.makefile("rb").read().split(b"\r\n\r\n")[0].decode().lower()
        for line in (
            *("default-src 'none'", "frame-ancestors 'none'", "x-content-type-options: nosniff"),
            *("cross-origin-opener-policy: same-origin", "cross-origin-resource-policy: same-origin"),
        ):
            assert line in head, (path, line)
        assert "set-cookie" not in head
        assert "unsafe" not in head
        assert "access-control" not in head
        assert "server:" not in head


_ELSEWHERE = (
    *("..%2f..%2fconfig.json", "../labels/keys.json", "%2e%2e/keys.json", "....//keys.json"),
    *("0123456789ABCDEF.webp", "0123456789abcde.webp", "0123456789abcdef.webp%00", "0123456789abcdef"),
)


@pytest.mark.parametrize("name", _ELSEWHERE)
def test_no_way_to_other_files(server, name):
    """Clips are named by sixteen hex digits, and nothing else is."""
    assert request(server.port, "GET", f"/clips/{name}", key=server.ann.key)[0] == 404
    assert request(server.port, "GET", f"/{name}", key=server.ann.key)[0] == 404


def test_how_much_is_read(server):
    """No more than four kilobytes, whose number is said before; heads of requests are bounded likewise."""
    post = f"POST /api/claim HTTP/1.1\r\nHost: 127.0.0.1:{server.port}\r\nOrigin: http://127.0.0.1:{server.port}\r\n"
    post += f"Authorization: Bearer {server.ann.key}\r\nContent-Type: application/json\r\nConnection: close\r\n"
    assert raw(server.port, f"{post}Content-Length: 5000\r\n\r\n".encode() + b" " * 5000) == 413
    assert raw(server.port, f"{post}Transfer-Encoding: chunked\r\n\r\n2\r\n{{}}\r\n0\r\n\r\n".encode()) == 413
    assert raw(server.port, f"{post}\r\n".encode()) == 413
    assert raw(server.port, f"{post}Content-Length: -1\r\n\r\n".encode()) in (400, 413)
    for length in (20_000, 200_000):
        head = f"{post}X-Long: {'a' * length}\r\nContent-Length: 2\r\n\r\n{{}}"
        assert raw(server.port, head.encode()) in (400, 431)


GOOD = {"chosen": "left", "latency_ms": 1.0, "loops": 1.0, "speed": 1.0, "input": "key"}


@pytest.mark.parametrize("change", [
    {"claim": "x"}, {"chosen": "up"}, {"chosen": 1}, {"latency_ms": -1.0}, {"latency_ms": 1e400}, {"latency_ms": "1"},
    {"speed": 0.0}, {"input": "else"}, {"annotator": "ben"}, {"run": "0" * 16}, {"loops": None},
])  # fmt: skip
def test_what_is_no_answer(server, change):
    """Of another form, or saying whose it is or what of: the server knows that itself."""
    told = server.ann.question()
    assert server.ann.post("answer", {"claim": told["claim"], **GOOD, **change})[0] == 422


@pytest.mark.parametrize("body", ["", "[]", "nul", '"text"', "[" * 4000, "\ud83d".encode("utf-16", "surrogatepass")])
def test_what_is_no_json(server, body):
    """Refused in one word."""
    assert request(server.port, "POST", "/api/claim", body, key=server.ann.key)[0] == 422


def test_somebody_elses_claim(server):
    """Is nobody's but its page's; a guessed one is none."""
    told, ben = server.ann.question(), Person(server.port, server.second)
    assert ben.post("answer", {"claim": told["claim"], **GOOD})[0] == 409
    assert server.ann.post("answer", {"claim": "0" * 32, **GOOD})[0] == 409
    assert ben.post("undo", {"claim": told["claim"]})[0] == 409
    assert ben.post("renew", {"held": [told["claim"]]}) == (200, {"held": []})


@pytest.mark.parametrize("method", ["GET", "PUT", "DELETE", "OPTIONS", "TRACE"])
def test_other_methods(server, method):
    """Are not there."""
    headers = {} if method == "GET" else {"origin": f"http://127.0.0.1:{server.port}", "content_length": "0"}
    status, _ = request(
        server.port, method, "/api/claim", key=server.ann.key, content_type="application/json", **headers
    )
    assert status in (404, 405)
