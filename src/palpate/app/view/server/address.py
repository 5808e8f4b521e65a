"""Address of the server: its socket, its host names, and the browser that opens it."""

from __future__ import annotations

import errno
import ipaddress
import os
import re
import socket
import sys
import webbrowser
from dataclasses import dataclass
from urllib.parse import unquote, urlsplit

from palpate.core.faults import InputError

DEFAULT_PORT = 8765
LOOPBACK = "127.0.0.1"
PORT_ATTEMPTS = 20
DEFAULT_PORTS = {"http": 80, "https": 443}
SOCKET_SCHEMES = {"http": "ws", "https": "wss"}
MAX_URL_CHARACTERS = 500
HOST_NAME = re.compile(r"[a-z0-9]([a-z0-9._-]*[a-z0-9])?|\[[0-9a-f:.]+\]")
URL_PATH = re.compile(r"(/[A-Za-z0-9._~!$&'()*+,;=:@%-]+)*/?")
URL_EXAMPLE = "write it as in https://host.example.org/prefix/"


@dataclass(frozen=True)
class PublicAddress:
    """The address by which browsers reach the page through a forwarded port or a proxy."""

    scheme: str
    host: str  # with the port, unless it is the scheme's own
    prefix: str  # path of the page, from and to a slash

    @property
    def origin(self) -> str:
        """The ``Origin`` of the page."""
        return f"{self.scheme}://{self.host}"

    @property
    def url(self) -> str:
        """The address of the page."""
        return self.origin + self.prefix

    @property
    def socket_origin(self) -> str:
        """Scheme and host of the socket."""
        return f"{SOCKET_SCHEMES[self.scheme]}://{self.host}"

    @property
    def is_loopback(self) -> bool:
        """Whether it is of the browser's own machine, as that of a forwarded port."""
        name = self.host if HOST_NAME.fullmatch(self.host) else self.host.rpartition(":")[0]
        return name in ("localhost", LOOPBACK, "[::1]")

    @property
    def hosts(self) -> tuple[str, ...]:
        """The ``Host`` headers of requests to it: a proxy may add the scheme's own port."""
        has_port = HOST_NAME.fullmatch(self.host) is None
        return (self.host,) if has_port else (self.host, f"{self.host}:{DEFAULT_PORTS[self.scheme]}")

    def local_path(self, path: str) -> str:
        """Return the path at the server for one of a request, from which a proxy has removed the prefix or not."""
        path = "/" + path.lstrip("/")
        prefix, decoded = unquote(self.prefix), unquote(path)
        if self.prefix != "/" and decoded.startswith(prefix):
            return "/" + decoded[len(prefix) :]
        return path


def public_address(url: str) -> PublicAddress:
    """Return the parts of an address such as ``https://host/prefix/``; a slash is added at its end."""
    try:
        problem = _problem_of_url(url)
    except ValueError:  # of a port, or of brackets
        problem = "a valid host and port"
    if problem:
        raise InputError(f"public_url must have {problem}, got {url!r:.80}; {URL_EXAMPLE}")
    parts = urlsplit(url)
    host = str(parts.hostname)
    if ":" in host:
        host = f"[{ipaddress.IPv6Address(host).compressed}]"  # as browsers write it
    if parts.port not in (None, DEFAULT_PORTS[parts.scheme]):
        host += f":{parts.port}"
    return PublicAddress(parts.scheme, host, parts.path.rstrip("/") + "/")


def _problem_of_url(url: str) -> str:
    """Return what an address must have and has not; empty if it can be used."""
    if re.search(r"\s|[\x00-\x1f\x7f]", url):  # some of which `urlsplit` removes
        return "no spaces"
    parts = urlsplit(url)
    name = parts.hostname or ""
    checks = {
        f"at most {MAX_URL_CHARACTERS} characters": len(url) <= MAX_URL_CHARACTERS,
        "the scheme http:// or https://": parts.scheme in DEFAULT_PORTS and "://" in url,
        "no name or password before its host": "@" not in parts.netloc,
        "no query (?) and no fragment (#)": "?" not in url and "#" not in url,
        "ASCII letters only (a host in its form xn--...)": url.isascii(),
        "a host": HOST_NAME.fullmatch(f"[{name}]" if ":" in name else name) is not None,
        "a port from 1 to 65535": parts.port is None or parts.port > 0,
        "a path of plain parts": URL_PATH.fullmatch(parts.path) is not None,
        "a path without . and ..": not {".", ".."} & set(unquote(parts.path).split("/")),
    }
    return next((text for text, holds in checks.items() if not holds), "")


def open_listener(host: str, port: int, attempts: int = PORT_ATTEMPTS) -> socket.socket:
    """Return a socket that listens on a port, or on the next free one of some."""
    try:
        address = ipaddress.ip_address(host)
    except ValueError:
        raise InputError(f"host must be an IP address, got {host!r}; use an address such as {LOOPBACK}") from None
    if address.is_unspecified:
        raise InputError(
            f"host must be a single address, got {host!r}; give the address by which other machines reach this one"
        )
    family = socket.AF_INET6 if address.version == 6 else socket.AF_INET
    for at in range(port, min(port + attempts, 65536)):
        try:
            return socket.create_server((host, at), family=family)
        except OSError as error:
            if error.errno == errno.EADDRNOTAVAIL or (error.errno or 0) < 0:  # errors of the resolver are negative
                raise InputError(f"host must be an address of this machine, got {host!r}; try {LOOPBACK}") from error
            if error.errno not in (errno.EADDRINUSE, errno.EACCES):
                raise
    if attempts == 1:
        raise InputError(f"port must be free with public_url, got {port}, which is busy; end what uses it")
    raise InputError(f"port must be free, got {port} to {port + attempts - 1}, all busy; choose another port")


def is_loopback(host: str) -> bool:
    """Return whether only this machine can reach an address."""
    return ipaddress.ip_address(host).is_loopback


def allowed_hosts(host: str, port: int) -> list[str]:
    """Return the allowed ``Host`` headers of requests; the first one is for the printed address."""
    bracketed_host = f"[{host}]" if ":" in host else host
    names = [bracketed_host] if not is_loopback(host) else [bracketed_host, LOOPBACK, "localhost", "[::1]"]
    return [f"{name}:{port}" for name in dict.fromkeys(names)]


def open_browser(address: str) -> bool:
    """Open an address in a graphical browser; return False if there is none."""
    if sys.platform.startswith("linux") and not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
        return False  # a text browser would block the terminal
    try:
        return webbrowser.open(address)
    except webbrowser.Error:
        return False
