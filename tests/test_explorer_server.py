"""The explorer's server: what it answers, and to whom."""

import http.client
import json
import threading
from urllib.parse import urlencode

import pytest

from aslo_jax.cli._explorer import _server
from aslo_jax.cli._explorer._newest import Newest, StaleError
from aslo_jax.cli._explorer._session import Session


@pytest.fixture(scope="module")
def session():
    return Session()


@pytest.fixture(scope="module")
def server(session):
    found = _server.Server(0, lambda: session)
    thread = threading.Thread(target=found.serve_forever, daemon=True)
    thread.start()
    yield found
    found.shutdown()
    thread.join()
    found.server_close()


def ask(server, target, method="GET", **headers):
    """Status, headers and body of a request."""
    connection = http.client.HTTPConnection("127.0.0.1", server.server_port, timeout=120)
    names = {name.replace("_", "-"): value for name, value in headers.items()}
    connection.putrequest(method, target, skip_host="Host" in names)
    for name, value in names.items():
        connection.putheader(name, value)
    connection.endheaders()
    answer = connection.getresponse()
    body = answer.read()
    connection.close()
    return answer.status, dict(answer.getheaders()), body


def test_only_the_loopback_is_listened_to(server):
    assert server.server_address[0] == "127.0.0.1"


@pytest.mark.parametrize("target", sorted(_server.PAGE))
def test_the_page_is_served(server, target):
    status, headers, body = ask(server, target)
    assert status == 200
    assert len(body) > 500
    assert "default-src 'none'" in headers["Content-Security-Policy"]
    assert headers["X-Content-Type-Options"] == "nosniff"
    own = body.replace(b"http://www.w3.org/2000/svg", b"").replace(b"url(#", b"")
    for outside in (b"http://", b"https://", b"url(", b"@import"):
        assert outside not in own


@pytest.mark.parametrize(
    "target",
    [
        "/../_server.py",
        "/%2e%2e/_server.py",
        "/page/../../_server.py",
        "//etc/passwd",
        "/index.html/../../_state.py",
        "/style.css%00",
        "/_server.py",
        "/api/",
        "/api/run/../export",
    ],
)
def test_no_path_leads_anywhere_else(server, target):
    status, _, body = ask(server, target)
    assert status == 404
    assert json.loads(body) == {"error": "There is nothing here."}


@pytest.mark.parametrize("method", ["POST", "PUT", "DELETE", "PATCH", "OPTIONS", "HEAD"])
def test_only_get_is_answered(server, method):
    status, headers, _ = ask(server, "/api/about", method)
    assert status == 405
    assert headers["Allow"] == "GET"


@pytest.mark.parametrize(
    "headers",
    [
        {"Host": "evil.example"},
        {"Host": "evil.example:{port}"},
        {"Host": "127.0.0.1"},
        {"Host": "127.0.0.1:1"},
        {"Origin": "http://evil.example"},
        {"Origin": "null"},
        {"Origin": "https://127.0.0.1:{port}"},
        {"Sec_Fetch_Site": "cross-site"},
        {"Sec_Fetch_Site": "same-site"},
    ],
)
def test_another_name_or_site_is_refused(server, headers):
    port = server.server_port
    given = {name: value.format(port=port) for name, value in headers.items()}
    status, _, body = ask(server, "/api/about", **given)
    assert status == 403
    assert "own" in json.loads(body)["error"]


def test_its_own_names_are_answered(server):
    port = server.server_port
    for name in ("127.0.0.1", "localhost"):
        own = {"Host": f"{name}:{port}", "Origin": f"http://{name}:{port}"}
        status, _, body = ask(server, "/api/about", Sec_Fetch_Site="same-origin", **own)
        assert status == 200
        assert json.loads(body)["title"] == "Surface-mounted PMSM"


def test_a_wrong_state_is_told_in_one_line(server):
    status, _, body = ask(server, "/api/run?observers.ASLO.cutoff=0")
    assert status == 400
    assert "must be from 2.38 to 23800 rad/s, but is 0." in json.loads(body)["error"]
    assert ask(server, f"/api/run?{'a' * 7000}")[0] == 414
    assert ask(server, "/api/run?n=x")[0] == 400


def test_a_request_that_a_newer_one_made_needless_is_dropped(server):
    query = urlencode({"horizon": 0.1, "client": "page", "n": 5})
    status, _, body = ask(server, f"/api/run?{query}")
    assert status == 200
    assert json.loads(body)["n"] == 5
    query = urlencode({"horizon": 0.1, "client": "page", "n": 4})
    assert ask(server, f"/api/run?{query}")[::2] == (409, b'{"stale":true}')
    other = urlencode({"horizon": 0.1, "client": "another page", "n": 1})
    assert ask(server, f"/api/run?{other}")[0] == 200


def test_requests_that_wait_give_way_to_the_newest():
    newest, done, held = Newest(), [], threading.Event()
    begun = threading.Event()

    def first():
        with newest.turn("page", "run", 1):
            begun.set()
            held.wait(60)
            done.append(1)

    def later(number):
        try:
            with newest.turn("page", "run", number):
                done.append(number)
        except StaleError:
            done.append(-number)

    threads = [threading.Thread(target=first)]
    threads[0].start()
    begun.wait(60)
    for number in (2, 3):
        threads.append(threading.Thread(target=later, args=(number,)))
        threads[-1].start()
        while newest._newest["page", "run"] != number:
            pass
    held.set()
    for thread in threads:
        thread.join()
    assert sorted(done) == [-2, 1, 3]
