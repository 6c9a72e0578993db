"""Pictures of motions: skeletons side by side, error over time, error by joint. PNG, without a display."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from mocap import orientation as ori
from mocap.formats._files import write_aside
from mocap.motion import Motion
from mocap.orientation import Array
from mocap.skeleton import JOINTS, PARENTS
from mocap.solution import Solution
from poser.report.placing import beside
from poser.report.results import COLOURS, MIDDLE, NAMES, NO_SKILL, Compared, joint_colour

YAW, TILT = np.deg2rad(-35.0), np.deg2rad(12.0)  # the camera: to the body's left, a little above
DPI = 110
PAIR_IN = 2.8  # height of a row of `pairs`, with its caption
PAIR_GAP_IN = 0.55  # of it, what is between the axes of two rows
PAIR_FOOT_IN = 0.12  # of the gap, what is between the feet and the rule


def save(figure: Figure, path: Path) -> None:
    """The figure as PNG: whole or not at all."""
    FigureCanvasAgg(figure)
    with write_aside(path) as aside:
        figure.savefig(aside, dpi=DPI, format="png")


def skeletons(motions: Mapping[str, Motion], times: Sequence[float]) -> Figure:
    """One row a motion, one column a time (s); the first motion is drawn in grey behind the others.

    They stand where the first motion does (`beside`); the square is the floor y = 0.
    """
    names = list(motions)
    truth = motions[names[0]]
    figure = Figure(figsize=(1.75 * len(times) + 0.6, 2.35 * len(names) + 0.6))
    axes = np.asarray(figure.subplots(len(names), len(times), squeeze=False))
    for c, time in enumerate(times):
        t = min(len(truth) - 1, round(time * truth.rate_hz))
        place = truth.p_world_root[t] * [1, 0, 1]
        true = truth.p_world_joint[t] - place
        for r, name in enumerate(names):
            axis = axes[r, c]
            _floor(axis)
            if r:
                _bones(axis, true, ghost=True)
                _bones(axis, beside(motions[name].p_world_joint[t], true))
            else:
                _bones(axis, true)
            _frame(axis)
        axes[0, c].set_title(f"{time:.1f} s", fontsize=10)
    for r, name in enumerate(names):
        axes[r, 0].text(
            -0.06, 0.5, NAMES.get(name, name), transform=axes[r, 0].transAxes, rotation=90,
            ha="center", va="center", fontsize=11,
        )  # fmt: skip
    width, height = figure.get_size_inches()
    figure.text(
        0.5, 0.1 / height,
        "blue: left, orange: right, light grey: the reference; pelvis above pelvis, on one floor",
        ha="center", fontsize=9,
    )  # fmt: skip
    figure.subplots_adjust(0.4 / width, 0.35 / height, 0.99, 1 - 0.3 / height, 0.02, 0.03)
    return figure


def pairs(rows: Sequence[tuple[str, Sequence[tuple[str, Array, Array]]]]) -> Figure:
    """Single frames: one row a method, each cell a title, the true joints (24,3) m in grey, the method's.

    They stand on one place (`beside`).
    """
    columns = max(len(cells) for _, cells in rows)
    height = PAIR_IN * len(rows)
    figure = Figure(figsize=(2.0 * columns + 0.6, height))
    axes = np.asarray(figure.subplots(len(rows), columns, squeeze=False))
    for r, (label, cells) in enumerate(rows):
        for c in range(columns):
            axis = axes[r, c]
            _frame(axis)
            if c >= len(cells):
                continue
            title, true, p = cells[c]
            true = true - true[0] * [1, 0, 1]
            _floor(axis)
            _bones(axis, true, ghost=True)
            _bones(axis, beside(p, true))
            axis.set_title(title, fontsize=8, pad=2)
        axes[r, 0].text(
            -0.06, 0.5, label, transform=axes[r, 0].transAxes, rotation=90, ha="center", va="center",
            fontsize=10,
        )  # fmt: skip
        if r:
            # A caption between two skeletons is the lower one's: the rule keeps it from the upper one.
            figure.add_artist(
                Line2D((0.01, 0.99), [1 - r / len(rows)] * 2, color="#dddddd", lw=0.8)
            )
    between = PAIR_GAP_IN / (PAIR_IN - PAIR_GAP_IN)
    figure.subplots_adjust(
        0.05, PAIR_FOOT_IN / height, 0.99, 1 - (PAIR_GAP_IN - PAIR_FOOT_IN) / height, 0.02, between
    )
    return figure


def _seen(p: Array) -> Array:
    """Screen coordinates (...,2) of points (...,3): orthographic, turned by YAW and TILT."""
    q = p @ ori.rot_y(YAW).T
    return np.stack([q[..., 0], q[..., 1] * np.cos(TILT) - q[..., 2] * np.sin(TILT)], axis=-1)


def _bones(axis: Any, p: Array, ghost: bool = False) -> None:
    """The 23 bones, and the head as a short line upwards from its joint."""
    s = _seen(p)
    for j, parent in enumerate(PARENTS):
        if parent < 0:
            continue
        colour, width = ("#cccccc", 3.5) if ghost else (joint_colour(JOINTS[j]), 1.9)
        axis.plot(*s[[parent, j]].T, color=colour, lw=width, solid_capstyle="round")
    head = s[15] + 0.5 * (s[15] - s[12])
    axis.plot(*head, "o", ms=11, color="#cccccc" if ghost else MIDDLE, mfc="none")


def _floor(axis: Any) -> None:
    square = 0.55 * np.array([[-1, 0, -1], [1, 0, -1], [1, 0, 1], [-1, 0, 1], [-1, 0, -1]])
    axis.fill(*_seen(square).T, color="#f0ede6", zorder=0)


def _frame(axis: Any) -> None:
    axis.set_xlim(-0.95, 0.95)
    axis.set_ylim(-0.35, 2.15)
    axis.set_aspect("equal")
    axis.set_axis_off()


def errors(compared: Compared) -> Figure:
    """Angle of hips and shoulders, and joint distance, frame by frame, on the recording's clock."""
    metrics, start = {n: m.metrics for n, m in compared.methods.items()}, compared.start_s
    figure = Figure(figsize=(10.8, 5.2))
    top, bottom = figure.subplots(2, 1, sharex=True)
    for name in sorted(metrics, key=lambda n: n not in NO_SKILL):
        m = metrics[name]
        angle, distance = m.frame_sip_deg, m.frame_position_cm
        if angle is None or distance is None or m.rate_hz is None:
            continue
        t = start + np.arange(len(angle)) / m.rate_hz
        style = {"color": COLOURS.get(name), "lw": 1.0 if name in NO_SKILL else 1.6}
        label = NAMES.get(name, name)
        top.plot(t, angle, label=f"{label} ({m.sip_deg:.1f} deg)", **style)
        bottom.plot(t, distance, label=f"{label} ({m.position_cm:.1f} cm)", **style)
    top.set_ylabel("hips and shoulders, deg")
    bottom.set_ylabel("24 joints, cm")
    bottom.set_xlabel("time, s")
    for axis in (top, bottom):
        axis.set_ylim(bottom=0)
        axis.margins(x=0)
        axis.grid(alpha=0.3)
        axis.legend(fontsize=8, loc="upper left", bbox_to_anchor=(1.005, 1.0), frameon=False)
    # Room on the right for the longest name with its mean.
    figure.subplots_adjust(0.068, 0.095, 0.76, 0.98, hspace=0.09)
    return figure


