"""The papers' experiments on this project's split: `python benchmarks/experiments.py NAME... [--steps N]`.

Each experiment trains what it compares (training clips), chooses by the pose error of validation clips and
measures on the test clips: CMU subjects 02, 05, 09, virtual sensors with the realistic noise unless the
experiment is about noise. Results go to the folder of -o as JSON lines (`NAME.jsonl`), a table is printed.
A run that is there already is not trained again. These figures are on these motions only: they do not belong
in the papers' tables.

Trained: dip-tables (Tables 2, 3: RNN and BiRNN with and without acceleration loss and dropout, offline and
online), dip-networks (Tables 4, 5: feed-forward, WaveNet, no accelerations), normalisations (appendix C),
share (25, 50, 100 % of the clips), hidden (64, 128, 256), augmentation (on, off), noise-gap (clean and noisy
training against clean and noisy test), licence (with and without Bandai's clips, with generated motion),
imuposer-limits (clips, units, augmentation, noise, Bandai), one-clip (learnt by heart), hybrid-share (the
hybrid around the networks of share). Of given weights (--weights): dip-window (Fig. 6), dip-histogram (Fig.
5), dip-validation and imuposer-validation (validation clips of CMU and of Bandai), imuposer-devices (Fig. 6),
imuposer-regions (Fig. 8).
"""

from __future__ import annotations

import argparse
import hashlib
import json
import sys
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import networks_on_split as on_split
import numpy as np
import torch
from common import row

from learned import checkpoint, online
from learned import tree as kin
from learned.config import for_network
from learned.dip.model import Dip
from learned.imuposer.specification import COMBINATIONS
from learned.model import Model
from learned.training import corpus, deviations
from learned.training.augmentation import Augmentation
from learned.training.settings import TrainSettings
from learned.training.trainer import Trainer
from learned.training.validation import cut_for, figures, predict, recordings
from learned.training.virtual_windows import Windows
from mocap import Motion, dataset
from mocap.errors import PoserError
from mocap.estimator import Estimator, replay
from mocap.synthesis import Noise
from poser.training_collections import BANDAI_STEP, own_clips
from sip.prior import shipped

BOTH = ("cmu", "bandai")
CLEAN = Noise.none()
# Runs are short beside the papers': without it the last steps' noise is what is compared.
COOLDOWN = 0.35
STRIDE = 25  # frames between those looked at (a second) where 24 combinations are compared


@dataclass(frozen=True)
class Variant:
    """One network to train: a name, changes of its configuration and of the settings, share of clips of
    these corpora.
    """

    name: str
    config: dict[str, Any]
    settings: dict[str, Any]
    share: float = 1.0
    corpora: tuple[str, ...] = BOTH
    network: str = "dip"


def variant(
    name: str,
    share: float = 1.0,
    corpora: tuple[str, ...] = BOTH,
    network: str = "dip",
    **changes: Any,
) -> Variant:
    """Settings are told from the network's configuration by their names."""
    own = ("reconstruct_acc", "augmentation", "frames")
    settings = {k: v for k, v in changes.items() if k in own}
    config = {k: v for k, v in changes.items() if k not in own}
    return Variant(name, config, settings, share, corpora, network)


def _tables() -> list[Variant]:
    out = []
    for architecture in ("rnn", "birnn"):
        for acc in (False, True):
            for dropout in (0.0, 0.2):
                words = "+".join(w for w, on in (("acc", acc), ("dropout", dropout)) if on)
                out.append(
                    variant(
                        f"{architecture} {words or 'plain'}", architecture=architecture,
                        reconstruct_acc=acc, dropout=dropout,
                    )
                )  # fmt: skip
    return out


def _imuposer(name: str, corpora: tuple[str, ...] = ("cmu",), **changes: Any) -> Variant:
    """CMU's clips alone where nothing else is said, as `poser train` has it."""
    return variant(name, corpora=corpora, network="imuposer", frames=125, **changes)


