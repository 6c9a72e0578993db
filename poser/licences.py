"""Whose terms and whose credit weights carry that began with other weights."""

from __future__ import annotations

from pathlib import Path
from typing import Any

NON_COMMERCIAL, PERMISSIVE = "CC BY-NC 4.0", "MIT"
OF_MOTIONS, OF_RECORDINGS = "that of the motions", "that of the recordings"
AND = ", and "  # between the licences of a description


def inherit(record: dict[str, Any], start: Path) -> None:
    """Add to a description's licence, credit and data those of the weights that the run starts from."""
    from learned import checkpoint

    origin = checkpoint.describe(start)
    stated, found = origin.get("licence"), origin.get("data")
    data: dict[str, Any] = found if isinstance(found, dict) else {}
    inherited = stated if isinstance(stated, str) else f"the unstated one of {start.name}"
    terms = dict.fromkeys([record["licence"], *inherited.split(AND)])
    if NON_COMMERCIAL in terms:  # asks for all that the permissive one does
        terms.pop(PERMISSIVE, None)
    record["licence"] = AND.join(terms)
    record["started_from"] = start.name
    credits = [c for c in (record["data"].get("credit"), data.get("credit")) if isinstance(c, str)]
    if credits:
        record["data"]["credit"] = " ".join(dict.fromkeys(credits))
    before = data.get("what")
    learnt = before if isinstance(before, str) else "what is not stated"
    record["data"]["what"] += f"; begun with {start.name}, trained on {learnt}"
