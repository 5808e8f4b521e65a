"""HTTP access to the files of the page, and checks of requests."""

from __future__ import annotations

from http import HTTPStatus
from pathlib import Path

from websockets.datastructures import Headers, MultipleValuesError
from websockets.http11 import Request, Response

PAGE_FOLDER = Path(__file__).parents[1] / "page"
SOCKET_PATH = "/session"
CONTENT_TYPES = {
    ".html": "text/html; charset=utf-8", ".js": "text/javascript; charset=utf-8", ".css": "text/css; charset=utf-8",
    ".svg": "image/svg+xml", ".png": "image/png", ".ico": "image/x-icon", ".json": "application/json",
    ".webmanifest": "application/manifest+json", ".woff2": "font/woff2", ".wasm": "application/wasm",
    ".txt": "text/plain; charset=utf-8",
}  # fmt: skip
NOT_BUILT = (
    "<!doctype html><title>palpate</title><h1>The page was not built</h1><p>The server runs, but this copy of palpate "
    "has no page: {folder} has no index.html. A wheel contains the page; docs/view.md describes how to build it from "
    "the sources. Programs can use this server without the page: see docs/protocol.md."
)


class Page:
    """The files of the page, read at the start, and the checks of requests.

    Parameters
    ----------
    hosts : sequence of str
        Allowed ``Host`` headers, with the port.
    folder : path
        Folder of the page.
    """

    def __init__(self, hosts: list[str], folder: Path = PAGE_FOLDER) -> None:
        self.hosts, self.folder = tuple(hosts), folder
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
        if host not in self.hosts:
            return self._plain(HTTPStatus.FORBIDDEN, "Host must be the address of this server")
        path = request.path.partition("?")[0]
        if path == SOCKET_PATH:
            origin = self._header(request.headers, "Origin")
            if origin is not None and origin not in {f"http://{name}" for name in self.hosts}:
                return self._plain(HTTPStatus.FORBIDDEN, "Origin must be this page")
            return None
        if path in self._files:
            content_type, content = self._files[path]
            return self._response(HTTPStatus.OK, content_type, content, host)
        if path == "/":
            text = NOT_BUILT.format(folder=self.folder).encode()
            return self._response(HTTPStatus.SERVICE_UNAVAILABLE, CONTENT_TYPES[".html"], text, host)
        return self._plain(HTTPStatus.NOT_FOUND, "no such file")

    @staticmethod
    def _header(headers: Headers, name: str) -> str | None:
        """Return a header, or an empty text for a repeated one, which matches no allowed value."""
        try:
            return headers.get(name)
        except MultipleValuesError:
            return ""

    def _plain(self, status: HTTPStatus, text: str) -> Response:
        return self._response(status, CONTENT_TYPES[".txt"], f"{text}\n".encode(), self.hosts[0])

    @staticmethod
    def _response(status: HTTPStatus, content_type: str, content: bytes, host: str) -> Response:
        policy = (
            "default-src 'self'; style-src 'self' 'unsafe-inline'; img-src 'self' data: blob:; "
            f"connect-src 'self' ws://{host}; frame-ancestors 'none'; base-uri 'none'; form-action 'none'"
        )
        headers = Headers(
            {
                "Content-Type": content_type, "Content-Length": str(len(content)), "Cache-Control": "no-store",
                "Content-Security-Policy": policy, "X-Content-Type-Options": "nosniff",
                "Referrer-Policy": "no-referrer", "Cross-Origin-Resource-Policy": "same-origin", "Connection": "close",
            }
        )  # fmt: skip
        return Response(status.value, status.phrase, headers, content)