UNVARIED = replace(Augmentation.none(), noise=Noise(), noise_scale=(0.3, 1.5))
TRAINED: dict[str, list[Variant]] = {
    "dip-tables": _tables(),
    "dip-networks": [
        variant("birnn"),
        variant("feedforward", architecture="feedforward"),
        variant("wavenet", architecture="wavenet"),
        variant("birnn no acc", use_acc=False, reconstruct_acc=False),
    ],
    "normalisations": [variant(n, normalisation=n) for n in ("root", "first", "heading")],
    "share": [variant(f"{s:.0%}", share=s) for s in (0.25, 0.5, 1.0)],
    "hidden": [variant(f"{h} units", hidden=h) for h in (64, 128, 256)],
    "augmentation": [
        variant("augmented"),
        variant("not augmented", augmentation=UNVARIED),
    ],
    "licence": [
        variant("CMU and Bandai"),
        variant("CMU alone", corpora=("cmu",)),
        variant("CMU and generated motion", corpora=("cmu", "generated")),
    ],
    "imuposer-limits": [
        _imuposer("CMU alone"),
        _imuposer("limbs not spliced", augmentation=replace(Augmentation(), splice=0.0)),
        _imuposer("not augmented", augmentation=UNVARIED),
        _imuposer("with Bandai's clips", corpora=BOTH),
        _imuposer("25 % of the clips", share=0.25),
        _imuposer("half the units", hidden=128),
        _imuposer("trained clean", augmentation=replace(
            Augmentation(), noise=CLEAN, noise_scale=(0, 0), seat_m=0.0)),
    ],
    "noise-gap": [
        variant("trained noisy"),
        variant("trained noisy, fixed seats", augmentation=replace(Augmentation(), seat_m=0.0)),
        variant("trained clean, fixed seats", augmentation=replace(
            Augmentation(), noise=CLEAN, noise_scale=(0, 0), seat_m=0.0)),
    ],
}  # fmt: skip
ONLINE = {"offline": None, "(20,5)": (20, 5), "(50,5)": (50, 5), "(20,0)": (20, 0)}


@cache
def training_clips(corpora: tuple[str, ...]) -> corpus.Corpus:
    return own_clips(corpora)[0]


def folder_of(name: str, what: Any, args: argparse.Namespace) -> Path:
    """Named by what is trained: other settings are another run."""
    said = json.dumps(what, sort_keys=True)
    return Path(args.output / "runs" / f"{name}-{hashlib.sha256(said.encode()).hexdigest()[:10]}")


def trained(v: Variant, args: argparse.Namespace) -> Model:
    """The best weights of a variant's run, trained where they are not there yet."""
    network = v.network
    config = for_network(network, **({"hidden": args.hidden} | v.config))
    settings = TrainSettings.paper(
        network, **({"config": config, "minutes": args.minutes, "steps": args.steps, "patience": 0,
                     "seed": args.seed, "every": args.every, "batch": args.batch,
                     "cooldown": COOLDOWN} | v.settings)
    )  # fmt: skip
    # Experiments that share a network train it once.
    what = [settings.to_json(), v.share] + ([v.corpora] if v.corpora != BOTH else [])
    folder = folder_of(network, what, args)
    clips = training_clips(v.corpora)
    if v.share < 1:
        clips = clips.subset(v.share, args.seed)
    source = Windows(clips, config.sensors, config.rate_hz, settings.frames, settings.augmentation)
    noise = settings.augmentation.noise
    held = cut_for(network, on_split.recorded("validation", network, noise), args.windows)
    run = Trainer(settings, source, held, folder, {"data": {"what": "the project's split"}})
    best = run.run(lambda r: print(f"\r{v.name}: {r['done']:.0%}  ", end="", file=sys.stderr))
    print(f"\r{v.name}: {run.step} steps", file=sys.stderr)
    return checkpoint.load(best)


def rows_of_trained(name: str, args: argparse.Namespace) -> Iterable[dict[str, Any]]:
    """One row a variant and way of showing it the test clips."""
    for v in TRAINED[name]:
        model = trained(v, args)
        if v.network == "imuposer":
            yield {"variant": v.name} | over_combinations(model)
            continue
        ways: dict[str, tuple[int, int] | None] = (
            ONLINE if name == "dip-tables" else {"(20,5)": (20, 5)}
        )
        for noise_name, noise in {"realistic": Noise(), "none": CLEAN}.items():
            if noise_name == "none" and name != "noise-gap":
                continue
            tests = on_split.recorded("test", "dip", noise)
            for way, window in ways.items():
                found = on_split.measured(on_split.dip_motions(model, tests, window), tests)
                yield {"variant": v.name, "shown": way, "test noise": noise_name} | found


def rows_of_hybrid_share(args: argparse.Namespace) -> Iterable[dict[str, Any]]:
    """DIP and the hybrid around it, trained on 25, 50 and 100 % of the clips: the networks of `share`, their
    deviations fitted on the validation clips.
    """
    import hybrid

    tests = on_split.recorded("test", "dip", Noise())
    held = cut_for("dip", on_split.recorded("validation", "dip", Noise()), args.windows)
    for v in TRAINED["share"]:
        model = trained(v, args)
        assert isinstance(model, Dip)
        deviations.calibrate(model, held)
        dip = online.stream(model, 60.0)
        ways: dict[str, Estimator] = {"dip": dip, "hybrid": hybrid.Tracker(dip)}
        for method, estimator in ways.items():
            motions = [replay(estimator, r).motion for r in tests]
            yield {"variant": v.name, "method": method} | on_split.measured(motions, tests)


