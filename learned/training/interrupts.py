"""Ctrl-C that waits until what is being computed is whole."""

from __future__ import annotations

import signal
import threading
from types import FrameType
from typing import Any, Self


class Interrupts:
    """While the block runs, the first Ctrl-C sets `asked`; it is raised at once where `may_break`.

    A second one is always raised at once. Outside the main thread signals cannot be caught: nothing is
    changed there.
    """

    def __init__(self) -> None:
        self.asked = False
        self.may_break = False
        self._before: Any = None

    def __enter__(self) -> Self:
        if threading.current_thread() is threading.main_thread():
            self._before = signal.signal(signal.SIGINT, self._note)
        return self

    def __exit__(self, *_: object) -> None:
        if self._before is not None:
            signal.signal(signal.SIGINT, self._before)

    def _note(self, number: int, frame: FrameType | None) -> None:
        again, self.asked = self.asked, True
        if again or self.may_break:
            raise KeyboardInterrupt