def joints(known: Mapping[str, Array]) -> Figure:
    """Angles (24,) deg of each joint, one bar a method."""
    figure = Figure(figsize=(10, 3.6))
    axis = figure.subplots()
    width = 0.8 / max(1, len(known))
    for k, (name, degrees) in enumerate(known.items()):
        x = np.arange(len(JOINTS)) + (k - (len(known) - 1) / 2) * width
        axis.bar(x, degrees, width, color=COLOURS.get(name), label=NAMES.get(name, name))
    axis.set_xticks(
        range(len(JOINTS)), [j.replace("_", " ") for j in JOINTS], rotation=55, ha="right",
        fontsize=8, rotation_mode="anchor",
    )  # fmt: skip
    axis.set_ylabel("global angle, deg")
    axis.margins(x=0.01)
    axis.grid(alpha=0.3, axis="y")
    axis.set_axisbelow(True)
    # Above the axes: within them no place is free of bars for every recording.
    axis.legend(
        fontsize=8, loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=max(1, min(6, len(known))),
        frameon=False, borderaxespad=0.2, columnspacing=1.5,
    )  # fmt: skip
    # Six names a line; more of them need a second one.
    figure.subplots_adjust(0.065, 0.27, 0.99, 0.92 if len(known) <= 6 else 0.86)
    return figure


def residuals(solution: Solution, sensors: Sequence[str]) -> Figure:
    """Norm of each sensor's orientation and acceleration residual over time, in sigmas, and the terms.

    A sensor that stays above the others is mounted, named or timed wrongly; all of them high together
    mean that the body or the sigmas do not fit.
    """
    names = [n for n in ("orientation", "acceleration") if n in solution.residuals]
    figure = Figure(figsize=(10, 2.3 * len(names) + 2.2))
    axes = figure.subplots(len(names) + 1, 1)
    rate, start_s = solution.motion.rate_hz, solution.motion.start_s
    for axis, name in zip(axes, names, strict=False):
        r = np.linalg.norm(solution.residuals[name], axis=-1)
        # Accelerations have no value at the two end frames.
        t = start_s + (np.arange(len(r)) + (len(solution.motion) - len(r)) / 2) / rate
        for s, sensor in enumerate(sensors):
            axis.plot(t, np.where(r[:, s] > 0, r[:, s], np.nan), lw=1.0, label=sensor)
        axis.set_ylabel(f"{name}, sigmas")
        axis.set_xlabel("time, s")
        axis.set_ylim(bottom=0)
        axis.margins(x=0)
        axis.grid(alpha=0.3)
    axes[0].legend(fontsize=7, loc="upper right", ncols=max(1, min(6, len(sensors))), frameon=False)
    terms = list(solution.cost)
    axes[-1].bar(range(len(terms)), [solution.cost[n] for n in terms], color="#1b7837")
    axes[-1].set_xticks(range(len(terms)), terms, fontsize=8)
    axes[-1].set_ylabel("cost, sigma$^2$")
    figure.tight_layout()
    return figure
