"""The page through forwarded ports and reverse proxies: one option allows that address alone, and refusals name it."""

from __future__ import annotations

import asyncio
import http.client
import json
import socket
import threading

import pytest
from websockets.asyncio.client import connect
from websockets.datastructures import Headers
from websockets.exceptions import InvalidStatus
from websockets.http11 import Request

from palpate.app.view.server.address import LOOPBACK, allowed_hosts, open_listener, public_address
from palpate.app.view.server.host import Host
from palpate.app.view.server.page import Page
from palpate.core.faults import InputError

INDEX, SCRIPT = b'<script src="./assets/page.js"></script>', b"1"
SECONDS = 60.0


class Proxy:
    """A reverse proxy in a thread: passes requests to a port, with another path and ``Host``, and then all bytes."""

    def __init__(self, prefix="/", strips=True, passes_host=True):
        self.prefix, self.strips, self.passes_host = prefix, strips, passes_host
        self.target, self.seen = 0, []
        self.listener = socket.create_server((LOOPBACK, 0))
        self.port = self.listener.getsockname()[1]
        threading.Thread(target=self._accept, daemon=True).start()

    def _accept(self):
        while True:
            try:
                client, _ = self.listener.accept()
            except OSError:  # closed
                return
            threading.Thread(target=self._serve, args=(client,), daemon=True).start()

    def _serve(self, client):
        with client, socket.create_connection((LOOPBACK, self.target)) as server:
            head = b""
            while b"\r\n\r\n" not in head:
                head += client.recv(4096) or b"\r\n\r\n"
            server.sendall(self._changed(head))
            back = threading.Thread(target=self._pump, args=(server, client), daemon=True)
            back.start()
            self._pump(client, server)
            back.join(SECONDS)

    def _changed(self, head):
        line, *others = head.split(b"\r\n")
        method, path, version = line.split(b" ")
        if self.strips and path.startswith(self.prefix.encode()):
            path = b"/" + path[len(self.prefix) :]
        self.seen.append(path.decode())
        if not self.passes_host:
            own = f"Host: {LOOPBACK}:{self.target}".encode()
            others = [own if each.lower().startswith(b"host:") else each for each in others]
        return b"\r\n".join([b" ".join([method, path, version]), *others])

    @staticmethod
    def _pump(source, sink):
        try:
            while data := source.recv(65536):
                sink.sendall(data)
            sink.shutdown(socket.SHUT_WR)
        except OSError:
            pass

    def close(self):
        self.listener.close()


@pytest.fixture
def proxy_of():
    made = []

    def start(**options):
        made.append(Proxy(**options))
        return made[-1]

    yield start
    for each in made:
        each.close()


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "assets").mkdir()
    (tmp_path / "index.html").write_bytes(INDEX)
    (tmp_path / "assets" / "page.js").write_bytes(SCRIPT)
    return tmp_path


def get(port, path):
    line = http.client.HTTPConnection(LOOPBACK, port, timeout=SECONDS)
    line.request("GET", path)
    answer = line.getresponse()
    return answer.status, answer.headers, answer.read()


async def first_message(port, path, origin, token):
    own = {"subprotocols": ["palpate.v3"], "max_size": None, "origin": origin}
    async with connect(f"ws://{LOOPBACK}:{port}{path}", **own) as viewer:
        await viewer.send(json.dumps({"type": "hello", "protocol": 3, "token": token}))
        return json.loads(await viewer.recv())["type"]


