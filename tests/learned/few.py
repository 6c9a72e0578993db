"""Small validation sets, for tests of whole runs."""

from __future__ import annotations

from dataclasses import replace

import pytest

from learned.registry import NETWORKS


def few_windows(monkeypatch: pytest.MonkeyPatch, **most: int) -> None:
    """At most about so many validation windows of each network named."""
    for network, count in most.items():
        monkeypatch.setitem(NETWORKS, network, replace(NETWORKS[network], most_windows=count))
