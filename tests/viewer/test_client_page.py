"""The web viewer's answers to a browser, byte by byte: Host, Origin, secret and headers."""

from __future__ import annotations

import http.client
import re
import socket
import time
from collections.abc import Iterator
from contextlib import closing
from http import HTTPStatus
from types import SimpleNamespace
from typing import Any

import pytest
import viser
from viser.infra import Message
from websockets.datastructures import Headers
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.http11 import Request, Response
from websockets.sync.client import ClientConnection, connect
from websockets.typing import Origin, Subprotocol

from trocar.errors import InputError
from trocar.live import connections
from trocar.live.access import PageAccess
from trocar.viewer.server import LocalServer, address, entrance, run_there, serving

TOKEN = "0123456789abcdef"
OWN_PAGE = "http://localhost:3000"
VISER_HANDSHAKE = (
    "GET / HTTP/1.1\r\nHost: localhost\r\n"
    "Upgrade: websocket\r\nConnection: Upgrade\r\nSec-WebSocket-Version: 13\r\n"
    "Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n"
    f"Sec-WebSocket-Protocol: viser-v{viser.__version__}\r\n\r\n"
).encode()


@pytest.fixture(scope="module")
def server() -> Iterator[LocalServer]:
    sockets = ["ws://127.0.0.1:9090"]
    with serving("127.0.0.1", 0, "test", PageAccess([OWN_PAGE]), sockets) as found:
        yield found


def get(server: LocalServer, path: str = "/", host: str | None = None) -> http.client.HTTPResponse:
    """Ask for a path and read the answer, whose text is then in `answer.text`."""
    asking = http.client.HTTPConnection(server.get_host(), server.get_port(), timeout=20)
    asking.putrequest("GET", path, skip_host=True)
    asking.putheader("Host", host or f"{server.get_host()}:{server.get_port()}")
    asking.endheaders()
    answer = asking.getresponse()
    answer.text = answer.read().decode()  # type: ignore[attr-defined]
    asking.close()
    return answer


def secret_of(server: LocalServer) -> str:
    """Return the secret that the page shows to sockets, read from its HTML."""
    found = re.findall(r"token=[\w-]{40,}", get(server).text)  # type: ignore[attr-defined]
    assert len(set(found)) == 1
    return found[0]


def open_socket(
    server: LocalServer, origin: str | None, query: str = "", host: str | None = None
) -> ClientConnection:
    """Open viser's WebSocket as a page of this origin does."""
    name = host or f"{server.get_host()}:{server.get_port()}"
    wire = socket.create_connection((server.get_host(), server.get_port()), timeout=20)
    return connect(
        f"ws://{name}/?{query}",
        sock=wire,
        origin=None if origin is None else Origin(origin),
        subprotocols=[Subprotocol(f"viser-v{viser.__version__}")],
        compression=None,
        max_size=None,
    )


def test_the_page_is_served_whole_to_a_slow_reader(server: LocalServer) -> None:
    with socket.socket() as reader:
        reader.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        reader.connect((server.get_host(), server.get_port()))
        reader.sendall(b"GET / HTTP/1.1\r\nHost: localhost\r\n\r\n")
        time.sleep(0.5)  # what the system buffers is full by now
        head, _, text = b"".join(iter(lambda: reader.recv(65536), b"")).partition(b"\r\n\r\n")
    assert head.startswith(b"HTTP/1.1 200 ")
    assert b"Content-Type: text/html; charset=utf-8" in head
    assert text.rstrip().endswith(b"</html>")


@pytest.mark.parametrize("host", ["localhost:9000", "127.0.0.1", "[::1]:8080", "LOCALHOST"])
def test_every_name_of_this_machine_leads_to_the_page(server: LocalServer, host: str) -> None:
    assert get(server, host=host).status == 200


@pytest.mark.parametrize(
    "host", ["example.org", "127.0.0.1.nip.io", "localhost.example.org", "192.168.1.5", "[::1", "x"]
)
def test_a_name_that_another_site_lets_lead_here_gets_nothing(
    server: LocalServer, host: str
) -> None:
    for path in ("/", "/?websocket=ws://x", "/missing"):
        answer = get(server, path, f"{host}:{server.get_port()}")
        assert answer.status == 403
        assert "allowed: localhost" in answer.text  # type: ignore[attr-defined]
        assert "token=" not in answer.text  # type: ignore[attr-defined]
    with pytest.raises(InvalidStatus) as caught:
        open_socket(server, None, host="example.org")
    assert caught.value.response.status_code == 403