@pytest.mark.parametrize("strips", [True, False])
@pytest.mark.parametrize("passes_host", [True, False])
@pytest.mark.parametrize("prefix", ["/", "/proxy/8765/", "/user/a%40b/p/", "/session/", "/assets/"])
def test_page_and_socket_pass_through_a_proxy(session, site_of, proxy_of, folder, strips, passes_host, prefix):
    proxy = proxy_of(prefix=prefix, strips=strips, passes_host=passes_host)
    public = public_address(f"http://{LOOPBACK}:{proxy.port}{prefix}")
    site = site_of(session, folder, public)
    proxy.target = site.port
    status, headers, body = get(proxy.port, prefix)
    assert (status, body) == (200, INDEX)
    assert f" ws://{LOOPBACK}:{proxy.port};" in headers["Content-Security-Policy"]
    assert get(proxy.port, prefix + "assets/page.js")[2] == SCRIPT  # as the page asks for it, next to itself
    token = site.address.partition("#")[2]
    assert asyncio.run(first_message(proxy.port, prefix + "session", public.origin, token)) == "hello"
    assert proxy.seen[-1] == ("/session" if strips else prefix + "session")
    with pytest.raises(InvalidStatus) as refused:
        asyncio.run(first_message(proxy.port, prefix + "session", "https://example.org", token))
    assert refused.value.response.status_code == 403


def test_an_address_without_its_last_slash_leads_to_the_page(session, site_of, proxy_of, folder):
    proxy = proxy_of(strips=False)
    site = site_of(session, folder, public_address(f"http://{LOOPBACK}:{proxy.port}/a/b"))
    proxy.target = site.port
    status, headers, _ = get(proxy.port, "/a/b")
    assert (status, headers["Location"]) == (308, "/a/b/")
    assert get(proxy.port, "/a/bc")[0] == 404


def answer(page, path, host, origin=None):
    headers = Headers({"Host": host} | ({"Origin": origin} if origin else {}))
    response = page.answer(Request(path, headers))
    return (101, "") if response is None else (response.status_code, response.body.decode())


@pytest.fixture
def page(folder):
    def made(url=None):
        return Page(allowed_hosts(LOOPBACK, 8765), folder, None if url is None else public_address(url))

    return made


def test_the_option_adds_exactly_its_host_and_origin(page):
    own = page("https://Lab.example.org/p/")
    for host in ("127.0.0.1:8765", "localhost:8765", "lab.example.org", "lab.example.org:443", "LAB.example.org"):
        assert answer(own, "/", host)[0] == 200, host
        assert answer(own, "/p/session", host, "https://lab.example.org")[0] == 101, host
    for host in (
        "example.org",
        "lab.example.org:80",
        "evil.lab.example.org",
        "lab.example.org.evil.org",
        "localhost:9000",
        "",
    ):
        assert answer(own, "/", host)[0] == 403, host
    for origin in (
        "http://lab.example.org",
        "https://example.org",
        "https://lab.example.org:444",
        "null",
        "https://lab.example.org/",
    ):
        assert answer(own, "/session", "lab.example.org", origin)[0] == 403, origin
    assert answer(own, "/session", "lab.example.org", "http://localhost:8765")[0] == 101  # on this machine, as before
    repeated = Headers([("Host", "lab.example.org"), ("Host", "example.org")])
    assert own.answer(Request("/", repeated)).status_code == 403


@pytest.mark.parametrize(
    ("path", "host", "origin", "words"),
    [
        ("/", "localhost:9000", None, "got localhost:9000; forward the same port at both ends, or"),
        ("/", "localhost:9000", None, "--public-url http://localhost:9000/; see docs/howto/serve.md"),
        (
            "/",
            "lab.example.org",
            None,
            "Host must be 127.0.0.1:8765, localhost:8765 or [::1]:8765, got lab.example.org;",
        ),
        ("/session", "localhost:8765", "https://lab.example.org", "--public-url https://lab.example.org/; see"),
        ("/", "<script>", None, "got another;"),
        ("/", "x" * 300, None, "--public-url http://HOST:PORT/; see"),
        ("/proxy/8765/", "localhost:8765", None, "--public-url https://HOST/PREFIX/; see docs/howto/serve.md"),
    ],
)
def test_refusals_name_the_option_that_allows_the_address(page, path, host, origin, words):
    status, text = answer(page(), path, host, origin)
    assert status in (403, 404)
    assert words in text
    assert len(text) < 400


