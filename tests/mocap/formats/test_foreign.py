"""Files of other kinds: refused with what to export instead."""

from __future__ import annotations

from pathlib import Path

import pytest

from mocap import formats
from mocap.errors import FormatError
from mocap.formats import _foreign

BROUGHT = {
    ".c3d": "marker positions.*export that as BVH",
    ".trc": "poser convert writes such files.*BVH",
    ".fbx": "Blender.*BVH",
    ".glb": "poser convert writes such files.*BVH",
    ".mot": "give the orientations' .sto",
    ".xlsx": "save each sheet as .csv.*MVNX",
    ".mtb": "MT Manager: File, Export",
    ".mvn": "MVNX: in MVN Analyze",
    ".zip": "unpack it",
}


@pytest.mark.parametrize("suffix", BROUGHT)
def test_what_to_export_instead(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"take{suffix.upper()}"
    path.write_bytes(b"anything")
    with pytest.raises(FormatError, match=BROUGHT[suffix]) as e:
        formats.read(path)
    assert str(path) in str(e.value)


def test_what_is_read_is_not_called_foreign() -> None:
    read = {s for f in formats.registry() if f.readable for s in f.suffixes}
    assert not read & set(_foreign.INSTEAD)


def test_a_file_is_sniffed_and_read_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    asked = []
    path = tmp_path / "x.one"
    path.write_text("one")

    def sniff(path: Path, head: bytes) -> bool:
        asked.append("sniff")
        return True

    def read(path: Path, options: formats.Options) -> formats.Document:
        asked.append("read")
        raise FormatError(path, "has nothing in it")

    only = formats.Format("one", (".one",), sniff, read)
    monkeypatch.setattr(formats, "registry", lambda: iter((only,)))
    from poser import files

    with pytest.raises(FormatError, match="nothing in it"):
        files.read(path)
    assert asked == ["sniff", "read"]
