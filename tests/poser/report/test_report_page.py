"""The report as a browser shows it: rendered without a network, looked at as a picture and as a document."""

from __future__ import annotations

import re
import shutil
import subprocess
from pathlib import Path

import matplotlib.image
import numpy as np
import pytest

from poser.__main__ import main

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")
FLAGS = (
    "--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run",
    "--disable-background-networking", "--disable-component-update", "--disable-sync",
    "--host-resolver-rules=MAP * ~NOTFOUND",
)  # fmt: skip


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("demo")
    assert main(["demo", "-o", str(folder), "--seconds", "3"]) == 0
    return folder / "report.html"


def test_page_needs_nothing_from_outside(page: Path) -> None:
    text = page.read_text()
    assert not re.findall(r"(?:src|href)\s*=\s*[\"']?(?!data:|#)[a-z]", text, flags=re.IGNORECASE)
    # Nor styles and scripts: the only address in the page is the name of SVG.
    assert set(re.findall(r"\w+://[^\s\"'<>)]+", text)) <= {"http://www.w3.org/2000/svg"}
    ways = r"@import|url\((?!data:|#)|\bfetch\(|XMLHttpRequest|WebSocket|EventSource|importScripts|\bimport\("
    assert not re.findall(ways, text)


@pytest.mark.skipif(CHROMIUM is None, reason="no Chromium on this machine")
def test_page_renders(page: Path, tmp_path: Path) -> None:
    assert CHROMIUM is not None
    shot = tmp_path / "page.png"
    common = (CHROMIUM, *FLAGS, f"--user-data-dir={tmp_path / 'profile'}")
    subprocess.run(
        [*common, "--window-size=1300,2000", f"--screenshot={shot}", page.as_uri()],
        check=True, capture_output=True, timeout=120,
    )  # fmt: skip
    image = matplotlib.image.imread(shot)[..., :3]
    assert image.shape[:2] == (2000, 1300)
    # Ink all down the page: the table, the skeletons and the curves.
    rows = (image.min(axis=2) < 0.6).mean(axis=1)
    thirds = [part.max() for part in np.array_split(rows, 3)]
    assert min(thirds) > 0.01
    dom = subprocess.run(
        [*common, "--dump-dom", page.as_uri()],
        check=True, capture_output=True, text=True, timeout=120,
    ).stdout  # fmt: skip
    for word in ("SOP", "SIP", "mean pose", "position"):
        assert word in dom
    legend = re.search(r'<p id="pl-legend".*?</p>', dom, flags=re.DOTALL)
    assert legend is not None and "SOP" in legend[0] and "hybrid (DIP)" in legend[0]
