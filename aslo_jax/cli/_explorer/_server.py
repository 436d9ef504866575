"""The server of the explorer: the page's files and its data, to this machine's own browser
and nobody else."""

import json
import sys
from collections.abc import Callable, Mapping
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from importlib.resources import files
from typing import TYPE_CHECKING, Any
from urllib.parse import parse_qs, urlsplit

from ._newest import StaleError
from ._state import LONGEST, State, StateError

if TYPE_CHECKING:
    from ._session import Session

HOST = "127.0.0.1"
JSON, SCRIPT = "application/json", "text/javascript; charset=utf-8"
# What is served of the page, and nothing else: no path of a request reaches a disk.
PAGE = {
    "/": ("index.html", "text/html; charset=utf-8"),
    "/style.css": ("style.css", "text/css; charset=utf-8"),
    "/main.js": ("main.js", SCRIPT),
    "/state.js": ("state.js", SCRIPT),
    "/controls.js": ("controls.js", SCRIPT),
    "/plot.js": ("plot.js", SCRIPT),
    "/axes.js": ("axes.js", SCRIPT),
    "/vector.js": ("vector.js", SCRIPT),
    "/save.js": ("save.js", SCRIPT),
    "/results.js": ("results.js", SCRIPT),
}
HEADERS = {
    "Content-Security-Policy": "default-src 'none'; script-src 'self'; style-src 'self'; "
    "connect-src 'self'; img-src 'self' data: blob:; base-uri 'none'; form-action 'none'; "
    "frame-ancestors 'none'",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cache-Control": "no-store",
}
LONGEST_LINE = LONGEST + 200  # characters of a target
IDLE = 60.0  # seconds after which a connection is closed


class Server(ThreadingHTTPServer):
    """A server on the loopback alone.

    - `port`: where it listens, a free one for 0; `session()`: what answers, which may take
      a while at first.
    """

    daemon_threads = True

    def __init__(self, port: int, session: "Callable[[], Session]") -> None:
        super().__init__((HOST, port), Handler)
        self.session = session

    @property
    def origins(self) -> tuple[str, ...]:
        """Those of its own page."""
        return tuple(f"http://{name}:{self.server_port}" for name in (HOST, "localhost"))

    def handle_error(self, request: Any, client_address: Any) -> None:
        """A browser that goes away is no error."""
        if not isinstance(sys.exception(), ConnectionError | TimeoutError):
            super().handle_error(request, client_address)