def rows_of_one_clip(args: argparse.Namespace) -> Iterable[dict[str, Any]]:
    """Learning one clip by heart, clean and not augmented: far under 1 deg, or something is broken."""
    recording = on_split.recorded("validation", "dip", CLEAN)[0]
    assert recording.reference is not None
    config = for_network("dip", hidden=args.hidden, dropout=0.0)
    settings = TrainSettings.paper(
        "dip", config=config, minutes=args.minutes, steps=args.steps, seed=args.seed, every=args.every,
        patience=0, augmentation=Augmentation.none(), cooldown=COOLDOWN,
    )  # fmt: skip
    clip = corpus.pack([("clip", recording.reference)])
    source = Windows(clip, config.sensors, config.rate_hz, settings.frames, settings.augmentation)
    folder = folder_of("one-clip", settings.to_json(), args)
    best = Trainer(settings, source, cut_for("dip", [recording], args.windows), folder).run()
    motions = on_split.dip_motions(checkpoint.load(best), [recording], (20, 5))
    yield {"frames": len(recording)} | on_split.measured(motions, [recording])


def rows_of_window(model: Model) -> Iterable[dict[str, Any]]:
    """Figure 6: error over past and future frames."""
    tests = on_split.recorded("test", "dip", Noise())
    for past in (0, 1, 5, 10, 20, 50):
        for future in (0, 1, 5, 10, 20):
            motions = on_split.dip_motions(model, tests, (past, future), stride=4)
            yield {"past": past, "future": future} | on_split.measured(motions, tests, stride=4)


def rows_of_histogram(model: Model) -> Iterable[dict[str, Any]]:
    """Figure 5: share of frames and joints by local angle, DIP's 15 joints, bins of 5 deg."""
    tests = on_split.recorded("test", "dip", Noise())
    angles = on_split.local_angles(on_split.dip_motions(model, tests, (20, 5)), tests)
    edges = np.r_[np.arange(0, 65, 5), 180]
    counts, _ = np.histogram(angles, edges)
    for low, high, n in zip(edges[:-1], edges[1:], counts, strict=True):
        yield {"from deg": int(low), "to deg": int(high), "share": n / angles.size}


def group_of(combination: Sequence[int]) -> str:
    """One of the 12 groups of IMUPoser's Figure 6: how many devices, left and right alike."""
    kinds = ["wrist", "wrist", "pocket", "pocket", "head"]
    worn = [kinds[i] for i in combination]
    return f"{len(worn)}: " + "+".join(
        f"{worn.count(k)} {k}" if worn.count(k) > 1 else k for k in dict.fromkeys(worn)
    )


@cache
def worn(model: Model, combination: tuple[int, ...]) -> list[Motion]:
    """IMUPoser's motions of the test clips with these devices: two figures ask for them."""
    tests = on_split.recorded("test", "imuposer", Noise())
    return on_split.imuposer_motions(model, tests, combination, STRIDE)


def over_combinations(model: Model) -> dict[str, float]:
    """Figures of the test clips, mean over the 24 combinations."""
    tests = on_split.recorded("test", "imuposer", Noise())
    found = [on_split.measured(worn(model, c), tests, STRIDE) for c in COMBINATIONS]
    return {k: float(np.mean([f[k] for f in found])) for k in found[0]}


def rows_of_devices(model: Model) -> Iterable[dict[str, Any]]:
    """Figure 6 of IMUPoser: the 24 combinations in their 12 groups (means over a group's)."""
    tests = on_split.recorded("test", "imuposer", Noise())
    groups: dict[str, list[dict[str, float]]] = {}
    for c in COMBINATIONS:
        groups.setdefault(group_of(c), []).append(on_split.measured(worn(model, c), tests, STRIDE))
    for name in sorted(groups):
        found = groups[name]
        means = {k: float(np.mean([f[k] for f in found])) for k in found[0]}
        yield {"devices": name, "combinations": len(found)} | means


def rows_of_regions(model: Model) -> Iterable[dict[str, Any]]:
    """Figure 8 of IMUPoser: joint distance by body region and by what the region wears, cm."""
    tests = on_split.recorded("test", "imuposer", Noise())
    cells: dict[tuple[str, str], list[float]] = {}
    for c in COMBINATIONS:
        by_joint = on_split.joint_cm(worn(model, c), tests, STRIDE)
        for region, (joints, device, other) in on_split.REGIONS.items():
            own, across = device in c, other is not None and other in c
            where = ("both sides" if across else "this one") if own else (
                "the other side" if across else "none")  # fmt: skip
            cells.setdefault((region, where), []).append(float(by_joint[list(joints)].mean()))
    for (region, where), values in sorted(cells.items()):
        yield {"region": region, "device": where, "position_cm": float(np.mean(values)),
               "combinations": len(values)}  # fmt: skip


