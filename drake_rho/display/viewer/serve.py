"""Server of a viewer page on a local port."""

from __future__ import annotations

import errno
import threading
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

from drake_rho.display.meshcat.ports import address_of, on_free_port


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
        def do_GET(self) -> None:
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
            return ThreadingHTTPServer((address, number), Handler)
        except OSError as error:
            if error.errno in (errno.EADDRINUSE, errno.EACCES):
                return None
            raise OSError(f"host: got {host!r}, expected a network interface ({error})") from None

    return PageServer(on_free_port(start, host, port), address or host)