@pytest.mark.parametrize(
    "query", ["websocket=ws://127.0.0.1:1", "playbackPath=data:,x", "showStats", "&", "token=x"]
)
@pytest.mark.parametrize("path", ["/", "/index.html"])
def test_parameters_lead_back_to_the_clean_address(
    server: LocalServer, path: str, query: str
) -> None:
    answer = get(server, f"{path}?{query}")
    assert (answer.status, answer.getheader("Location")) == (302, "/")


@pytest.mark.parametrize(
    ("path", "host", "status"),
    [("/", None, 200), ("/?websocket=x", None, 302), ("/x", None, 404), ("/", "example.org", 403)],
)
def test_every_answer_carries_the_policy(
    server: LocalServer, path: str, host: str | None, status: int
) -> None:
    answer = get(server, path, host)
    assert answer.status == status
    assert answer.getheader("X-Frame-Options") == "DENY"
    assert answer.getheader("X-Content-Type-Options") == "nosniff"
    assert answer.getheader("Cache-Control") == "no-store"
    policy = dict(
        directive.strip().split(" ", 1)
        for directive in (answer.getheader("Content-Security-Policy") or "").split(";")
    )
    assert policy["default-src"] == "'none'"
    assert policy["frame-ancestors"] == "'none'"
    assert policy["connect-src"] == "'self' data: blob: ws://127.0.0.1:9090"
    assert re.fullmatch(r"'nonce-[\w-]{40,}' 'wasm-unsafe-eval'", policy["script-src"])


def test_the_secret_is_another_one_in_every_run(server: LocalServer) -> None:
    with serving("127.0.0.1", 0, "test") as other:
        assert secret_of(other) != secret_of(server)


def test_the_page_itself_a_page_that_was_named_and_programs_may_connect(
    server: LocalServer,
) -> None:
    own, secret, port = address(server), secret_of(server), server.get_port()
    for origin, query, host in (
        (own, secret, None),
        (f"http://localhost:{port}", secret, f"localhost:{port}"),
        ("http://localhost:9000", secret, "localhost:9000"),  # forwarded with ssh -L 9000:...
        (OWN_PAGE, "", None),
        (None, "", None),
    ):
        with closing(open_socket(server, origin, query, host)) as page:
            assert page.recv(timeout=20)


@pytest.mark.parametrize(
    "origin",
    [
        "https://example.org",
        "null",
        "",
        "http://127.0.0.1.evil.org",
        "http://127.0.0.1:3000",  # another port of this machine
        "http://127.0.0.1",
        "http://localhost:3001",
        "https://localhost:3000",
        "http://localhost:3000.evil.org",
    ],
)
def test_a_page_of_another_origin_is_refused_even_with_the_secret(
    server: LocalServer, origin: str
) -> None:
    with pytest.raises(InvalidStatus) as caught:
        open_socket(server, origin, secret_of(server))
    assert caught.value.response.status_code == 403
    assert b"--origin URL" in (caught.value.response.body or b"")


@pytest.mark.parametrize("query", ["", "token=", "page=x", "token=x"])
def test_without_the_secret_not_even_the_right_origin_helps(
    server: LocalServer, query: str
) -> None:
    with pytest.raises(InvalidStatus) as caught:
        open_socket(server, address(server), query)
    assert caught.value.response.status_code == 403
    assert b"reload" in (caught.value.response.body or b"")


def test_what_a_stranger_says_with_its_first_breath_is_not_heard(
    server: LocalServer, monkeypatch: pytest.MonkeyPatch
) -> None:
    heard: list[bytes] = []
    monkeypatch.setattr(Message, "deserialize", heard.append)
    greeting = VISER_HANDSHAKE.replace(b"\r\n\r\n", b"\r\nOrigin: https://example.org\r\n\r\n")
    where = ("127.0.0.1", server.get_port())
    with socket.create_connection(where, timeout=30) as stranger:
        stranger.sendall(greeting + b"\x82\x83\0\0\0\0any" + b"\x88\x80\0\0\0\0")
        while stranger.recv(4096):
            pass
    assert not heard


