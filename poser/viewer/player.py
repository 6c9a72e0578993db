"""Tracks in time: a timeline, play and pause, speed."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from mocap.body import Look
from mocap.synthesis.staging import floors_of
from poser.viewer import stage
from poser.viewer.tracks import Track, clock

RATE_HZ = 30.0  # of updates: a browser's connection, not the motion's rate
STEP_S = 0.01  # of the timeline
SPACING_M = 1.3
SPEEDS = ("0.1", "0.25", "0.5", "1", "2", "4")


class Player:
    """Tracks side by side on a server of `stage.server`, with the controls in the page.

    Those that state their time are shown by one clock, from where all of them have begun; the others begin
    with the timeline. A body outside its time stands still, and its label says so.

    body: how they look (`mocap.body.skin`). step(seconds) lets time pass; `run` does so
    until it is told to stop.
    """

    def __init__(self, made: Any, tracks: Sequence[Track], body: Look | None = None):
        self._server, self._tracks = made, tracks
        when = clock(tracks)
        self._starts = when.starts
        self.begin_s, self.end_s, self.first_s = when.begin, when.end, when.first
        middle = (len(tracks) - 1) / 2
        # The first file stands at the left of the picture, which is the bodies' right.
        shifts = [np.array([(k - middle) * SPACING_M, 0.0, 0.0]) for k in range(len(tracks))]
        self._floors = [floors_of(t.motion) for t in tracks]
        starts = [t.motion.p_world_root[0] * [1, 0, 1] for t in tracks]
        self._figures = [
            stage.Figure(made, k, t.label, t.motion.skeleton, shifts[k] - starts[k],
                         len(t.sensors.names) if t.sensors else 0, body)
            for k, t in enumerate(tracks)
        ]  # fmt: skip
        travelled = max(
            float(np.ptp(t.motion.p_world_root[:, [0, 2]], axis=0).max()) for t in tracks
        )
        stage.floor(made, 12.0 + 2 * travelled)
        stage.look_from(made, np.array([0.0, 0.95, 0.0]), SPACING_M * len(tracks))
        self._shown: list[tuple[int, str]] | None = None
        self._controls(made)
        self.show()

    def _controls(self, made: Any) -> None:
        gui = made.gui
        # The slider counts in steps of STEP_S from its left end.
        begin, end, first = (round(x, 2) for x in (self.begin_s, self.end_s, self.first_s))
        self._time = gui.add_slider(
            "time, s", begin, max(end, begin + STEP_S), STEP_S, initial_value=max(first, begin)
        )
        self._play = gui.add_button("Pause")
        self._speed = gui.add_dropdown("speed", SPEEDS, initial_value="1")
        # Paths drift by metres: several bodies would not stay side by side.
        several = len(self._tracks) > 1
        self._stay = gui.add_checkbox(
            "in place",
            initial_value=several,
            hint="without the bodies' paths and the drift of their height",
        )

        @self._play.on_click
        def _(_: Any) -> None:
            self.playing = not self.playing

        @self._stay.on_update
        def _(_: Any) -> None:
            self._shown = None

    @property
    def playing(self) -> bool:
        """Whether time passes; the button says what it would change that to."""
        return str(self._play.label) == "Pause"

    @playing.setter
    def playing(self, value: bool) -> None:
        self._play.label = "Pause" if value else "Play"

    @property
    def time_s(self) -> float:
        """Where the timeline stands."""
        return float(self._time.value)

    @time_s.setter
    def time_s(self, value: float) -> None:
        self._time.value = value

    def step(self, passed_s: float) -> None:
        """Let time pass and show what is then; the end is followed by where it began."""
        if self.playing and self.end_s > self.begin_s:
            t = self.time_s + passed_s * float(self._speed.value)
            self.time_s = t if t <= self._time.max else max(self.first_s, self._time.min)
        self.show()

    def show(self) -> None:
        """Show the frames at the timeline's time."""
        shown = [
            (track.frame(self.time_s - start), self._outside(track, self.time_s - start))
            for track, start in zip(self._tracks, self._starts, strict=True)
        ]
        if shown == self._shown:
            return
        self._shown = shown
        with self._server.atomic():
            for i, (k, note) in enumerate(shown):
                self._figures[i].label = self._tracks[i].label + note
                self._show(i, k)

    def _outside(self, track: Track, t: float) -> str:
        frame = 1.0 / track.motion.rate_hz
        if t < -frame:
            return f" (begins at {self.time_s - t:.2f} s)"
        return " (ended)" if t > track.seconds + frame else ""

    def _show(self, i: int, k: int) -> None:
        figure, track = self._figures[i], self._tracks[i]
        motion, back = track.motion, np.zeros(3)
        if self._stay.value:
            back = motion.p_world_root[k] - motion.p_world_root[0]
            back[1] = self._floors[i][k]
        figure.pose(motion.R_world_joint[k], motion.p_world_joint[k] - back)
        if track.sensors is not None:
            s = track.sensors
            figure.show_sensors(s.R_world_bone[k], s.p_world[k] - back, s.valid[k])

    def run(self, stop: threading.Event, tick: Callable[[], float] = time.monotonic) -> None:
        """Play until `stop` is set."""
        before = tick()
        while not stop.wait(1.0 / RATE_HZ):
            now = tick()
            try:
                self.step(now - before)
            except RuntimeError as e:
                # viser wakes its clients' tasks (asyncio.Event.set) from this thread while one of them comes
                # or goes. The next step sends all of it again.
                if "mutated during iteration" not in str(e):
                    raise
                self._shown = None
            before = now
