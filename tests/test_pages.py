"""Docstrings become lists on the pages."""

from __future__ import annotations

import importlib.util
from pathlib import Path
from typing import Any

import pytest


@pytest.fixture(scope="module")
def fields() -> Any:
    pytest.importorskip("griffe")
    path = Path(__file__).parents[1] / "docs" / "fields.py"
    spec = importlib.util.spec_from_file_location("fields", path)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_names_are_listed(fields: Any) -> None:
    said = "A thing.\n\nrate: in Hz;\nonce. p (T,3) m, q: places: two. smooth_*: more. Raises E."
    listed = fields.listed(said, {"rate", "p", "q", "smooth_x"})
    assert listed == (
        "A thing.\n\n- **rate**: in Hz; once.\n- **p (T,3) m, q**: places: two.\n- **smooth_***: more."
        "\n\nRaises E."
    )


@pytest.mark.parametrize("text", ["one: it.", "one: it. other: no name.", "    one: 1. two: 2."])
def test_the_rest_stays(fields: Any, text: str) -> None:
    assert fields.listed(text, {"one", "two"}) == text
