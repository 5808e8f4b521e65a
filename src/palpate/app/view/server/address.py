"""Address of the server: its socket, its host names, and the browser that opens it."""

from __future__ import annotations

import errno
import ipaddress
import os
import socket
import sys
import webbrowser

from palpate.faults import InputError

DEFAULT_PORT = 8765
LOOPBACK = "127.0.0.1"
PORT_ATTEMPTS = 20


def open_listener(host: str, port: int) -> socket.socket:
    """Return a socket that listens on a port, or on the next free one."""
    try:
        address = ipaddress.ip_address(host)
    except ValueError:
        raise InputError(f"host must be an IP address, got {host!r}; use an address such as {LOOPBACK}") from None
    if address.is_unspecified:
        raise InputError(
            f"host must be a single address, got {host!r}; give the address by which other machines reach this one"
        )
    family = socket.AF_INET6 if address.version == 6 else socket.AF_INET
    for at in range(port, min(port + PORT_ATTEMPTS, 65536)):
        try:
            return socket.create_server((host, at), family=family)
        except OSError as error:
            if error.errno == errno.EADDRNOTAVAIL or (error.errno or 0) < 0:  # errors of the resolver are negative
                raise InputError(f"host must be an address of this machine, got {host!r}; try {LOOPBACK}") from error
            if error.errno not in (errno.EADDRINUSE, errno.EACCES):
                raise
    raise InputError(f"port must be free, got {port} to {port + PORT_ATTEMPTS - 1}, all busy; choose another port")


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
