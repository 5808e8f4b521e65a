"""HTTP access to the files of the page, and checks of requests."""

from __future__ import annotations

import re
from http import HTTPStatus
from pathlib import Path

from websockets.datastructures import Headers, MultipleValuesError
from websockets.http11 import Request, Response

from palpate.app.view.server.address import PublicAddress

PAGE_FOLDER = Path(__file__).parents[1] / "page"
SOCKET_PATH = "/session"
PRINTED_HEADER = re.compile(r"[A-Za-z0-9.:/\[\]_-]{1,100}")  # of a request, which a refusal repeats
# of notebooks on this machine, of the address of a proxy, and of editors; without the token a frame shows nothing
FRAMING_ORIGINS = "'self' http://localhost:* http://127.0.0.1:* https://localhost:* vscode-webview:"
CONTENT_TYPES = {
    ".html": "text/html; charset=utf-8", ".js": "text/javascript; charset=utf-8", ".css": "text/css; charset=utf-8",
    ".svg": "image/svg+xml", ".png": "image/png", ".ico": "image/x-icon", ".json": "application/json",
    ".webmanifest": "application/manifest+json", ".woff2": "font/woff2", ".wasm": "application/wasm",
    ".txt": "text/plain; charset=utf-8",
}  # fmt: skip
NOT_BUILT = (
    "<!doctype html><title>palpate</title><h1>The page was not built</h1><p>The server runs, but this copy of palpate "
    "has no page: {folder} has no index.html. A wheel contains the page; docs/howto/view.md describes how to build it "
    "from the sources. Programs can use this server without the page: see docs/reference/protocol.md."
)


class Page:
    """The files of the page, read at the start, and the checks of requests.

    `hosts` are the allowed ``Host`` headers, with the port. `public`, a forwarded port or a proxy, has a host and an
    origin that are allowed, too. `framed` allows notebooks to show the page in a cell.
    """

    def __init__(
        self, hosts: list[str], folder: Path = PAGE_FOLDER, public: PublicAddress | None = None, framed: bool = False
    ) -> None:
        self.hosts, self.folder, self.public = tuple(hosts), folder, public
        self._ancestors = FRAMING_ORIGINS if framed else "'none'"
        self._allowed = {*hosts, *(public.hosts if public else ())}
        self._origins = {f"http://{name}" for name in hosts} | ({public.origin} if public else set())
        self._files: dict[str, tuple[str, bytes]] = {}
        for path in sorted(folder.rglob("*")) if folder.is_dir() else ():
            if path.is_file() and path.suffix in CONTENT_TYPES:
                self._files["/" + path.relative_to(folder).as_posix()] = CONTENT_TYPES[path.suffix], path.read_bytes()
        if "/index.html" in self._files:
            self._files["/"] = self._files["/index.html"]

    @property
    def exists(self) -> bool:
        """Whether the page was built."""
        return "/" in self._files

    def answer(self, request: Request) -> Response | None:
        """Return the response to a request, or None for a permitted request that opens the socket."""
        host = self._header(request.headers, "Host")
        if host is None or host.lower() not in self._allowed:
            names = [*self.hosts, *(self.public.hosts[:1] if self.public else ())]
            return self._refuse("Host", f"{', '.join(names[:-1])} or {names[-1]}" if names[1:] else names[0], host)
        path = request.path.partition("?")[0]
        if self.public is not None:
            is_socket = path == SOCKET_PATH and "Upgrade" in request.headers
            if path + "/" == self.public.prefix and not is_socket:  # the page's files are relative to its folder
                return self._response(HTTPStatus.PERMANENT_REDIRECT, CONTENT_TYPES[".txt"], b"", host, path + "/")
            path = path if is_socket or path in self._files else self.public.local_path(path)
        if path == SOCKET_PATH:
            origin = self._header(request.headers, "Origin")
            if origin is not None and origin not in self._origins:
                return self._refuse("Origin", "this page", origin)
            return None
        if path in self._files:
            content_type, content = self._files[path]
            return self._response(HTTPStatus.OK, content_type, content, host)
        if path == "/":
            text = NOT_BUILT.format(folder=self.folder).encode()
            return self._response(HTTPStatus.SERVICE_UNAVAILABLE, CONTENT_TYPES[".html"], text, host)
        return self._plain(
            HTTPStatus.NOT_FOUND,
            "no such file; behind a proxy where the page has a path, start palpate with --public-url "
            "https://HOST/PREFIX/; see docs/howto/serve.md",
        )

    @staticmethod
    def _header(headers: Headers, name: str) -> str | None:
        """Return a header, or an empty text for a repeated one, which matches no allowed value."""
        try:
            return headers.get(name)
        except MultipleValuesError:
            return ""

    def _refuse(self, name: str, allowed: str, value: str | None) -> Response:
        """Return the refusal of a header, with the option that would allow it."""
        printed = value if value and PRINTED_HEADER.fullmatch(value) else None
        url = "http://HOST:PORT" if printed is None else printed if "://" in printed else f"http://{printed}"
        return self._plain(
            HTTPStatus.FORBIDDEN,
            f"{name} must be {allowed}, got {printed or 'another'}; forward the same port at both ends, or start "
            f"palpate with --public-url {url}/; see docs/howto/serve.md",
        )

    def _plain(self, status: HTTPStatus, text: str) -> Response:
        return self._response(status, CONTENT_TYPES[".txt"], f"{text}\n".encode(), self.hosts[0])

    def _response(
        self, status: HTTPStatus, content_type: str, content: bytes, host: str, location: str | None = None
    ) -> Response:
        sockets = f"ws://{host}" + (f" {self.public.socket_origin}" if self.public else "")
        policy = (
            "default-src 'self'; style-src 'self' 'unsafe-inline'; img-src 'self' data: blob:; "
            f"connect-src 'self' {sockets}; frame-ancestors {self._ancestors}; base-uri 'none'; form-action 'none'"
        )
        headers = Headers(
            {
                "Content-Type": content_type, "Content-Length": str(len(content)), "Cache-Control": "no-store",
                "Content-Security-Policy": policy, "X-Content-Type-Options": "nosniff",
                "Referrer-Policy": "no-referrer", "Cross-Origin-Resource-Policy": "same-origin", "Connection": "close",
            }
        )  # fmt: skip
        if location is not None:
            headers["Location"] = location
        return Response(status.value, status.phrase, headers, content)
