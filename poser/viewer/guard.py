"""Who may open the viewer's page: nobody else's page in the same browser, and no garbage is told.

A web page of another origin may open a WebSocket to this machine, and by a name that it lets point here
(DNS rebinding) read pages of it: a browser tells both, in Origin and Host.
"""

from __future__ import annotations

import asyncio
import http
import ipaddress
import logging
import socket
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any
from urllib.parse import urlsplit

LOG = logging.getLogger("poser.viewer.socket")


def is_ours(host: str | None, origins: list[str], names: frozenset[str]) -> bool:
    """Whether a request with these headers is of our own page, or of no page at all.

    names: by which this machine is called. Any address as a number is right: no name was pointed there.
    """
    if host is None or not _known(urlsplit(f"//{host}"), names):
        return False
    return all(o.lower() in (f"http://{host}".lower(), f"https://{host}".lower()) for o in origins)


def _known(where: Any, names: frozenset[str]) -> bool:
    try:
        name = (where.hostname or "").rstrip(".")
        where.port  # noqa: B018 raises ValueError for what is no port
    except ValueError:
        return False
    if name in names:
        return True
    try:
        ipaddress.ip_address(name)
    except ValueError:
        return False
    return True


def names_of(host: str) -> frozenset[str]:
    """By which names the page on a host may be asked for."""
    own = socket.gethostname().lower()
    return frozenset({"localhost", host.lower(), own, f"{own}.local"})


@contextmanager
def guarded(host: str, protocol: str) -> Iterator[None]:
    """Servers of viser that are made in the block refuse other pages, and what is no client of theirs.

    viser has no setting for it, and starts the server as it is made. protocol: what a client asks for.
    """
    import websockets.asyncio.server as websockets

    real, names = websockets.serve, names_of(host)

    def serve(*words: Any, process_request: Any = None, **more: Any) -> Any:
        # What breaks in a connection is its sender's; it must not be told in the user's terminal.
        asyncio.get_running_loop().set_exception_handler(lambda loop, context: None)
        checked = _checked(process_request, names, protocol)
        return real(*words, process_request=checked, logger=LOG, **more)

    websockets.serve = serve  # type: ignore[assignment, misc]
    try:
        yield
    finally:
        websockets.serve = real  # type: ignore[misc]


def _checked(then: Any, names: frozenset[str], protocol: str) -> Callable[[Any, Any], Any]:
    def check(connection: Any, request: Any) -> Any:
        headers = request.headers
        hosts = headers.get_all("Host")
        host = hosts[0] if len(hosts) == 1 else None
        if not is_ours(host, headers.get_all("Origin"), names):
            return connection.respond(http.HTTPStatus.FORBIDDEN, "another page or host name\n")
        if headers.get("Upgrade", "").lower() == "websocket":
            asked = [w.strip() for w in headers.get("Sec-WebSocket-Protocol", "").split(",")]
            if protocol not in asked:
                return connection.respond(http.HTTPStatus.BAD_REQUEST, "no page of this viewer\n")
        return then(connection, request) if then is not None else None

    return check


LOG.addHandler(logging.NullHandler())
LOG.propagate = False
