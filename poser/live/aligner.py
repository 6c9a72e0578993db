"""When the constants are found that turn devices into bones: at the start, and again where the wearer asks.

Headings drift, and a tracker that was off and on has another one. So they can be taken anew while the session
runs: poses go on with the old constants until the new ones are there.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

from mocap.calibration import Calibration
from mocap.errors import CalibrationError
from poser.live import alignment
from poser.live.alignment import Constants, Watch
from poser.live.assembler import Row

Reset = Callable[[Calibration | None, float], Watch]
"""Makes the watch of a reset, of the calibration so far and the time of the first row to look at."""


class Aligner:
    """The constants of a session's devices.

    table: see `alignment.to_sample`. watch: stands before the first sample, and its calibration is the table
    then. known: the calibration that the table is from. resets: what may be asked for, by name. countdown_s:
    to get into the pose of a reset.

    calibration: the last one that was found. turns: how often it was found anew. trouble: why a reset failed.
    """

    def __init__(
        self,
        table: Mapping[str, Constants] | None = None,
        watch: Watch | None = None,
        known: Calibration | None = None,
        resets: Mapping[str, Reset] | None = None,
        countdown_s: float = 5.0,
    ):
        self.table, self.resets, self.turns, self.trouble = table, dict(resets or {}), 0, ""
        self.calibration: Calibration | None = None
        self._watch, self._known, self._countdown_s = watch, known, countdown_s
        self._begun = watch is None
        self._asked: str | None = None

    def ask(self, how: str) -> None:
        """Ask for a reset; it begins with the next row. Any thread may call this."""
        self._asked = how if how in self.resets else None

    def push(self, row: Row) -> bool:
        """Take the next row; False while nothing is known yet.

        Raises CalibrationError where the first calibration fails; a reset that fails leaves all as it was.
        """
        asked, self._asked = self._asked, None
        if asked is not None and self._begun:
            self.trouble = ""
            known = self.calibration or self._known
            self._watch = self.resets[asked](known, row.time_s + self._countdown_s)
        if self._watch is not None:
            try:
                found = self._watch.push(row)
            except CalibrationError as e:
                if not self._begun:
                    raise
                self._watch, self.trouble = None, str(e)
                return True
            if found is not None:
                self.turns += self._begun
                self.calibration, self._watch, self._begun = found, None, True
                self.table = alignment.constants(found)
        return self._begun

    @property
    def waiting(self) -> bool:
        """Whether no sample can be made yet."""
        return not self._begun

    @property
    def walks(self) -> bool:
        """Whether walking is part of what is under way."""
        return self._watch is not None and self._watch.walks

    def prompt(self, time_s: float) -> str:
        """What the wearer should do at a row's time; empty where nothing is under way."""
        return "" if self._watch is None else self._watch.prompt(time_s)