def rows_of_validation(model: Model) -> Iterable[dict[str, Any]]:
    """Clips that trained and the validation clips of each collection, as training looks at them."""
    network = model.config.network
    turn = torch.as_tensor(shipped().mean, dtype=torch.float32).reshape(23, 3)
    still = torch.cat([torch.eye(3)[None], kin.exp(turn)])
    for collection, split, step in (
        ("cmu", "train", 6), ("cmu", "validation", 1), ("bandai", "validation", BANDAI_STEP),
    ):  # fmt: skip
        clips = dataset.select(split, (collection,))[::step]  # type: ignore[arg-type]
        held = cut_for(network, recordings(network, ((c.name, c.motion(None)) for c in clips)))
        of = {"collection": collection, "split": split, "clips": len(clips)}
        poses = {
            "mean pose": still.expand(len(held.clip), 24, 3, 3),
            network: predict(model, held)[0],
        }
        for what, estimated in poses.items():
            yield of | {"what": what} | figures(estimated, held)


OTHERS: dict[str, Callable[[argparse.Namespace], Iterable[dict[str, Any]]]] = {
    "one-clip": rows_of_one_clip,
    "hybrid-share": rows_of_hybrid_share,
}
OF_WEIGHTS: dict[str, tuple[str, Callable[[Model], Iterable[dict[str, Any]]]]] = {
    "dip-window": ("dip", rows_of_window),
    "dip-histogram": ("dip", rows_of_histogram),
    "dip-validation": ("dip", rows_of_validation),
    "imuposer-validation": ("imuposer", rows_of_validation),
    "imuposer-devices": ("imuposer", rows_of_devices),
    "imuposer-regions": ("imuposer", rows_of_regions),
}


@cache
def loaded(path: Path, network: str) -> Model:
    return checkpoint.load(path, network)


def weights_for(network: str, args: argparse.Namespace) -> Model:
    """--weights, else those that are shipped, else a network trained here."""
    path = args.weights or checkpoint.shipped(network)
    if args.weights or path.exists():
        return loaded(path, network)
    print(f"no weights of {network}: one is trained", file=sys.stderr)
    return trained(_imuposer(network) if network == "imuposer" else variant(network), args)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument(
        "names", nargs="+", metavar="NAME", choices=[*TRAINED, *OTHERS, *OF_WEIGHTS],
        help="one or more of the above",
    )  # fmt: skip
    parser.add_argument("--steps", type=int, default=20_000, help="of training, each network")
    parser.add_argument("--minutes", type=float, help="of training, at most")
    parser.add_argument("--hidden", type=int, default=512)
    parser.add_argument("--batch", type=int, default=16)
    parser.add_argument("--every", type=int, default=1000, help="steps between validations")
    parser.add_argument("--windows", type=int, help="validation windows (default: as poser train)")
    parser.add_argument("--clips", type=int, help="test clips (default: all)")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--weights", type=Path)
    parser.add_argument("-o", "--output", type=Path, default=dataset.cache_folder() / "experiments")
    args = parser.parse_args()
    torch.set_num_threads(1)
    on_split.MOST_CLIPS = args.clips
    for name in args.names:
        found = list(rows_of(name, args))
        told(name, found, args)


def rows_of(name: str, args: argparse.Namespace) -> Iterable[dict[str, Any]]:
    if name in TRAINED:
        return rows_of_trained(name, args)
    if name in OTHERS:
        return OTHERS[name](args)
    network, rows = OF_WEIGHTS[name]
    return rows(weights_for(network, args))


def told(name: str, found: list[dict[str, Any]], args: argparse.Namespace) -> None:
    """Append the rows to the experiment's file, and print them."""
    args.output.mkdir(parents=True, exist_ok=True)
    made = {"steps": args.steps, "minutes": args.minutes, "hidden": args.hidden, "seed": args.seed}
    with (args.output / f"{name}.jsonl").open("a") as out:
        for r in found:
            out.write(json.dumps(r | made) + "\n")
    columns = list(found[0])
    print(row(columns, [20] * len(columns)))
    for r in found:
        cells = [f"{x:.3f}" if isinstance(x, float) else x for x in r.values()]
        print(row(cells, [20] * len(columns)), flush=True)


if __name__ == "__main__":
    try:
        main()
    except PoserError as e:
        sys.exit(f"experiments: {e}")
