"""The viewer answers its own page alone, and garbage on its socket is nobody's business."""

from __future__ import annotations

import asyncio
import socket
import time
from collections.abc import Iterator
from typing import Any

import pytest

viser = pytest.importorskip("viser")

import websockets  # noqa: E402

from poser.viewer import stage  # noqa: E402


@pytest.fixture(scope="module")
def made() -> Iterator[Any]:
    server = stage.server("127.0.0.1", 0)
    yield server
    stage.stop(server)


def asked(port: int, *headers: str) -> int:
    """The status of a page."""
    with socket.create_connection(("127.0.0.1", port), timeout=10) as s:
        s.sendall("\r\n".join(["GET / HTTP/1.1", *headers, "", ""]).encode())
        return int(s.recv(64).split()[1])


def opened(port: int, origin: str | None, host: str = "127.0.0.1") -> bool:
    """Whether a WebSocket opens."""

    async def go() -> bool:
        protocol = websockets.Subprotocol(f"viser-v{viser.__version__}")
        try:
            async with websockets.connect(
                f"ws://{host}:{port}", subprotocols=[protocol], origin=origin, host="127.0.0.1",
                port=port, max_size=None,
            ) as ws:  # fmt: skip
                await asyncio.wait_for(ws.recv(), 10)
                return True
        except websockets.InvalidStatus:
            return False

    return asyncio.run(go())


def test_other_pages_and_other_names_are_refused(made: Any) -> None:
    port = made.get_port()
    for host in (f"127.0.0.1:{port}", f"localhost:{port}", f"[::1]:{port}"):
        assert asked(port, f"Host: {host}") == 200
    for host in (f"evil.example:{port}", "127.0.0.1.evil.example", "a:b", ""):
        assert asked(port, f"Host: {host}") == 403
    assert asked(port, f"Host: 127.0.0.1:{port}", "Origin: http://evil.example") == 403
    assert opened(port, None) and opened(port, f"http://127.0.0.1:{port}")
    for origin in ("http://evil.example", f"http://localhost:{port}", "null"):
        assert not opened(port, origin)
    assert not opened(port, f"http://evil.example:{port}", "evil.example")


def test_garbage_prints_nothing_and_the_page_goes_on(
    made: Any, capfd: pytest.CaptureFixture[str]
) -> None:
    port = made.get_port()
    for data in (b"\0" * 100, b"GET", b"GET / HTTP/1.1\r\n" + b"a" * 20000, b"\x16\x03\x01"):
        with socket.create_connection(("127.0.0.1", port), timeout=10) as s:
            s.sendall(data)

    async def garbage() -> None:
        protocol = websockets.Subprotocol(f"viser-v{viser.__version__}")
        for data in (b"garbage", "text", b"", b"\xc1" * 50, b"\x81\xa4type\xa4none"):
            try:
                async with websockets.connect(
                    f"ws://127.0.0.1:{port}", subprotocols=[protocol], max_size=None
                ) as ws:
                    await ws.send(data)
                    await asyncio.sleep(0.1)
            except websockets.ConnectionClosed:
                pass

    asyncio.run(garbage())
    with pytest.raises(websockets.InvalidStatus):
        asyncio.run(_plain(port))
    time.sleep(0.2)
    assert asked(port, f"Host: 127.0.0.1:{port}") == 200
    assert capfd.readouterr() == ("", "")


async def _plain(port: int) -> None:
    async with websockets.connect(f"ws://127.0.0.1:{port}"):
        pass


def test_nothing_is_shared(made: Any) -> None:
    assert made.request_share_url() is None
