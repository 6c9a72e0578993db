"""Files as the commands see them: read what was expected, write what is whole, name what is wrong."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mocap.errors import FormatError, PoserError
from mocap.findings import doubt
from mocap.words import sentence
from poser.console import UsageError, note
from poser.exports import WRITERS, Export

if TYPE_CHECKING:
    import numpy as np

    from mocap.formats import Content, Document, Options
    from mocap.motion import Motion
    from mocap.recording import RawRecording, Recording

_KINDS = {
    "motion": "a motion",
    "recording": "a calibrated recording",
    "raw": "a raw recording",
}
_HINTS = {
    ("raw", "recording"): "; poser calibrate makes the one from the other",
    ("recording", "raw"): "; it needs no calibration",
    ("motion", "recording"): "; poser synthesize puts virtual sensors on a motion",
    ("motion", "raw"): "; poser synthesize --raw puts virtual sensors on a motion",
}


def read(path: Path, options: Options | None = None) -> Document:
    """Any file of a known format."""
    from mocap import formats

    doc = formats.read(path, options)
    own = _overridden_rate(path, options, doc)
    if own is None:
        return doc
    told = doubt("rate-told", stated_hz=own, read_hz=doc.content.rate_hz)
    return replace(doc, doubts=(*doc.doubts, told), stated_hz=own)


def _overridden_rate(path: Path, options: Options | None, doc: Document) -> float | None:
    """The rate in Hz that a file states itself, where `doc` was read with another one of `options`."""
    from mocap import formats

    said = options.rate_hz if options is not None else None
    if options is None or said is None or doc.content.rate_hz != said:
        return None
    try:
        own = formats.read(path, replace(options, rate_hz=None))
    except FormatError:
        return None  # none is stated
    same = abs(own.content.rate_hz / said - 1) < 1e-3  # .bvh files round the time of a frame
    # A reader that assumes a rate says so, and that changes with what it is told.
    return None if same or own.assumed != doc.assumed else own.content.rate_hz


def motion(path: Path, options: Options | None = None, quiet: bool = False) -> Motion:
    """The motion in a file; raises FormatError where it holds something else."""
    return _expect(path, "motion", options, quiet)  # type: ignore[return-value]


def recording(path: Path, options: Options | None = None, gaps: bool = True) -> Recording:
    """The calibrated recording in a file; raises FormatError where it holds something else.

    gaps: note samples that are missing; False where `note_gaps` will, of the part that is used.
    """
    return _expect(path, "recording", options, gaps=gaps)  # type: ignore[return-value]


def note_gaps(path: Path, used: Recording, whole: Recording) -> None:
    """Note the samples that are missing in what is used of a recording."""
    from mocap.formats._physics import missing
    from mocap.timeline import words

    where = f"{path}, {words(used)}" if len(used) < len(whole) else str(path)
    for finding in missing(used):
        note(f"{where}: {sentence(finding)}")


def thinned(
    path: Path,
    recording: Recording,
    most_hz: float | None = None,
    then: str = ", and given back at its own rate (--rate says otherwise)",
) -> Recording:
    """The recording at no more than `most_hz` (default: 120), which is noted. then: what follows."""
    from mocap import thinning

    fewer = thinning.thinned(recording, most_hz or thinning.MOST_HZ)
    if fewer is not recording:
        n = round(recording.rate_hz / fewer.rate_hz)
        note(
            f"{path}: runs at {recording.rate_hz:g} Hz; poses are estimated at {fewer.rate_hz:.4g} Hz, "
            f"from the mean of every {n} samples{then}"
        )
    return fewer


def note_no_acc(path: Path, used: Recording) -> None:
    """Note the sensors of which a network reads an acceleration of zero throughout."""
    import numpy as np

    silent = np.any(used.valid, axis=0) & ~np.any(used.acc_valid, axis=0)
    names = [n for k, n in enumerate(used.sensors) if silent[k]]
    if names:
        note(
            f"{path}: no acceleration of {', '.join(names)}: networks are trained with it and read zeros"
        )


def check_there(path: Path, option: str, words: Sequence[str]) -> None:
    """Raises PoserError for a file that is absent, naming the words that the option takes beside files."""
    if not path.exists():
        raise PoserError(
            f"{path}: no such file; {option} takes {', '.join(words)} or a motion file"
        )


def raw(path: Path, options: Options | None = None) -> RawRecording:
    """The raw recording in a file; raises FormatError where it holds something else."""
    return _expect(path, "raw", options)  # type: ignore[return-value]


def _expect(
    path: Path, kind: str, options: Options | None, quiet: bool = False, gaps: bool = True
) -> Content:
    from mocap.formats._physics import missing
    from mocap.recording import Recording

    doc = read(path, options)
    content = expected(path, doc, kind)
    untold = missing(content) if not gaps and isinstance(content, Recording) else []
    for finding in () if quiet else doc.doubts:
        if finding not in untold:
            note(f"{path}: {sentence(finding)}")
    return content


def expected(path: Path, doc: Document, kind: str) -> Any:
    """The content of what was read of a file; raises FormatError where it is of another kind."""
    if doc.kind != kind:
        hint = _HINTS.get((doc.kind, kind), "")
        if kind == "motion" and getattr(doc.content, "reference", None) is not None:
            first = "once calibrated, " if doc.kind == "raw" else ""
            hint = f"; {first}poser compare writes the reference motion in it as reference.npz"
        raise FormatError(path, f"holds {_KINDS[doc.kind]}, expected {_KINDS[kind]}{hint}")
    return doc.content


@contextmanager
def about(path: Path) -> Iterator[None]:
    """An error of the project in this block is about `path` and says so."""
    try:
        yield
    except (FormatError, UsageError):
        raise
    except PoserError as e:
        raise PoserError(f"{path}: {e}") from e


def check_output(path: Path, inputs: Sequence[Path], suffixes: tuple[str, ...]) -> None:
    """Before any work: can `path` be written, and is it none of the inputs?

    Raises UsageError for a wrong suffix or an input, PoserError for a folder that is missing.
    """
    from mocap.formats._files import check_target

    if path.suffix.lower() not in suffixes:
        raise UsageError(f"{path}: the output's name must end in {' or '.join(suffixes)}")
    folder = path.parent
    if not folder.is_dir():
        raise PoserError(f"{path}: there is no folder {folder} to write it to")
    if path.is_dir():
        raise PoserError(f"{path}: is a folder, expected a file name")
    target = check_target(path)
    if not os.access(folder, os.W_OK):
        raise PoserError(f"{path}: the folder {folder} cannot be written to")
    for source in inputs:
        if _same(path, source):
            raise UsageError(f"{path}: is the input; the output needs a name of its own")
    if path.is_symlink():
        note(f"{path}: is a link; {target} is written")
    elif target.exists():
        note(f"{path}: an earlier file of that name is replaced")


def _same(a: Path, b: Path) -> bool:
    try:
        return a.samefile(b)
    except OSError:
        return False


@contextmanager
def folder(path: Path, single: bool = False) -> Iterator[None]:
    """As `make_folder`; folders that were made for it are removed again where nothing was put into them.

    single: raise PoserError where another run writes into the folder; several `poser synthesize` may.
    """
    from mocap.formats._files import alone

    made = [p for p in (path, *path.parents) if not p.exists()]
    make_folder(path)
    try:
        with alone(path) if single else nullcontext():
            yield
    finally:
        for p in made:
            try:
                p.rmdir()
            except OSError:  # holds something
                break


def make_folder(path: Path) -> None:
    """A folder to write into, made where it is missing; raises PoserError where it cannot be."""
    try:
        path.mkdir(parents=True, exist_ok=True)
    except FileExistsError as e:
        raise PoserError(f"{path}: is a file, expected a folder") from e
    except OSError as e:
        raise PoserError(f"{path}: the folder cannot be made: {e.strerror}") from e
    if not os.access(path, os.W_OK):
        raise PoserError(f"{path}: the folder cannot be written to")


def write(
    path: Path,
    content: Content,
    extra: Mapping[str, np.ndarray] | None = None,
    timed: bool = False,
    export: Export | None = None,
) -> None:
    """A motion as AMASS-style `.npz` or for another tool (`exports.WRITERS`), a recording as native `.npz`:
    whole or not at all.

    timed: a motion's `start_s` is known to be the recording's and is stated even where it is 0.
    """
    from mocap.formats import native
    from mocap.motion import Motion

    if isinstance(content, Motion):
        if path.suffix.lower() in WRITERS:
            WRITERS[path.suffix.lower()](path, content, export or Export())
        elif timed or content.start_s:
            native.write_motion(path, content, extra)
        else:
            from mocap.formats.amass import write_motion as write_amass

            write_amass(path, content, extra)
        return
    assert native.FORMAT.write is not None
    native.FORMAT.write(path, content)


def write_text(path: Path, text: str) -> None:
    """A text file in UTF-8: whole or not at all."""
    from mocap.formats._files import write_aside

    with write_aside(path) as aside:
        aside.write_text(text, encoding="utf-8")