@pytest.mark.parametrize(
    ("url", "origin", "prefix", "socket_origin"),
    [
        ("https://lab.example.org", "https://lab.example.org", "/", "wss://lab.example.org"),
        ("https://LAB.example.org:443/a/b", "https://lab.example.org", "/a/b/", "wss://lab.example.org"),
        ("http://localhost:9000/", "http://localhost:9000", "/", "ws://localhost:9000"),
        ("http://[::1]:9000/p/", "http://[::1]:9000", "/p/", "ws://[::1]:9000"),
        ("http://[0:0:0:0:0:0:0:1]:9000/", "http://[::1]:9000", "/", "ws://[::1]:9000"),  # as browsers write it
        ("http://192.0.2.7:80", "http://192.0.2.7", "/", "ws://192.0.2.7"),
        ("https://hub.example.org/user/a%40b/proxy/8765/", "https://hub.example.org", "/user/a%40b/proxy/8765/", "wss://hub.example.org"),
        ("https://xn--bcher-kva.example:8443/", "https://xn--bcher-kva.example:8443", "/", "wss://xn--bcher-kva.example:8443"),
    ],
)  # fmt: skip
def test_parts_of_a_public_address(url, origin, prefix, socket_origin):
    public = public_address(url)
    assert (public.origin, public.prefix, public.socket_origin) == (origin, prefix, socket_origin)
    assert public.url == origin + prefix
    assert public.hosts[0] == origin.partition("://")[2]


@pytest.mark.parametrize(
    ("url", "words"),
    [
        ("lab.example.org/p/", "the scheme http:// or https://"),
        ("localhost:9000", "the scheme"),
        ("ws://lab.example.org/", "the scheme"),
        ("https:/lab.example.org/", "the scheme"),
        ("javascript:alert(1)", "the scheme"),
        ("", "the scheme"),
        ("https://lab.example.org/p/?token=1", "no query"),
        ("https://lab.example.org/p/?", "no query"),
        ("https://lab.example.org/p/#abc", "no fragment"),
        ("https://user:word@lab.example.org/", "no name or password"),
        ("https://lab.example.org@example.org/", "no name or password"),
        ("https://lab.example.org/a b/", "no spaces"),
        (" https://lab.example.org/", "no spaces"),
        ("https://lab.example.org/\n", "no spaces"),
        ("https://lab.example.org\r\nX: y/", "no spaces"),
        ("https://", "a host"),
        ("https:///p/", "a host"),
        ("https://*.example.org/", "a host"),
        ("https://lab.example.org;x/", "a host"),
        ("https://b\u00fccher.example/", "ASCII"),
        ("https://lab.example.org:99999/", "a valid host and port"),
        ("https://lab.example.org:0/", "a port from 1 to 65535"),
        ("https://lab.example.org:x/", "a valid host and port"),
        ("https://[::1/", "a valid host and port"),
        ("https://lab.example.org/a/../b/", "a path without"),
        ("https://lab.example.org/a/%2e%2e/b/", "a path without"),
        ("https://lab.example.org//example.org/", "a path of plain parts"),
        ("https://lab.example.org/a\\b/", "a path of plain parts"),
        ("https://lab.example.org/" + "a" * 500, "at most 500 characters"),
    ],
)
def test_other_texts_are_refused_in_a_line(url, words):
    with pytest.raises(InputError, match="public_url must have ") as caught:
        public_address(url)
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 260
    assert str(caught.value).endswith("write it as in https://host.example.org/prefix/")


def test_the_printed_address_is_the_public_one_with_the_token(session):
    own = Host(session, port=18990, public_url="https://lab.example.org/p")
    own._listener.close()
    assert own.address.startswith("https://lab.example.org/p/#")
    assert own.local_address.startswith(f"http://{LOOPBACK}:{own.port}/#")
    assert own.address.rpartition("#")[2] == own.local_address.rpartition("#")[2]


def test_a_public_address_needs_the_port_that_was_asked_for(session):
    with open_listener(LOOPBACK, 18995) as busy:
        port = busy.getsockname()[1]
        with pytest.raises(InputError, match=f"port must be free with public_url, got {port}, which is busy"):
            Host(session, port=port, public_url="http://localhost:9000/")
