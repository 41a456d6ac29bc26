"""Network interface and free port of a server."""

from __future__ import annotations

import socket
from collections.abc import Callable
from typing import TypeVar

_Server = TypeVar("_Server")
_FIRST = 7000
_TRIED = 100


def address_of(host: str) -> str:
    """Return the address to listen on: `host`, or 127.0.0.1 if localhost cannot be resolved.

    A minimal Debian 12 has no /etc/hosts, which would define the name localhost.
    """
    if host == "localhost":
        try:
            socket.getaddrinfo(host, None)
        except OSError:
            return "127.0.0.1"
    return host


def on_free_port(
    start: Callable[[int], _Server | None], host: str, port: int | None = None
) -> _Server:
    """Start a server on `port`, or on the next one that is free.

    Args:
        start: starts a server on a port, or returns None if the port is in use.
        host: network interface, for the message.
        port: first port to try, at least 1024; 7000 if not given.

    Raises:
        OSError: no port is free.
        ValueError: the port is out of range.
    """
    first = _FIRST if port is None else port
    if not 1024 <= first <= 65535:
        raise ValueError(f"port: got {port}, expected 1024 to 65535")
    for number in range(first, min(first + _TRIED, 65536)):
        if (server := start(number)) is not None:
            return server
    raise OSError(f"no free port from {first} on {host}")
