"""The real recording: `make bench-real`.

A person with 16 IMUs, 100 s at 100 Hz (qmt full-body example). Calibrated from the N-pose at 44 s, by the
file's orientations and from gyr and acc alone (vqf). The reference of each window is SIP on all 16 sensors,
as in the DIP paper, section 4.5; left_out_deg has no solver in between: the angle between the estimated bones
of the ten unseen sensors and what those sensors measured.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from common import data_folder, keep, machine, row

import sip
from mocap import Recording, formats, sensors
from mocap import orientation as ori
from mocap.calibration import calibrate
from mocap.evaluation import metrics, noskill
from poser import tracking
from sip.prior import shipped

WINDOWS = ((46, 56), (90, 100), (110, 120))
OFFLINE: dict[str, dict[str, Any]] = {
    "sop": {"terms": "sop"}, "sip": {"terms": "sip"}, "sip+calibr.": {"self_calibration": True},
}  # fmt: skip
ONLINE = (
    ("dip", "dip"), ("hybrid-dip", "dip"), ("imuposer", "imuposer"), ("imuposer-adam", "imuposer"),
    ("hybrid-imuposer", "imuposer"),
)  # fmt: skip
DEVICES = ("left_forearm", "right_thigh", "head")  # as a watch, a phone in a pocket, earphones
NAMES = ("left_out_deg", "sip_deg", "angular_deg", "position_cm", "jitter", "jitter_reference")


def window(recording: Recording, start_s: float, stop_s: float) -> Recording:
    """The part between two times of the file's clock."""
    rate, t0 = recording.rate_hz, recording.start_s
    return recording.slice(round((start_s - t0) * rate), round((stop_s - t0) * rate))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--orientation", default="file,vqf")
    parser.add_argument("--solver", default="banded", choices=("banded", "ipopt"))
    parser.add_argument("--dip", type=Path, help="other weights than the shipped ones")
    parser.add_argument("--imuposer", type=Path)
    parser.add_argument(
        "--online", action="store_true", help="of the six sensors the online methods alone"
    )
    parser.add_argument("-o", "--output", type=Path)
    args = parser.parse_args()
    rows: list[dict[str, Any]] = []
    settings = sip.Settings(solver=args.solver)
    raw = formats.read(data_folder() / "qmt-fullbody" / "full_body_example_data.mat").content
    print(machine())
    widths = (16, 10, *[12] * len(NAMES))
    for way in args.orientation.split(","):
        recording, calibration = calibrate(raw, pose="n", at=44.0, orientation=way)
        print(f"\norientation from {way}; {calibration.method}")
        for start, stop in WINDOWS:
            piece = window(recording, start, stop)
            full = sip.solve(piece, settings=settings)
            bones = full.motion.R_world_joint[:, piece.joint]
            apart = np.rad2deg(ori.angle_between(bones, piece.R_world_bone)[piece.ori_valid])
            print(
                f"\n{start}-{stop} s: 16 sensors, {len(piece)} frames, {full.seconds:.0f} s, median "
                f"angle of solved to measured bones {np.median(apart):.2f} deg; {full.status}"
            )
            print(row(("six sensors", "seconds", *NAMES), widths))
            six = piece.select(sensors.SIX)
            prior = shipped()
            still = noskill.both(six, prior.mean, prior.poses)
            solved = {name: (motion, 0.0) for name, motion in still.items()}
            for name, changes in {} if args.online else OFFLINE.items():
                s = sip.solve(six, settings=replace(settings, **changes))
                solved[name] = (s.motion, s.seconds)
            for name, network in ONLINE:
                seen = sensors.SIX if network == "dip" else DEVICES
                method = "hybrid" if name.startswith("hybrid") else name
                weights = getattr(args, network)
                run = tracking.track(piece.select(seen), method, network, weights=weights).run
                solved[name] = (run.motion, float(run.frame_s.sum()))
            for name, (motion, seconds) in solved.items():
                seen = DEVICES if "imuposer" in name else sensors.SIX
                m = metrics.evaluate(motion, full.motion, recording=piece, seen=seen)
                figures = [f"{getattr(m, k):.2f}" for k in NAMES]
                print(row((name, f"{seconds:.1f}", *figures), widths), flush=True)
                label = {"orientation": way, "window": f"{start}-{stop} s", "method": name}
                rows.append(label | {k: getattr(m, k) for k in NAMES})
    if args.output:
        keep(args.output, rows)


if __name__ == "__main__":
    main()
