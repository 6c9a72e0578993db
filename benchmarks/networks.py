"""Speed, exactness and memory of the networks online.

    python benchmarks/networks.py               a frame each way, against the plain forward in the same run
    python benchmarks/networks.py --minutes 60  memory over an hour of streaming (small network, full speed)
    python benchmarks/networks.py --adam        learning rate of imuposer-adam, CMU validation clips
    python benchmarks/networks.py --refinement  a frame of the hybrid's refinement against ten Adam steps
    python benchmarks/networks.py --whole       whole frames, sample to pose, of every online method

Weights: the shipped ones, others with --dip FILE, --imuposer FILE, none with --untrained. Each way takes its
turn frame by frame, so that a change of the machine's speed meets all of them. "cpu" is the time of the
calling thread alone: on a busy machine compare these. One thread.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch
from common import machine, resident_mb, row
from torch import Tensor

from hybrid import TrackerSettings
from hybrid.refinement import Refinement
from learned import checkpoint, online, runtime
from learned import kinematics as kin
from learned.features import COMBINATIONS
from learned.imuposer.adam import CHAINS, AdamSettings, refine
from learned.models import Dip, Imuposer, Model, build, for_network
from learned.training.reach import inputs, pose_of
from learned.training.validation import cut
from mocap import Motion, Recording, dataset, orientation, sensors, synthesis
from mocap.estimator import Pose, replay, samples
from mocap.evaluation import metrics
from mocap.skeleton import Skeleton
from mocap.synthesis import motions
from poser.estimators import TRACKER, devices_of, make, network_of

WIDTHS = (34, 9, 9, 9, 9, 11, 10)


def model_of(network: str, path: Path | None, untrained: bool, hidden: int = 512) -> Model:
    torch.manual_seed(0)
    if untrained:
        return build(for_network(network, hidden=hidden)).eval().requires_grad_(False)
    return checkpoint.load(path or checkpoint.shipped(network), network)


def inputs_of(model: Model, count: int) -> tuple[Tensor, int]:
    """Inputs (count,T,60) of windows of noisy sensors on the built-in motion, and the emitted frame."""
    rate, names = model.config.rate_hz, model.config.sensors
    made = synthesis.recording(motions.builtin(rate, 30.0), names, synthesis.Noise(), 0)
    past, future = (20, 5) if isinstance(model, Dip) else (124, 0)
    w = cut([made], past, future, max(1, len(made) // count))
    return inputs(model, w, count), past


def ways(model: Model) -> dict[str, tuple[runtime.Runtime, bool]]:
    """Name -> runtime, and whether its rows are kept from frame to frame."""
    found: dict[str, tuple[runtime.Runtime, bool]] = {
        "plain forward": (runtime.Plain(model), False),
        "pruned, exact": (runtime.prepare(model, reach=runtime.EVERY), True),
        "pruned, layer 2 from 80": (runtime.prepare(model, reach=80), True),
        "the same, layer 2 from 40": (runtime.prepare(model, reach=40), True),
        "the same, layer 2 from 20": (runtime.prepare(model, reach=20), True),
        "pruned, int8": (runtime.prepare(model, "int8", reach=runtime.EVERY), True),
        f"int8, layer 2 from {model.reach or 'all'} (default)": (
            runtime.prepare(model, "int8"),
            True,
        ),
    }
    quantised = torch.ao.quantization.quantize_dynamic(model, {torch.nn.LSTM}, dtype=torch.qint8)
    return found | {"plain forward, dynamic int8": (runtime.Plain(quantised), False)}


@torch.inference_mode()
def speed(model: Model, frames: int) -> None:
    """Wall and thread time of a frame, and the difference of its pose from the plain forward's."""
    x, emit = inputs_of(model, frames)
    found = ways(model)
    wall: dict[str, list[float]] = {name: [] for name in found}
    cpu: dict[str, list[float]] = {name: [] for name in found}
    off: dict[str, list[float]] = {name: [] for name in found}
    for k, window in enumerate(x):
        truth = None
        for name, (way, keeps) in found.items():
            rows = way.rows(window)
            began, began_cpu = time.perf_counter(), time.thread_time()
            if (
                keeps
            ):  # all but those of the newest frame (IMUPoser: of five at the edges) are at hand
                way.rows(window[-1:] if isinstance(model, Dip) else window[-5:])
            features = way.features(rows, emit)
            if k >= 2:
                wall[name].append(1e3 * (time.perf_counter() - began))
                cpu[name].append(1e3 * (time.thread_time() - began_cpu))
            pose = pose_of(model, way, features)
            truth = pose if truth is None else truth
            off[name].append(float(torch.rad2deg(kin.angle_between(pose, truth)).max()))
    print(row((f"{model.config.network}, {x.shape[1]} frames", "p50 ms", "p99 ms", "p50 cpu", "of plain",
               "mean deg", "max deg"), WIDTHS))  # fmt: skip
    base = np.median(cpu["plain forward"])
    for name in found:
        middle = np.median(cpu[name])
        cells = (
            f"{np.median(wall[name]):.1f}", f"{np.percentile(wall[name], 99):.1f}", f"{middle:.1f}",
            f"{middle / base:.2f}", f"{np.mean(off[name]):.5f}", f"{max(off[name]):.4f}",
        )  # fmt: skip
        print(row((name, *cells), WIDTHS), flush=True)


