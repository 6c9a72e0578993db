"""Fixtures that the whole suite shares."""

from __future__ import annotations

import gc
import os
import signal
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

LEFT_OVER = pytest.StashKey[list[str]]()

# Files and folders whose tests solve, train, calibrate many recordings, or run whole commands.
SLOW = (
    "hybrid/test_motion_filter.py",
    "hybrid/test_refinement.py",
    "hybrid/test_tracker.py",
    "learned/imuposer/test_adam.py",
    "learned/online/test_online_windows.py",
    "learned/training/test_train.py",
    "learned/training/test_validation.py",
    "learned/training/test_virtual.py",
    "mocap/calibration/test_arm_checks.py",
    "mocap/calibration/test_calibration.py",
    "mocap/calibration/test_diagnostics.py",
    "mocap/calibration/test_facing.py",
    "mocap/calibration/test_limb_levels.py",
    "mocap/calibration/test_pose_checks.py",
    "mocap/calibration/test_side_checks.py",
    "mocap/calibration/test_stances.py",
    "mocap/calibration/test_static_pose.py",
    "mocap/formats/test_fuzz_mat.py",
    "mocap/formats/test_fuzz_motions.py",
    "mocap/formats/test_fuzz_recordings.py",
    "poser/live/test_devices.py",
    "poser/live/sources",
    "poser/live/test_headings.py",
    "poser/live/test_loop.py",
    "poser/live/test_network.py",
    "poser/test_cluster.py",
    "poser/test_commands.py",
    "poser/test_compare.py",
    "poser/test_compare_failures.py",
    "poser/test_compare_interrupted.py",
    "poser/test_examples.py",
    "poser/test_fast_recordings.py",
    "poser/test_finetune.py",
    "poser/test_live.py",
    "poser/test_live_devices.py",
    "poser/test_orientations_alone.py",
    "poser/test_process.py",
    "poser/test_quickstart.py",
    "poser/test_timeline.py",
    "poser/test_track.py",
    "poser/test_train.py",
    "poser/test_training.py",
    "poser/test_view.py",
    "poser/test_view_page.py",
    "sip/test_posterior.py",
    "sip/test_real.py",
    "sip/test_solve.py",
    "sip/test_starts.py",
    "sip/test_stopping.py",
    "sip/test_windows.py",
    "sip/test_world.py",
    "sip/solvers",
)


def pytest_configure(config: pytest.Config) -> None:
    """Ctrl-C works also where the suite was started with it ignored, as a shell does in the background.

    What fails inside the garbage collector is written down, to be told at the end: it runs during any test.
    """
    signal.signal(signal.SIGINT, signal.default_int_handler)
    left = config.stash[LEFT_OVER] = []

    def note(failed: Any) -> None:
        during = os.environ.get("PYTEST_CURRENT_TEST", "no test")
        what = failed.err_msg or "exception ignored in"
        left.append(f"{what} {failed.object!r}: {failed.exc_value!r} (noticed during {during})")

    sys.unraisablehook = note


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark as slow what `SLOW` names; single tests of other files carry the marker themselves."""
    here = Path(__file__).parent
    slow = [here / name for name in SLOW]
    for item in items:
        if any(item.path == path or path in item.path.parents for path in slow):
            item.add_marker(pytest.mark.slow)


@pytest.hookimpl(trylast=True)
def pytest_sessionfinish(session: pytest.Session) -> None:
    gc.collect()
    left = session.config.stash[LEFT_OVER]
    if hasattr(session.config, "workeroutput"):
        session.config.workeroutput["left_over"] = left
    elif left and session.exitstatus == pytest.ExitCode.OK:
        session.exitstatus = pytest.ExitCode.TESTS_FAILED


@pytest.hookimpl(optionalhook=True)
def pytest_testnodedown(node: Any, error: object) -> None:
    """A process of pytest-xdist hands over what it wrote down."""
    node.config.stash[LEFT_OVER].extend(getattr(node, "workeroutput", {}).get("left_over", []))


def pytest_terminal_summary(terminalreporter: Any, config: pytest.Config) -> None:
    for line in config.stash[LEFT_OVER]:
        terminalreporter.write_line(f"LEFT OVER {line}")


@pytest.fixture
def rng() -> np.random.Generator:
    """A seeded generator: tests draw from it, so a failure repeats."""
    return np.random.default_rng(20261122)


@pytest.fixture(scope="session")
def shared() -> Path:
    """The folder `shared/` beside the repository, or a skip where it is absent.

    The environment variable POSER_SHARED names another place.
    """
    here = Path(__file__).resolve().parents[1]
    folder = Path(os.environ.get("POSER_SHARED", here.parent / "shared"))
    if not (folder / "data").is_dir():
        pytest.skip("the data folder shared/ is not beside the repository (POSER_SHARED)")
    return folder
