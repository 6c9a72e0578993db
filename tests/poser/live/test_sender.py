"""The sender in ten lines and the receiver agree; so do the documentation and the code."""

from __future__ import annotations

import json
import re
import socket
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from mocap import orientation as ori
from poser.live import packets
from poser.live.packets import Packet

ROOT = Path(__file__).resolve().parents[3]


def test_the_example_sends_what_is_understood() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as receiver:
        receiver.bind(("127.0.0.1", 0))
        receiver.settimeout(10.0)
        port = receiver.getsockname()[1]
        line = [sys.executable, str(ROOT / "examples" / "send_udp.py")]
        done = subprocess.run(
            [*line, "--port", str(port), "--seconds", "0.5"],
            capture_output=True,
            text=True,
            timeout=30,
        )
        assert done.stdout == f"sent 30 messages to port {port}\n", done.stderr
        for seq in range(30):
            [packet] = packets.from_json(receiver.recv(9000))
            assert isinstance(packet, Packet)
            assert (packet.device, packet.seq) == ("head", seq)
            assert packet.R_world_sensor is not None
            turn = ori.rot_y(0.5 * np.sin(seq / 30))
            np.testing.assert_allclose(packet.R_world_sensor, turn, atol=1e-9)


def test_the_documented_message_is_a_message() -> None:
    text = (ROOT / "docs" / "live.md").read_text()
    [shown] = re.findall(r"^    (\{.*\})$", text, flags=re.MULTILINE)
    [packet] = packets.from_json(shown.encode())
    assert isinstance(packet, Packet)
    assert packet.seq == json.loads(shown)["seq"]


def test_every_reason_of_refusal_is_documented() -> None:
    text = "".join((ROOT / "docs" / name).read_text() for name in ("live.md", "devices.md"))
    pattern = r'(?:Rejected\(|rejected\[|fault\(|_answer\(\d+, )"([^"]+)"'
    for module in sorted((ROOT / "poser" / "live").rglob("*.py")):
        for word in re.findall(pattern, module.read_text()):
            assert f"`{word}`" in text or word == "receive error", f"{module.name}: {word}"


@pytest.mark.parametrize("module", ["poser.live.loop", "poser.live.samples", "poser.commands.live"])
def test_the_extra_is_not_needed_to_import(module: str) -> None:
    code = f"import sys, {module}; print([m for m in ('viser', 'pythonosc') if m in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60)
    assert done.stdout.strip() == "[]", done.stderr