def whole(frames: int, files: dict[str, Path | None]) -> None:
    """From a sample to its pose, each method at its network's rate, against the time between two samples.

    "p99 cpu" is of the time that all threads of the process were given: what other work on the machine, or
    its host, takes away is not in it, what two threads do at once counts twice.
    """
    print(row(("method", "Hz", "p50 ms", "p99 ms", "p99 cpu", "longest", "period"), WIDTHS))
    for method in ("dip", "hybrid-dip", "imuposer", "imuposer-adam", "hybrid-imuposer"):
        network = network_of(method)
        rate, names = (60.0, sensors.SIX) if network == "dip" else (25.0, devices_of(sensors.FIVE))
        made = synthesis.recording(
            motions.builtin(rate, frames / rate), names, synthesis.Noise(), 0
        )
        estimator = make(method, rate, names, weights=files[network])
        state, times = estimator.init(), []
        for sample in samples(made):
            began = time.perf_counter(), time.process_time()
            state, _ = estimator.step(state, sample)
            times.append((time.perf_counter() - began[0], time.process_time() - began[1]))
        ms, cpu = 1e3 * np.array(times[10:]).T
        found = (
            np.median(ms), np.percentile(ms, 99), np.percentile(cpu, 99), ms.max(), 1e3 / rate,
        )  # fmt: skip
        print(row((method, f"{rate:g}", *(f"{x:.1f}" for x in found)), WIDTHS), flush=True)


