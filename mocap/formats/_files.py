"""Files as such: what may be opened, and writing so that an interruption never leaves half of one."""

from __future__ import annotations

import json
import os
import stat
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from functools import cache
from pathlib import Path
from typing import Any

from mocap.errors import FormatError, PoserError

try:
    import fcntl
except ImportError:  # not on Windows: nothing is locked there, and nothing of a killed run removed
    fcntl = None  # type: ignore[assignment]

ASIDE = ".poser-aside-"  # how the names of files begin that are being written
LOCK = ".poser-lock"
MOST_TEXT = 256 << 20  # bytes of a JSON file


def check_regular(path: Path) -> None:
    """Refuse what is neither a file nor a folder, before it is opened: opening a pipe waits for a writer.

    Raises FormatError; says nothing of a path where there is nothing.
    """
    if path.exists() and not (path.is_file() or path.is_dir()):
        raise FormatError(path, "is a pipe, a socket or a device, expected a regular file")


def read_text(path: Path) -> str:
    """The text of a regular file in UTF-8.

    Raises FormatError for a pipe, a device, or more than MOST_TEXT; OSError and UnicodeDecodeError as `open`.
    """
    check_regular(path)
    size = path.stat().st_size
    if size > MOST_TEXT:
        raise FormatError(path, f"is {size >> 20} MB, expected text of at most {MOST_TEXT >> 20}")
    return path.read_text(encoding="utf-8")


def read_json(path: Path) -> Any:
    """What a JSON file holds. As `read_text`, and FormatError where it is no JSON."""
    try:
        return json.loads(read_text(path))
    # RecursionError: "[[[[..."; ValueError: also bytes that are not UTF-8.
    except (ValueError, RecursionError) as e:
        raise FormatError(path, f"is not JSON ({e})") from e


def check_target(path: Path) -> Path:
    """The file that writing to `path` makes or replaces: a link is followed and stays one.

    Raises FormatError where that is a pipe or a device, a folder, or read-only.
    """
    check_regular(path)
    target = path.resolve() if path.is_symlink() else path
    try:
        mode = target.stat().st_mode
    except OSError:
        return target
    if stat.S_ISDIR(mode):
        raise FormatError(path, "is a folder, expected a file name")
    # By its bits, too: to root every file is writable.
    if not mode & 0o222 or not os.access(target, os.W_OK):
        raise FormatError(path, "is read-only and is not replaced; choose another name")
    return target


@contextmanager
def write_aside(path: str | Path) -> Iterator[Path]:
    """Yield a temporary path beside `path`; on success it replaces `path`, otherwise it is deleted.

    The temporary file lies in the same folder (so that the replacement is atomic) and has the same
    suffix (numpy appends one to names that lack it). The folder is made if it does not exist. Any
    exception, KeyboardInterrupt included, deletes the temporary file and leaves `path` as it was; those
    that killed runs left in the folder are removed. Raises FormatError as `check_target`, and OSError, which
    names `path`, where the folder cannot be written or the disk is full.
    """
    path = Path(path)
    target = check_target(path)
    with about(path):
        target.parent.mkdir(parents=True, exist_ok=True)
        _remove_left(target.parent)
        handle, name = tempfile.mkstemp(prefix=ASIDE, suffix=target.suffix, dir=target.parent)
    aside = Path(name)
    try:
        locked(handle)  # while this process lives; `_remove_left` of others asks for it
        with about(path, aside):
            aside.chmod(_mode(target))
            yield aside
            aside.replace(target)
    except BaseException:
        aside.unlink(missing_ok=True)
        raise
    finally:
        os.close(handle)


@contextmanager
def about(path: Path, instead: Path | None = None) -> Iterator[None]:
    """An OSError of the block that names no file, or `instead`, names `path`: a full disk names none."""
    try:
        yield
    except OSError as e:
        if e.errno is None or (e.filename is not None and str(e.filename) != str(instead)):
            raise
        raise OSError(e.errno, e.strerror, str(path)) from e


@contextmanager
def alone(folder: Path) -> Iterator[None]:
    """Hold a folder: raises PoserError where another process does. Ends with the process, however it ends."""
    path = folder / LOCK
    while True:
        handle = os.open(path, os.O_RDWR | os.O_CREAT, 0o666)
        if not locked(handle):
            os.close(handle)
            raise PoserError(f"{folder}: another run is writing into it; choose another folder")
        if _is(path, handle):
            break
        os.close(handle)  # its owner has just removed it
    try:
        yield
    finally:
        path.unlink(missing_ok=True)
        os.close(handle)


def locked(handle: int) -> bool:
    """Whether this process holds the file now; the lock is the system's and goes with the last handle."""
    if fcntl is None:
        return True
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError:
        return True  # a file system without locks
    return True


def _is(path: Path, handle: int) -> bool:
    try:
        return os.path.samestat(path.stat(), os.fstat(handle))
    except FileNotFoundError:
        return False


@cache  # once a process: a folder may hold thousands of files, written one by one
def _remove_left(folder: Path) -> None:
    """Remove what is being written in a folder by no process any more."""
    if fcntl is None:
        return
    with suppress(OSError):
        for path in [p for p in folder.iterdir() if p.name.startswith(ASIDE)]:
            with suppress(OSError):
                # Never a pipe that somebody named so: opening it would wait.
                handle = os.open(path, os.O_RDWR | os.O_NONBLOCK)
                try:
                    fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
                    path.unlink()
                finally:
                    os.close(handle)


def _mode(target: Path) -> int:
    """The permissions of the file that is replaced, else those that the user's files usually have."""
    try:
        return stat.S_IMODE(target.stat().st_mode)
    except FileNotFoundError:
        mask = os.umask(0)
        os.umask(mask)
        return 0o666 & ~mask
