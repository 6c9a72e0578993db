"""Every finding has its sentence, every sentence its finding: read from the source, so none is missed."""

from __future__ import annotations

import ast
import string
from collections.abc import Iterator
from pathlib import Path

import pytest

from mocap.findings import Finding, Words, doubt
from mocap.words import checks, readers, references, sentence

ROOT = Path(__file__).resolve().parents[2]
TABLES = (checks.WORDS, readers.WORDS, references.WORDS)
ALL: dict[str, Words] = {code: words for table in TABLES for code, words in table.items()}


def calls() -> Iterator[tuple[str, set[str] | None]]:
    """(code, names of its details) of each finding of readers; names None where they are not spelt out."""
    for package in ("mocap", "learned", "poser"):
        for path in (ROOT / package).rglob("*.py"):
            for node in ast.walk(ast.parse(path.read_text())):
                if not (isinstance(node, ast.Call) and isinstance(node.func, ast.Name)):
                    continue
                if node.func.id not in ("doubt", "assumption") or not node.args:
                    continue
                if isinstance(node.args[0], ast.Constant):
                    names = {k.arg for k in node.keywords if k.arg}
                    yield str(node.args[0].value), names


def test_tables_do_not_overlap() -> None:
    assert len(ALL) == sum(map(len, TABLES))


def test_every_finding_of_a_reader_has_words_for_what_it_carries() -> None:
    for code, names in calls():
        words = ALL[code]
        if isinstance(words, str):
            wanted = {name for _, name, _, _ in string.Formatter().parse(words) if name}
            assert wanted == names, code


def test_no_words_without_a_finding() -> None:
    text = "".join(
        p.read_text()
        for package in ("mocap", "learned", "poser")
        for p in (ROOT / package).rglob("*.py")
        if p.parent.name != "words"
    )
    assert [code for code in ALL if f'"{code}"' not in text] == []


def test_a_finding_of_ones_own_brings_its_sentence() -> None:
    assert sentence(doubt("mine", "head", said="is upside down")) == "sensor head: is upside down"
    # As files of before there were details have it.
    old = Finding("info", "head", "x", None, {"said": "sensor head: is upside down"})
    assert sentence(old) == "sensor head: is upside down"
    with pytest.raises(KeyError, match="unheard-of"):
        sentence(doubt("unheard-of"))