def memory(network: str, minutes: float) -> None:
    """Resident memory while samples stream: everything but the size of the matrices is as it is."""
    model = model_of(network, None, True, hidden=16)
    names = model.config.sensors[:3] if network == "imuposer" else model.config.sensors
    rate = 100.0
    made = synthesis.recording(motions.builtin(rate, 20.0), names, synthesis.Noise(), 0)
    estimator = (
        online.dip(model, rate) if isinstance(model, Dip) else online.imuposer(model, rate, names)
    )
    rows = list(samples(made))
    state, total = estimator.init(), int(60 * minutes * rate)
    for k in range(total):
        sample = replace(rows[k % len(rows)], time_s=k / rate)
        state, _ = estimator.step(state, sample)
        if k % max(1, total // 6) == 0 or k == total - 1:
            print(
                f"{network}: {k / rate / 60:6.1f} min streamed: {resident_mb():.1f} MB", flush=True
            )


def adam(model: Model, clips: int) -> None:
    """Errors of imuposer-adam by learning rate, on validation clips with realistic noise."""
    assert isinstance(model, Imuposer)
    rates = (0.0, 0.01, 0.02, 0.03, 0.05, 0.08, 0.12)
    names = ("sip_deg", "angular_deg", "position_cm")
    found: dict[float, list[list[float]]] = {rate: [] for rate in rates}
    for k, (_, motion) in enumerate(dataset.clips("validation", ("cmu",), 25.0, 4.0, 8.0)):
        if k == clips:
            break
        worn = [sensors.FIVE[i] for i in COMBINATIONS[(7 * k + 3) % len(COMBINATIONS)]]
        made = synthesis.recording(motion, tuple(worn), synthesis.Noise(), k)
        fast = online.imuposer(model, 25.0, made.sensors, precision=runtime.fastest())
        done = replay(fast, made).motion
        for rate in rates:
            out = done if rate == 0 else refined(done, made, AdamSettings(learning_rate=rate))
            errors = metrics.evaluate(out, made.reference)
            found[rate].append([getattr(errors, name) for name in names])
    widths = (14, 10, 14, 12)
    print(row(("learning rate", *names), widths))
    for rate in rates:
        print(row((rate or "none", *(f"{x:.3f}" for x in np.mean(found[rate], axis=0))), widths))


def refined(motion: Motion, recording: Recording, settings: AdamSettings) -> Motion:
    """The motion with each frame refined towards the recording's valid orientations."""
    R = np.array(motion.R_parent_joint)
    for t, ok in enumerate(recording.ori_valid):
        joints = tuple(int(j) for j in recording.joint[ok])
        R[t] = refine(R[t], joints, recording.R_world_bone[t, ok], settings)
    return replace(motion, R_parent_joint=R)


def refinement(frames: int) -> None:
    """One frame of IMUPoser's poses refined three ways, a watch, a phone and earphones worn: the hybrid's QP,
    ten Adam steps by their closed-form gradient (`imuposer.adam`), and the same steps by autograd through
    the kinematics of 24 joints, as a network's code would have them."""
    worn = devices_of(sensors.FIVE)
    truth = motions.builtin(25.0)
    made = synthesis.recording(truth, worn, synthesis.Noise(), 0)
    joint, seat = sensors.joints_and_seats(worn)
    joints = tuple(int(j) for j in joint)
    settings = TrackerSettings(**TRACKER["imuposer"])
    qp = Refinement(Skeleton.default(), joint, seat, settings)
    rng = np.random.default_rng(0)
    error = orientation.exp(np.deg2rad(12.0) * rng.normal(size=(24, 3)))
    spread = rng.normal(size=(72, 72)) * 0.02
    covariance = spread @ spread.T + 0.03 * np.eye(72)
    times: dict[str, list[float]] = {
        "hybrid's refinement": [],
        "Adam, closed form": [],
        "Adam, autograd": [],
    }
    memory, apart = qp.start(), 0.0
    for k, sample in zip(range(frames), samples(made), strict=False):
        if not sample.valid.all():  # lost: the Adams have nothing to go by
            continue
        R = truth.R_parent_joint[k] @ error
        pose = Pose(sample.time_s, R, np.zeros(3), np.full((24, 3), 0.2), "", covariance)
        began = time.perf_counter()
        memory, _ = qp.refine(memory, pose, sample, 1 / 25)
        times["hybrid's refinement"].append(time.perf_counter() - began)
        began = time.perf_counter()
        closed = refine(R, joints, sample.R_world_bone, AdamSettings())
        times["Adam, closed form"].append(time.perf_counter() - began)
        began = time.perf_counter()
        automatic = by_autograd(R, joints, sample.R_world_bone, AdamSettings())
        times["Adam, autograd"].append(time.perf_counter() - began)
        apart = max(apart, float(orientation.angle_between(closed, automatic).max()))
    print(row(("one frame, three devices", "p50 ms", "p99 ms"), WIDTHS))
    for name, found in times.items():
        ms = 1e3 * np.array(found[2:])
        print(row((name, f"{np.median(ms):.2f}", f"{np.percentile(ms, 99):.2f}"), WIDTHS))
    print(f"the two Adams end at most {np.rad2deg(apart):.2g} deg apart")


def by_autograd(
    R_parent_joint: np.ndarray,
    joints: tuple[int, ...],
    R_measured: np.ndarray,
    settings: AdamSettings,
) -> np.ndarray:
    """What `imuposer.adam.refine` does, gradients by torch; each step's rotation vectors start at zero."""
    moving = [j for joint in joints for j in CHAINS[joint]]
    R = torch.as_tensor(R_parent_joint, dtype=torch.float32)
    target = torch.tensor(R_measured, dtype=torch.float32)
    turn = torch.zeros(len(moving), 3, requires_grad=True)
    steps = torch.optim.Adam(
        [turn], settings.learning_rate, (settings.beta1, settings.beta2), settings.epsilon
    )
    for _ in range(settings.steps):
        steps.zero_grad()
        turned = R.clone()
        turned[moving] = R[moving] @ kin.exp(turn)
        torch.mean((kin.rotations(turned)[list(joints)] - target).square()).backward()
        steps.step()
        with torch.no_grad():
            R[moving] = R[moving] @ kin.exp(turn)
            turn.zero_()
    return R.double().numpy()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--frames", type=int, default=40)
    parser.add_argument("--minutes", type=float)
    parser.add_argument("--adam", action="store_true")
    parser.add_argument("--refinement", action="store_true")
    parser.add_argument("--whole", action="store_true")
    parser.add_argument("--clips", type=int, default=12)
    parser.add_argument("--untrained", action="store_true")
    parser.add_argument("--dip", type=Path)
    parser.add_argument("--imuposer", type=Path)
    args = parser.parse_args()
    runtime.one_thread()
    print(machine())
    files = {"dip": args.dip, "imuposer": args.imuposer}
    if args.adam:
        adam(model_of("imuposer", args.imuposer, args.untrained), args.clips)
    elif args.refinement:
        refinement(max(60, args.frames))
    elif args.whole:
        whole(max(1500, args.frames), files)
    elif args.minutes:
        for network in files:
            memory(network, args.minutes)
    else:
        for network, path in files.items():
            speed(model_of(network, path, args.untrained), args.frames)


if __name__ == "__main__":
    main()
