"""Server of a viewer page on a local port."""

from __future__ import annotations

import errno
import ipaddress
import socket
import sys
import threading
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

from drake_rho.display.meshcat.ports import address_of, on_free_port

_CLIENTS = 32
"""Largest number of connections at a time; further ones are closed."""

_PATIENCE = 10.0
"""Longest time to wait for a client to send or receive [s]."""


class _Server(ThreadingHTTPServer):
    """Server with a bounded number of connections, silent when a client hangs up."""

    def __init__(self, address: tuple[str, int], handler: type[BaseHTTPRequestHandler]) -> None:
        self._free = threading.BoundedSemaphore(_CLIENTS)
        super().__init__(address, handler)

    def verify_request(self, request: object, client_address: object) -> bool:
        """Return whether there is room for another connection."""
        return self._free.acquire(blocking=False)

    def process_request_thread(self, request: Any, client_address: Any) -> None:
        """Answer one client."""
        try:
            super().process_request_thread(request, client_address)
        finally:
            self._free.release()

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Ignore clients that have hung up or stopped."""
        if not isinstance(sys.exception(), OSError):
            super().handle_error(request, client_address)


class PageServer:
    """Server of a single page, which runs until it is closed."""

    def __init__(self, server: ThreadingHTTPServer, host: str) -> None:
        self._server = server
        name = "localhost" if host == "*" else host
        self.url = f"http://{name}:{server.server_address[1]}"
        self._thread = threading.Thread(target=server.serve_forever, daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Stop serving."""
        self._server.shutdown()
        self._server.server_close()
        self._thread.join()


def serve(page: str, *, host: str = "localhost", port: int | None = None) -> PageServer:
    """Serve a page.

    Only requests to this server by its own name or by an address are answered: a page of another
    site whose name resolves to this machine (DNS rebinding) cannot read this one.

    Args:
        page: the page, HTML.
        host: network interface; "*" for all interfaces.
        port: first port to try, at least 1024; 7000 if not given.

    Raises:
        OSError: no port is free, or the interface does not exist.
        ValueError: the port is out of range.
    """
    content = page.encode()

    class Handler(BaseHTTPRequestHandler):
        timeout = _PATIENCE

        def do_GET(self) -> None:
            if not _is_own(self.headers.get("Host", ""), host):
                self.send_error(HTTPStatus.MISDIRECTED_REQUEST)
                return
            if self.path.split("?")[0] not in ("/", "/index.html"):
                self.send_error(HTTPStatus.NOT_FOUND)
                return
            self.send_response(HTTPStatus.OK)
            self.send_header("Content-Type", "text/html; charset=utf-8")
            self.send_header("Content-Length", str(len(content)))
            self.end_headers()
            self.wfile.write(content)

        def log_message(self, *_: object) -> None:
            """Log nothing."""

    address = "" if host == "*" else address_of(host)

    def start(number: int) -> ThreadingHTTPServer | None:
        try:
            return _Server((address, number), Handler)
        except OSError as error:
            if error.errno in (errno.EADDRINUSE, errno.EACCES):
                return None
            raise OSError(f"host: got {host!r}, expected a network interface ({error})") from None

    return PageServer(on_free_port(start, host, port), address or host)


def _is_own(header: str, host: str) -> bool:
    """Return whether a request names this server: by its own host name, or by an address.

    The port is ignored, since tunnels have other ports.

    Args:
        header: field `Host` of the request.
        host: network interface of the server.
    """
    name = header.rpartition(":")[0] if not header.endswith("]") and ":" in header else header
    name = name.strip("[]").lower()
    try:
        ipaddress.ip_address(name)
    except ValueError:
        own = {"localhost", host.lower()}
        return name in (own | {socket.gethostname().lower()} if host == "*" else own)
    return True
