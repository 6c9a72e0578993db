"""Ctrl-C, or a signal that asks to end, waits until what is being computed is whole."""

from __future__ import annotations

import signal
import threading
from types import FrameType
from typing import Any, Self


class Interrupts:
    """While the block runs, the first Ctrl-C, SIGTERM or SIGHUP sets `asked`; it is raised at once where
    `may_break`.

    A second one is always raised at once. Outside the main thread signals cannot be caught: nothing is
    changed there.
    """

    def __init__(self) -> None:
        self.asked = False
        self.may_break = False
        self._before: dict[int, Any] = {}

    def __enter__(self) -> Self:
        if threading.current_thread() is threading.main_thread():
            for number in (signal.SIGINT, signal.SIGTERM, getattr(signal, "SIGHUP", None)):
                # What is ignored (nohup) stays so.
                if number is not None and signal.getsignal(number) is not signal.SIG_IGN:
                    self._before[number] = signal.signal(number, self._note)
        return self

    def __exit__(self, *_: object) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)

    def _note(self, number: int, frame: FrameType | None) -> None:
        again, self.asked = self.asked, True
        if again or self.may_break:
            raise KeyboardInterrupt