def test_a_browser_that_never_reads_is_let_go_and_one_that_reads_stays(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(connections, "MOST_BUFFERED", 4096)
    monkeypatch.setattr(connections, "SEND_BUFFER", 4096)
    monkeypatch.setattr(connections, "LOOK_S", 0.05)
    monkeypatch.setattr(connections, "GONE_S", 1.0)
    with (
        serving("127.0.0.1", 0, "test") as server,
        open_socket(server, None) as reader,
        socket.socket() as silent,
    ):
        silent.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        silent.connect((server.get_host(), server.get_port()))
        silent.sendall(VISER_HANDSHAKE)
        end = time.monotonic() + 20.0
        while time.monotonic() < end and "web viewer: disconnected" not in caplog.text:
            run_there(server, lambda: server.gui.add_html("x" * 10_000))
            reader.recv(timeout=20)
        assert f"disconnected 127.0.0.1:{silent.getsockname()[1]}," in caplog.text
        run_there(server, lambda: server.gui.add_html("more"))
        assert reader.recv(timeout=20)


def test_no_more_browsers_come_in_than_fit_unless_one_does_not_read(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(connections, "MOST_CLIENTS", 1)
    monkeypatch.setattr(connections, "STALE_S", 1000.0)
    with serving("127.0.0.1", 0, "test") as server, open_socket(server, None) as first:
        with pytest.raises(InvalidStatus) as caught:
            open_socket(server, None)
        assert caught.value.response.status_code == 503
        assert get(server).status == 200
        monkeypatch.setattr(connections, "STALE_S", 0.0)
        with open_socket(server, None) as second:
            assert second.recv(timeout=20)
            with pytest.raises(ConnectionClosed):
                read_all(first)


def read_all(page: Any) -> None:
    while True:
        page.recv(timeout=20)


def test_two_servers_at_once_have_secrets_of_their_own() -> None:
    with serving("127.0.0.1", 0, "one") as one, serving("127.0.0.1", 0, "two") as two:
        open_socket(one, address(one), secret_of(one)).close()
        with pytest.raises(InvalidStatus):
            open_socket(two, address(two), secret_of(one))


@pytest.fixture(scope="module")
def guarded() -> Iterator[LocalServer]:
    with serving("127.0.0.1", 0, "test", PageAccess([OWN_PAGE], TOKEN)) as found:
        yield found


@pytest.mark.parametrize("path", ["/", "/index.html", "/?token=", "/?token=wrong", f"/{TOKEN}"])
def test_with_a_token_nobody_gets_the_page_without_it(guarded: LocalServer, path: str) -> None:
    answer = get(guarded, path)
    assert answer.status in (401, 404)
    assert TOKEN not in answer.text  # type: ignore[attr-defined]
    assert "</html>" not in answer.text  # type: ignore[attr-defined]


def test_the_token_and_the_address_that_is_printed_open_the_page(guarded: LocalServer) -> None:
    printed = entrance(guarded).removeprefix(address(guarded))
    assert TOKEN not in printed
    for path in (f"/?token={TOKEN}", printed):
        answer = get(guarded, path)
        assert answer.status == 200
        assert TOKEN not in answer.text  # type: ignore[attr-defined]


@pytest.mark.parametrize(
    "more", ["websocket=ws://127.0.0.1:1", "playbackPath=data:,x", "", "token"]
)
def test_parameters_beside_the_token_are_dropped(guarded: LocalServer, more: str) -> None:
    for query in (f"token={TOKEN}&{more}", f"{more}&token={TOKEN}"):
        answer = get(guarded, f"/?{query}")
        assert (answer.status, answer.getheader("Location")) == (302, f"/?token={TOKEN}")


def test_with_a_token_programs_and_named_pages_need_it_too(guarded: LocalServer) -> None:
    for origin in (None, OWN_PAGE):
        with pytest.raises(InvalidStatus) as caught:
            open_socket(guarded, origin)
        assert caught.value.response.status_code == 401
        with closing(open_socket(guarded, origin, f"token={TOKEN}")) as page:
            assert page.recv(timeout=20)


def test_a_socket_that_no_policy_can_name_is_refused() -> None:
    with (
        pytest.raises(InputError, match=r"cannot send keys to ws://\[::1\]:9090"),
        serving("127.0.0.1", 0, "test", sockets=["ws://[::1]:9090"]),
    ):
        pass


# ---------------------------------------------------------------------- other machines


LAB = "lab.example:8080"


@pytest.fixture(scope="module")
def networked() -> Iterator[LocalServer]:
    sockets = ["ws://127.0.0.1:9090"]
    with serving("0.0.0.0", 0, "test", PageAccess(token=TOKEN), sockets) as found:
        yield found


def watch_query(server: LocalServer) -> str:
    return server.page.access.watch_address.partition("?")[2]


@pytest.mark.parametrize("host", ["localhost:80", "192.0.2.7:8080", LAB, "evil.example"])
@pytest.mark.parametrize("path", ["/", "/?token=", "/?token=wrong", "/?websocket=ws://x"])
def test_no_name_leads_to_the_page_without_the_token(
    networked: LocalServer, host: str, path: str
) -> None:
    answer = get(networked, path, host)
    assert answer.status == 401
    assert "token=" not in answer.text.replace("?token=...", "")  # type: ignore[attr-defined]
    for query in ("", "token=wrong"):
        for origin in (None, f"http://{host}"):
            with pytest.raises(InvalidStatus) as caught:
                open_socket(networked, origin, query, host)
            assert caught.value.response.status_code in (401, 403)


def test_a_token_in_a_cookie_opens_nothing(networked: LocalServer) -> None:
    # A site whose name is made to lead here has its own cookies with every request.
    secret = watch_query(networked).partition("=")[2]
    asking = http.client.HTTPConnection("127.0.0.1", networked.get_port(), timeout=20)
    cookie = f"token={TOKEN}; secret={secret}"
    asking.request("GET", "/", headers={"Host": "evil.example", "Cookie": cookie})
    assert asking.getresponse().status == 401


def test_who_has_the_address_for_others_gets_a_page_that_watches(networked: LocalServer) -> None:
    watching = watch_query(networked)
    answer = get(networked, f"/?{watching}", LAB)
    text = answer.text  # type: ignore[attr-defined]
    console = entrance(networked).partition("?")[2]
    assert answer.status == 200 and watching in text
    assert console not in text and TOKEN not in text
    policy = answer.getheader("Content-Security-Policy") or ""
    assert "connect-src 'self' data: blob:;" in policy
    with closing(open_socket(networked, f"http://{LAB}", watching, LAB)) as page:
        assert page.recv(timeout=20)
    for origin in ("http://evil.example", "http://lab.example", f"https://{LAB}"):
        with pytest.raises(InvalidStatus) as caught:
            open_socket(networked, origin, watching, LAB)
        assert caught.value.response.status_code == 403


def test_the_secret_of_those_who_watch_opens_no_other_server(networked: LocalServer) -> None:
    access, path = networked.page.access, f"/?{watch_query(networked)}"
    assert access.objection(path, {}, set()) is not None
    assert access.objection(path, {}, set(), watching=True) is None


@pytest.mark.parametrize(
    ("peer", "own", "drives"),
    [
        ("127.0.0.1", "127.0.0.1", True),
        ("192.0.2.7", "192.0.2.7", True),
        ("192.0.2.9", "192.0.2.7", False),
    ],
)
def test_the_token_lets_a_browser_of_this_machine_drive_and_others_watch(
    networked: LocalServer, peer: str, own: str, drives: bool
) -> None:
    def answered(status: HTTPStatus, text: str) -> Response:
        return Response(status, status.phrase, Headers({"Content-Type": ""}), text.encode())

    connection: Any = SimpleNamespace(
        remote_address=(peer, 50000), local_address=(own, 8080), respond=answered
    )
    request = Request(f"/?token={TOKEN}", Headers({"Host": f"{own}:8080"}))
    answer = networked.page.respond(connection, request)
    assert answer is not None and answer.status_code == 200
    assert (entrance(networked).partition("?")[2] in answer.body.decode()) is drives
    console = get(networked, entrance(networked).removeprefix(address(networked)), LAB)
    assert entrance(networked).partition("?")[2] in console.text  # type: ignore[attr-defined]


def test_a_frame_is_for_pages_of_this_machine_and_needs_a_secret() -> None:
    with serving("127.0.0.1", 0, "test", framed=True) as server:
        answer = get(server, entrance(server).removeprefix(address(server)))
        assert answer.status == 200 and answer.getheader("X-Frame-Options") is None
        policy = answer.getheader("Content-Security-Policy") or ""
        assert "frame-ancestors http://localhost:* http://127.0.0.1:*" in policy
        assert get(server).status == 401
        assert get(server, host="evil.example").status == 403
