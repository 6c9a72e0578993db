"""Files as such: what may be opened, and writing so that an interruption never leaves half of one."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from mocap.errors import FormatError


def check_regular(path: Path) -> None:
    """Refuse what is neither a file nor a folder, before it is opened: opening a pipe waits for a writer.

    Raises FormatError; says nothing of a path where there is nothing.
    """
    if path.exists() and not (path.is_file() or path.is_dir()):
        raise FormatError(path, "is a pipe, a socket or a device, expected a regular file")


@contextmanager
def write_aside(path: str | Path) -> Iterator[Path]:
    """Yield a temporary path beside `path`; on success it replaces `path`, otherwise it is deleted.

    The temporary file lies in the same folder (so that the replacement is atomic) and has the same
    suffix (numpy appends one to names that lack it). The folder is made if it does not exist. Any
    exception, KeyboardInterrupt included, deletes the temporary file and leaves `path` as it was.
    Raises OSError where the folder cannot be written.
    """
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    handle, name = tempfile.mkstemp(prefix=f".{path.stem}-", suffix=path.suffix, dir=path.parent)
    os.close(handle)
    aside = Path(name)
    try:
        # mkstemp makes the file private; what the user asked for has the usual permissions.
        mask = os.umask(0)
        os.umask(mask)
        aside.chmod(0o666 & ~mask)
        yield aside
        aside.replace(path)
    except BaseException:
        aside.unlink(missing_ok=True)
        raise
