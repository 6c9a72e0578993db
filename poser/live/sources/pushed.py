"""A small HTTP server for devices that push: POST alone, bodies of bounded size, nothing is served.

It runs in threads of its own, few of them, and a peer that is slow keeps one of them for seconds at most.
"""

from __future__ import annotations

import socket
import threading
import time
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

from mocap.errors import PoserError
from poser.live.addresses import Address, resolved
from poser.live.sources.threads import Mailbox

MAX_BODY = 1 << 20
PATIENCE_S = 5.0  # for a whole request
MAX_PEERS = 16


class _Server(ThreadingHTTPServer):
    daemon_threads = True
    block_on_close = False
    request_queue_size = 2 * MAX_PEERS

    def __init__(self, family: int, address: Any, box: Mailbox):
        self.address_family = family
        self.box = box
        self._free = threading.BoundedSemaphore(MAX_PEERS)
        super().__init__(address, _Handler)

    def server_bind(self) -> None:
        # Without the look-up of our own name that HTTPServer makes, which may take seconds.
        self.socket.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        self.socket.bind(self.server_address)
        self.server_address = self.socket.getsockname()

    def process_request(self, request: Any, client_address: Any) -> None:
        if not self._free.acquire(blocking=False):
            self.box.fault("too many connections")
            self.shutdown_request(request)
            return
        super().process_request(request, client_address)

    def process_request_thread(self, request: Any, client_address: Any) -> None:
        try:
            super().process_request_thread(request, client_address)
        finally:
            self._free.release()

    def handle_error(self, request: Any, client_address: Any) -> None:
        self.box.fault("connection broke off")


class _Handler(BaseHTTPRequestHandler):
    server: _Server
    timeout = PATIENCE_S
    server_version, sys_version = "poser", ""
    protocol_version = "HTTP/1.1"

    def do_POST(self) -> None:
        length = self.headers.get("Content-Length", "")
        if not length.isdecimal() or len(length) > 9:
            self._answer(411, "no length")
        elif int(length) > MAX_BODY:
            self._answer(413, "body too large")
        else:
            body = self._body(int(length))
            if body is None:
                self._answer(408, "body too slow")
            elif self.server.box.put(body, str(self.client_address[0])):
                self._answer(200, "")
            else:
                self._answer(503, "")

    def do_GET(self) -> None:
        self._answer(405, "not a POST")

    do_PUT = do_HEAD = do_DELETE = do_OPTIONS = do_PATCH = do_GET

    def _body(self, length: int) -> bytes | None:
        """The body; None where it does not come in time, however steadily it drips."""
        until, parts, left = time.monotonic() + PATIENCE_S, [], length
        while left:
            try:
                part = self.rfile.read1(left)
            except OSError:
                return None
            if not part or time.monotonic() > until:
                return None
            parts.append(part)
            left -= len(part)
        return b"".join(parts)

    def _answer(self, status: int, fault: str) -> None:
        if fault:
            self.server.box.fault(fault)
            self.close_connection = True
        self.send_response(status)
        self.send_header("Content-Length", "0")
        self.end_headers()

    def log_message(self, format: str, *args: Any) -> None:
        """Nothing: a terminal is not for strangers to write on."""


class PushServer:
    """The worker of kinds that push."""

    def __init__(self, address: Address):
        self._address = address
        self._server: _Server | None = None

    def start(self, post: Mailbox) -> None:
        family, to = resolved(
            self._address, f"cannot listen on {self._address}", socket.SOCK_STREAM
        )
        try:
            self._server = _Server(family, to, post)
        except OSError as e:
            raise PoserError(f"cannot listen on {self._address}: {e.strerror or e}") from e
        threading.Thread(
            target=self._server.serve_forever, kwargs={"poll_interval": 0.1}, daemon=True
        ).start()

    def stop(self) -> None:
        if self._server is not None:
            self._server.shutdown()
            self._server.server_close()