class Handler(BaseHTTPRequestHandler):
    """One connection."""

    protocol_version = "HTTP/1.1"
    server_version, sys_version = "aslo-jax", ""
    timeout = IDLE
    wbufsize = 1 << 16  # head and body in one packet
    disable_nagle_algorithm = True

    def _own(self) -> Server:
        assert isinstance(self.server, Server)
        return self.server

    def do_GET(self) -> None:
        """A file of the page, or data."""
        refusal = self._refusal()
        if refusal is not None:
            self._error(HTTPStatus.FORBIDDEN, refusal)
            return
        if len(self.path) > LONGEST_LINE:
            self._error(HTTPStatus.REQUEST_URI_TOO_LONG, "The address is too long.")
            return
        target = urlsplit(self.path)
        if target.path in PAGE:
            name, kind = PAGE[target.path]
            content = (files(__package__ or "") / "page" / name).read_bytes()
            self._send(HTTPStatus.OK, kind, content)
        elif target.path in ANSWERS:
            self._answer(target.path, target.query)
        else:
            self._error(HTTPStatus.NOT_FOUND, "There is nothing here.")

    def _refused(self) -> None:
        self.close_connection = True  # what it sends is not read
        self._error(HTTPStatus.METHOD_NOT_ALLOWED, "Only GET is answered.", Allow="GET")

    do_HEAD = do_POST = do_PUT = do_PATCH = do_DELETE = do_OPTIONS = _refused
    do_TRACE = do_CONNECT = _refused

    def _refusal(self) -> str | None:
        """Why a request is not one of the page, if it is not: another name for this
        machine, as DNS can be made to give, or another site."""
        own = self._own().origins
        hosts = self.headers.get_all("Host") or []
        if len(hosts) != 1 or f"http://{hosts[0]}" not in own:
            return "This server answers to its own name only."
        origins = self.headers.get_all("Origin") or []
        if any(origin not in own for origin in origins):
            return "This server answers to its own page only."
        site = self.headers.get("Sec-Fetch-Site", "none")
        page = urlsplit(self.path).path == "/"  # which may be opened from anywhere
        if site not in ("none", "same-origin") and not page:
            return "This server answers to its own page only."
        return None

    def _answer(self, path: str, query: str) -> None:
        try:
            session = self._own().session()
            found = ANSWERS[path](session, query)
        except StaleError:
            self._json(HTTPStatus.CONFLICT, {"stale": True})
        except ValueError as error:
            self._error(HTTPStatus.BAD_REQUEST, str(error))
        except Exception as error:
            text = f"{type(error).__name__}: {error}"
            print(f"aslo-jax: warning: {' '.join(text.split())[:300]}", file=sys.stderr)
            self._error(HTTPStatus.INTERNAL_SERVER_ERROR, text[:1000])
        else:
            if isinstance(found, dict):
                self._json(HTTPStatus.OK, found)
            else:
                saved = {"Content-Disposition": f'attachment; filename="{found.name}"'}
                self._send(HTTPStatus.OK, found.type, found.content, saved)

    def _json(self, status: HTTPStatus, content: Mapping[str, Any], **more: str) -> None:
        text = json.dumps(content, allow_nan=False, separators=(",", ":"))
        self._send(status, JSON, text.encode(), more)

    def _error(self, status: HTTPStatus, text: str, **more: str) -> None:
        self._json(status, {"error": text}, **more)

    def _send(
        self, status: HTTPStatus, kind: str, content: bytes, more: Mapping[str, str] = {}
    ) -> None:
        self.send_response(status)
        for name, value in (HEADERS | {"Content-Type": kind} | dict(more)).items():
            self.send_header(name, value)
        self.send_header("Content-Length", str(len(content)))
        self.end_headers()
        self.wfile.write(content)

    def log_message(self, format: str, *arguments: Any) -> None:  # noqa: A002
        """Nothing: the terminal is for the address and the end."""


def _one(query: str, name: str, default: str = "") -> str:
    """The value of a key of a request."""
    found = parse_qs(query, keep_blank_values=True, max_num_fields=400).get(name)
    return found[0] if found else default


def _number(query: str, name: str) -> int:
    text = _one(query, name, "0")
    if not (text.isascii() and text.isdigit() and len(text) < 12):
        raise StateError(f"`{name}` must be a whole number, but is {text[:20]!r}.")
    return int(text)


def _about(session: "Session", query: str) -> Any:
    return session.about(State.of_query(query, session.first))


def _in_turn(what: str, answer: "Callable[[Session, State], dict[str, Any]]") -> Any:
    def turn(session: "Session", query: str) -> dict[str, Any]:
        state, number = State.of_query(query, session.first), _number(query, "n")
        with session.newest.turn(_one(query, "client")[:40], what, number):
            return answer(session, state) | {"n": number}

    return turn


def _tune(session: "Session", query: str) -> dict[str, Any]:
    name = _one(query, "observer_name")
    return _in_turn("tune", lambda s, state: s.tuned(state, name))(session, query)


def _export(session: "Session", query: str) -> Any:
    state = State.of_query(query, session.first)
    return session.export(state, _one(query, "format"), _one(query, "observer_name"))


ANSWERS: "dict[str, Callable[[Session, str], Any]]" = {
    "/api/about": _about,
    "/api/run": _in_turn("run", lambda s, state: s.run(state)),
    "/api/band": _in_turn("band", lambda s, state: s.band(state)),
    "/api/tune": _tune,
    "/api/export": _export,
    "/api/against": lambda s, query: s.against(_one(query, "parameter") or None),
    "/api/sample": lambda s, query: s.sample(_number(query, "index")),
}
