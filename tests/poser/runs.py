"""What tests of training share: options of tiny networks, clips, two processes as torchrun starts them."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

from mocap.formats.amass import write_motion
from mocap.synthesis import motions

SMALL = ["--hidden", "8", "--batch", "2", "--frames", "12", "--every", "2", "--no-dropout"]


def three_clips(folders: Sequence[Path]) -> None:
    """clip0.npz to clip2.npz, one in each of three folders, which are made if missing."""
    pieces = (motions.squat, motions.arm_raises, motions.leg_raise)
    for k, (folder, make) in enumerate(zip(folders, pieces, strict=True)):
        folder.mkdir(parents=True, exist_ok=True)
        write_motion(folder / f"clip{k}.npz", make(2.0))


def together(programs: Sequence[str]) -> list[tuple[int, str, str]]:
    """Status, stdout and stderr of Python programs that run as the ranks of one world (gloo)."""
    with socket.socket() as s:
        s.bind(("127.0.0.1", 0))
        port = str(s.getsockname()[1])
    running = []
    for rank, code in enumerate(programs):
        world = {
            "WORLD_SIZE": str(len(programs)), "RANK": str(rank), "LOCAL_RANK": str(rank),
            "MASTER_ADDR": "127.0.0.1", "MASTER_PORT": port, "OMP_NUM_THREADS": "1",
        }  # fmt: skip
        running.append(
            subprocess.Popen(
                [sys.executable, "-c", code], env=os.environ | world, text=True,
                stdout=subprocess.PIPE, stderr=subprocess.PIPE,
            )
        )  # fmt: skip
    said = [p.communicate(timeout=240) for p in running]
    return [(p.returncode, *texts) for p, texts in zip(running, said, strict=True)]
