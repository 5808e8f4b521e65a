"""The page's files over HTTP: a fixed list of them, and who may ask for them."""

from __future__ import annotations

from http import HTTPStatus
from pathlib import Path

from websockets.datastructures import Headers, MultipleValuesError
from websockets.http11 import Request, Response

__all__ = ["FOLDER", "SOCKET", "Page"]

FOLDER = Path(__file__).parent / "page"
SOCKET = "/session"
KINDS = {
    ".html": "text/html; charset=utf-8", ".js": "text/javascript; charset=utf-8", ".css": "text/css; charset=utf-8",
    ".svg": "image/svg+xml", ".png": "image/png", ".ico": "image/x-icon", ".json": "application/json",
    ".webmanifest": "application/manifest+json", ".woff2": "font/woff2", ".wasm": "application/wasm",
    ".txt": "text/plain; charset=utf-8",
}  # fmt: skip
NOT_BUILT = (
    "<!doctype html><title>palpate</title><h1>The page was not built</h1><p>The server runs, but this copy of palpate "
    "holds no page: {folder} has no index.html. A wheel contains the page; from the sources it is built as "
    "docs/view.md says. Programs can use this server without a page: docs/protocol.md."
)


class Page:
    """The files of a folder as they are at start, and the checks of what asks for them.

    Parameters
    ----------
    hosts : sequence of str
        What a request's ``Host`` may be, with the port.
    folder : path
    """

    def __init__(self, hosts: list[str], folder: Path = FOLDER) -> None:
        self.hosts, self.folder = tuple(hosts), folder
        self._files: dict[str, tuple[str, bytes]] = {}
        for path in sorted(folder.rglob("*")) if folder.is_dir() else ():
            if path.is_file() and path.suffix in KINDS:
                self._files["/" + path.relative_to(folder).as_posix()] = KINDS[path.suffix], path.read_bytes()
        if "/index.html" in self._files:
            self._files["/"] = self._files["/index.html"]

    @property
    def built(self) -> bool:
        """Whether there is a page."""
        return "/" in self._files

    def answer(self, request: Request) -> Response | None:
        """Return the response to a request, None for one that opens the socket and may."""
        host = self._one(request.headers, "Host")
        if host not in self.hosts:
            return self._plain(HTTPStatus.FORBIDDEN, "this server answers to its own address only")
        path = request.path.partition("?")[0]
        if path == SOCKET:
            origin = self._one(request.headers, "Origin")
            if origin is not None and origin not in {f"http://{name}" for name in self.hosts}:
                return self._plain(HTTPStatus.FORBIDDEN, "pages of other origins may not connect")
            return None
        if path in self._files:
            kind, content = self._files[path]
            return self._response(HTTPStatus.OK, kind, content, host)
        if path == "/":
            text = NOT_BUILT.format(folder=self.folder).encode()
            return self._response(HTTPStatus.SERVICE_UNAVAILABLE, KINDS[".html"], text, host)
        return self._plain(HTTPStatus.NOT_FOUND, "there is nothing here")

    @staticmethod
    def _one(headers: Headers, name: str) -> str | None:
        """Return a header that may stand there once; two of them are none that is allowed."""
        try:
            return headers.get(name)
        except MultipleValuesError:
            return ""

    def _plain(self, status: HTTPStatus, text: str) -> Response:
        return self._response(status, KINDS[".txt"], f"{text}\n".encode(), self.hosts[0])

    @staticmethod
    def _response(status: HTTPStatus, kind: str, content: bytes, host: str) -> Response:
        policy = (
            "default-src 'self'; style-src 'self' 'unsafe-inline'; img-src 'self' data: blob:; "
            f"connect-src 'self' ws://{host}; frame-ancestors 'none'; base-uri 'none'; form-action 'none'"
        )
        headers = Headers(
            {
                "Content-Type": kind, "Content-Length": str(len(content)), "Cache-Control": "no-store",
                "Content-Security-Policy": policy, "X-Content-Type-Options": "nosniff",
                "Referrer-Policy": "no-referrer", "Cross-Origin-Resource-Policy": "same-origin", "Connection": "close",
            }
        )  # fmt: skip
        return Response(status.value, status.phrase, headers, content)
