"""Where the server listens, and how a person gets there."""

from __future__ import annotations

import errno
import ipaddress
import os
import socket
import sys
import webbrowser

from palpate.faults import InputError

__all__ = ["LOOPBACK", "PORT", "hosts", "is_loopback", "listening", "opened_in_browser"]

LOOPBACK = "127.0.0.1"
PORT = 8765
TRIES = 20  # ports


def listening(host: str, port: int) -> socket.socket:
    """Return a socket that listens on a port, or on the next one that is free.

    Raises
    ------
    InputError
        The address is none of this machine, or none of the ports is free.
    """
    try:
        address = ipaddress.ip_address(host)
    except ValueError:
        raise InputError(f"host = {host!r}: allowed is an address of this machine, such as {LOOPBACK}") from None
    if address.is_unspecified:
        raise InputError(
            f"host = {host!r}: give the one address by which others reach this machine; requests that were sent to "
            "other names are refused"
        )
    family = socket.AF_INET6 if address.version == 6 else socket.AF_INET
    for at in range(port, min(port + TRIES, 65536)):
        try:
            return socket.create_server((host, at), family=family)
        except OSError as error:
            if error.errno == errno.EADDRNOTAVAIL or (error.errno or 0) < 0:  # the resolver's numbers are negative
                raise InputError(f"host = {host!r} is no address of this machine") from error
            if error.errno not in (errno.EADDRINUSE, errno.EACCES):
                raise
    raise InputError(f"port = {port}: neither it nor the {TRIES - 1} after it are free; choose another")


def is_loopback(host: str) -> bool:
    """Return whether only this machine reaches an address."""
    return ipaddress.ip_address(host).is_loopback


def hosts(host: str, port: int) -> list[str]:
    """Return what the ``Host`` of a request to this server may be; the first is for people."""
    own = f"[{host}]" if ":" in host else host
    names = [own] if not is_loopback(host) else [own, LOOPBACK, "localhost", "[::1]"]
    return [f"{name}:{port}" for name in dict.fromkeys(names)]


def opened_in_browser(address: str) -> bool:
    """Open an address in a browser with a window; return whether there is one."""
    if sys.platform.startswith("linux") and not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
        return False  # a browser in the terminal would take it from us
    try:
        return webbrowser.open(address)
    except webbrowser.Error:
        return False
