"""Pictures and texts of a report: nothing cut off or printed over, times on the recording's clock."""

from __future__ import annotations

import json
import re
from dataclasses import replace

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.transforms import BboxBase

import sip
from mocap import orientation as ori
from mocap import synthesis
from mocap.evaluation import metrics
from mocap.motion import Motion
from mocap.synthesis import motions
from poser.report import folder as reporting
from poser.report import page as report
from poser.report import pictures, results, skeletons

START_S = 92.0


def drawn(figure: Figure) -> FigureCanvasAgg:
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    return canvas


def compared(
    *bumps: tuple[int, float], methods: tuple[str, ...] = ("sip",), seconds: float = 3.0
) -> results.Compared:
    """A recording from `START_S` on at 60 Hz: each bump (frame, rad) is a smooth error of the left hip."""
    truth = motions.walk(5.0).slice(0, round(60 * seconds))
    angle = np.zeros(len(truth))
    for t, height in bumps:
        angle += height * np.exp(-0.5 * ((np.arange(len(truth)) - t) / 25.0) ** 2)
    R = np.array(truth.R_parent_joint)
    R[:, 1] = R[:, 1] @ ori.exp(angle[:, None] * [1.0, 0.0, 0.0])
    bad = Motion(truth.rate_hz, R, truth.p_world_root, truth.skeleton, start_s=START_S)
    result = results.MethodResult(bad, metrics.evaluate(bad, truth))
    # The reference does not state the clock, as one of another file may not.
    return results.Compared("walk", "a motion file", dict.fromkeys(methods, result), truth)


@pytest.fixture(scope="module")
def every() -> results.Compared:
    return compared((60, 0.8), methods=tuple(results.NAMES))


def boxes(figure: Figure) -> tuple[BboxBase, list[BboxBase], list[BboxBase]]:
    """Of the figure, of its legends and of its axes, in pixels."""
    drawn(figure)
    legends = [a.get_legend() for a in figure.axes]
    return (
        figure.bbox,
        [e.get_window_extent() for e in legends if e is not None],
        [a.get_window_extent() for a in figure.axes],
    )


def check_legends(figure: Figure, count: int) -> None:
    whole, legends, axes = boxes(figure)
    assert len(legends) == count
    for box in legends:
        assert whole.x0 <= box.x0 and box.x1 <= whole.x1
        assert whole.y0 <= box.y0 and box.y1 <= whole.y1
        assert not any(box.overlaps(a) for a in axes)


def test_legends_are_whole_and_beside_the_axes(every: results.Compared) -> None:
    wide = {
        n: replace(r, metrics=replace(r.metrics, sip_deg=100.0)) for n, r in every.methods.items()
    }
    check_legends(pictures.errors(replace(every, methods=wide)), 2)
    angles = {n: np.full(24, 50.0) for n in results.NAMES if n not in results.NO_SKILL}
    check_legends(pictures.joints(angles), 1)


def test_error_curves_are_on_the_recordings_clock(every: results.Compared) -> None:
    figure = pictures.errors(every)
    x = np.asarray(figure.axes[0].lines[0].get_xdata())
    assert x[0] == START_S and x[-1] == pytest.approx(START_S + 179 / 60)


@pytest.mark.parametrize("rows", [1, 2, 7])
def test_caption_is_nearer_to_its_own_row(rows: int) -> None:
    p = motions.walk(3.0).p_world_joint[0]
    figure = pictures.pairs([("m", [("walk 1.0 s\n2.0 cm", p, p)] * 2)] * rows)
    drawn(figure)
    grid = np.array(figure.axes).reshape(rows, 2)
    assert grid[0, 0].title.get_window_extent().y1 <= figure.bbox.y1
    for above, below in zip(grid[:-1, 0], grid[1:, 0], strict=True):
        caption = below.title.get_window_extent()
        to_above = above.get_window_extent().y0 - caption.y1
        to_below = caption.y0 - below.get_window_extent().y1
        assert -1e-6 < to_below < to_above
    # And a rule between the two.
    rules = [line.get_window_extent().y0 for line in figure.artists]
    assert len(rules) == rows - 1
    for y, above, below in zip(rules, grid[:-1, 0], grid[1:, 0], strict=True):
        assert below.title.get_window_extent().y1 < y < above.get_window_extent().y0


def test_worst_frames_are_peaks_on_the_recordings_clock() -> None:
    ((label, cells),) = reporting.worst_rows([compared((40, 0.5), (150, 0.9))])
    assert label == "SIP"
    times = [float(re.findall(r"walk ([\d.]+) s\n", title)[0]) for title, *_ in cells]
    assert times == pytest.approx([START_S + 150 / 60, START_S + 40 / 60], abs=0.15)


def test_slope_of_the_one_peak_is_no_second_worst_frame() -> None:
    found = compared((90, 0.9))
    assert len(reporting.worst_rows([found])[0][1]) == 1
    assert reporting.worst_rows([compared((20, 0.9), seconds=0.8)])


def test_player_has_the_clock_and_the_page_names_the_chart(every: results.Compared) -> None:
    html = skeletons.section([every])
    found = re.search(r'id="player-data">(.*?)</script>', html, flags=re.DOTALL)
    assert found is not None
    assert json.loads(found[1])["recordings"][0]["start"] == START_S
    assert 'id="pl-legend"' in html and "white-space:nowrap" in html


def test_wide_tables_scroll_in_their_own_box(every: results.Compared) -> None:
    record = results.to_json([every])
    text = report.page("x", [every], record["mean"], [], {})
    assert re.search(r"\.wide \{ overflow-x: auto", text)
    assert re.search(r'<div class="wide"[^>]*><table>', text)
    assert '<meta name="viewport"' in text


def test_residuals_are_drawn_at_the_recordings_time() -> None:
    whole = synthesis.recording(motions.squat(1.0), ("pelvis", "head"))
    part = replace(whole, start_s=START_S)
    solution = sip.solve(part, settings=sip.Settings(solver="banded"))
    first, *_ = pictures.residuals(solution, part.sensors).axes
    begin, end = first.get_xlim()
    # Up to a frame: the first and the last may hold no value.
    assert (begin, end) == pytest.approx((START_S, START_S + 1.0), abs=0.035)
