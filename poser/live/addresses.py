"""Addresses on the command line: `PORT` or `HOST:PORT`, localhost unless told otherwise."""

from __future__ import annotations

import socket
from argparse import ArgumentTypeError
from dataclasses import dataclass
from typing import Any

from mocap.errors import PoserError
from poser.console import UsageError

LOCALHOST = "127.0.0.1"
LAST_PORT = 65535


@dataclass(frozen=True)
class Address:
    """Where to listen or to send to."""

    host: str
    port: int

    @property
    def is_local(self) -> bool:
        return self.host in (LOCALHOST, "localhost", "::1")

    def __str__(self) -> str:
        return f"[{self.host}]:{self.port}" if ":" in self.host else f"{self.host}:{self.port}"


def parse(text: str, what: str) -> Address:
    """`9000`, `0.0.0.0:9000`, `[::1]:9000`. Raises UsageError naming `what`."""
    host, _, port = text.rpartition(":")
    if not _is_port(port):
        raise UsageError(
            f"{what}: {text!r} is not PORT or HOST:PORT with a port from 1 to {LAST_PORT}"
        )
    return Address(host.strip("[]") or LOCALHOST, int(port))


def parse_host(text: str, default_port: int, what: str) -> Address:
    """`192.168.0.7`, `192.168.0.7:8080`, `8080`, `[::1]:8080`, or nothing for this machine. Raises UsageError
    naming `what`.
    """
    if not text:
        return Address(LOCALHOST, default_port)
    bare = not _is_port(text.rpartition(":")[2])
    if bare and (":" not in text or text.endswith("]")) and not text.isdecimal():
        return Address(text.strip("[]"), default_port)
    return parse(text, what)


def port(text: str) -> int:
    """The type of an argument: a port to serve on, 0 for any free one."""
    if text != "0" and not _is_port(text):
        raise ArgumentTypeError(
            f"{text!r} is not a port from 1 to {LAST_PORT}, or 0 for a free one"
        )
    return int(text)


def _is_port(text: str) -> bool:
    # Not isdecimal alone: int() refuses thousands of digits with an error of its own.
    return text.isdecimal() and len(text) <= 5 and 0 < int(text) <= LAST_PORT


def resolved(address: Address, name: str, kind: socket.SocketKind) -> tuple[int, Any]:
    """Family and socket address of a host, IPv4 where it has one. Raises PoserError naming `name`."""
    try:
        found = socket.getaddrinfo(address.host, address.port, type=kind)
    # UnicodeError: a name with an empty or too long part.
    except (OSError, UnicodeError) as e:
        raise PoserError(f"{name}: the host is unknown") from e
    family, _, _, _, to = min(found, key=lambda entry: entry[0] != socket.AF_INET)
    return family, to
