"""Addresses on the command line: `PORT` or `HOST:PORT`, localhost unless told otherwise."""

from __future__ import annotations

from dataclasses import dataclass

from poser.console import UsageError

LOCALHOST = "127.0.0.1"


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
    if not port.isdecimal() or not 0 < int(port) < 65536:
        raise UsageError(f"{what}: {text!r} is not PORT or HOST:PORT with a port from 1 to 65535")
    return Address(host.strip("[]") or LOCALHOST, int(port))
