"""`poser compare --cluster` on a scheduler of Dask's own, with workers in other processes."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

from mocap import sensors, synthesis
from mocap.formats.native import write_recording
from mocap.synthesis import motions
from poser.__main__ import main

pytest.importorskip("distributed")

# In a process of its own: Dask's threads, signal handlers and warnings are not pytest's.
SCHEDULER = """
import sys
from dask.distributed import LocalCluster
if __name__ == "__main__":
    with LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as cluster:
        print(cluster.scheduler_address, flush=True)
        sys.stdin.read()
"""


def test_a_cluster_gives_what_one_process_gives(tmp_path: Path) -> None:
    names = ("walk", "squat", "leg_raise")
    paths = []
    for k, name in enumerate(names):
        paths.append(str(tmp_path / f"{name}.npz"))
        motion = getattr(motions, name)(4.0).slice(75, 123)
        write_recording(paths[-1], synthesis.recording(motion, sensors.SIX, synthesis.Noise(), k))
    words = ["compare", *paths, "--solver", "banded", "--methods", "sop,sip"]
    assert main([*words, "-o", str(tmp_path / "one")]) == 0
    script = tmp_path / "scheduler.py"
    script.write_text(SCHEDULER)
    with subprocess.Popen(
        [sys.executable, str(script)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as scheduler:
        assert scheduler.stdout is not None
        address = scheduler.stdout.readline().strip()
        try:
            # A process of its own, as a user has it: Dask's client leaves threads behind.
            done = subprocess.run(
                [sys.executable, "-m", "poser", *words, "-o", str(tmp_path / "many"),
                 "--cluster", address],
                capture_output=True, text=True, timeout=240,
            )  # fmt: skip
        finally:
            scheduler.communicate("", timeout=60)
    assert done.returncode == 0, done.stderr
    one, many = (json.loads((tmp_path / f / "results.json").read_text()) for f in ("one", "many"))
    assert [r["name"] for r in many["recordings"]] == list(names)
    for a, b in zip(one["recordings"], many["recordings"], strict=True):
        for method in ("sop", "sip"):
            assert b["methods"][method]["sip_deg"] == pytest.approx(
                a["methods"][method]["sip_deg"], rel=1e-6
            )
