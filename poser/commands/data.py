"""List the motion capture that poser trains, validates and tests on: minutes by subject and split, what is
left out of it and why. The first time every file is read, which takes minutes; then they come from the cache.
"""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from collections import Counter
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from poser import options
from poser.console import DONE, emit, progress, say, table

if TYPE_CHECKING:
    from mocap.dataset import Clip

HELP = "the motion capture to train on: minutes by subject and split, what is left out"


def add_arguments(parser: ArgumentParser) -> None:
    parser.add_argument(
        "--collections", nargs="+", choices=("cmu", "bandai"), default=["cmu"], help="default: cmu"
    )
    options.add_json(parser)


def run(args: Namespace) -> int:
    from mocap import dataset

    collections = tuple(dict.fromkeys(args.collections))
    every = dataset.every(collections)
    facts = _facts([c for c in every if not c.left_out]) | {
        "left_out": [
            {"clip": c.name, "from": c.source, "reason": c.left_out} for c in every if c.left_out
        ],
        "absent": [
            {"archive": a, "what": dataset.NAMES[a], "folder": str(dataset.cache_folder() / a)}
            for a in dataset.absent(collections)
        ],
    }
    if args.json:
        emit(facts)
    else:
        _print(facts)
    return DONE


def _facts(used: Sequence[Clip]) -> dict[str, Any]:
    """Minutes of each subject and split, and the clips that lose frames."""
    from learned.training.corpus import RATE_HZ, counts

    clips: list[dict[str, Any]] = []
    with progress("reading motions") as tell:
        for i, clip in enumerate(used):
            tell(i / len(used), f"reading {i + 1} of {len(used)} motions")
            frames, untrusted, mended = counts(clip)
            clips.append(
                {"clip": clip.name, "subject": clip.subject, "split": clip.split, "from": clip.source,
                 "seconds": frames / RATE_HZ, "untrusted_s": untrusted / RATE_HZ,
                 "mended_s": mended / RATE_HZ}
            )  # fmt: skip
    groups: dict[tuple[str, str], list[dict[str, Any]]] = {}
    for one in clips:
        groups.setdefault((one["split"], one["subject"]), []).append(one)
    subjects = [
        {"split": split, "subject": subject} | _sum(group)
        for (split, subject), group in sorted(
            groups.items(), key=lambda g: (_ORDER[g[0][0]], g[0][1])
        )
    ]
    splits = {split: _sum([c for c in clips if c["split"] == split]) for split in _ORDER}
    return {"splits": splits, "subjects": subjects, "clips": clips}


_ORDER = {"train": 0, "validation": 1, "test": 2}


def _sum(clips: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """How many clips, minutes in all, and of these what is not trusted and what was mended."""
    minutes = {
        name: sum(c[seconds] for c in clips) / 60
        for name, seconds in (
            ("minutes", "seconds"), ("untrusted_minutes", "untrusted_s"), ("mended_minutes", "mended_s"),
        )
    }  # fmt: skip
    return {"clips": len(clips), **minutes, "from": dict(Counter(c["from"] for c in clips))}


def _print(facts: dict[str, Any]) -> None:
    rows = []
    for split, total in facts["splits"].items():
        mine = [s for s in facts["subjects"] if s["split"] == split]
        rows += [_row(split, s["subject"], s) for s in mine]
        if mine:
            rows.append(_row(split, "all", total))
    header = ("split", "subject", "clips", "minutes", "faulty s", "mended s", "from")
    table(header, rows)
    say(
        "faulty: a limb flips or stands as none can; these frames neither train nor count. mended: flips "
        "that were turned back."
    )
    for reason, names in _by_reason(facts["left_out"]).items():
        say(f"left out, {reason}: {', '.join(names)}")
    for one in facts["absent"]:
        say(f"not there: {one['folder']} ({one['what']})")


def _row(split: str, subject: str, one: dict[str, Any]) -> tuple[str, ...]:
    return (
        split, subject, str(one["clips"]), f"{one['minutes']:.1f}", f"{60 * one['untrusted_minutes']:.1f}",
        f"{60 * one['mended_minutes']:.1f}", " ".join(f"{k}:{v}" for k, v in one["from"].items()),
    )  # fmt: skip


def _by_reason(left_out: Sequence[dict[str, str]]) -> dict[str, list[str]]:
    out: dict[str, list[str]] = {}
    for one in left_out:
        out.setdefault(one["reason"], []).append(one["clip"])
    return out
