"""The project's own collections as `poser train` uses them: clips, shares, licence."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from poser import files, licences
from poser.console import Progress, UsageError, note, part

if TYPE_CHECKING:
    from learned.training.corpus import Corpus
    from learned.training.validation import Windowed
    from mocap.dataset import Clip
    from mocap.motion import Motion

# Of the windows where several collections are asked for: Bandai's is larger and repetitive, nobody moves as
# the generated one does.
SHARES = {"cmu": 0.65, "bandai": 0.35, "generated": 0.25}
SOURCES = {
    "cmu": "CMU Graphics Lab mocap (mocap.cs.cmu.edu)",
    "bandai": "Bandai-Namco-Research-Motiondataset-2 (CC BY-NC 4.0)",
    "generated": "motion drawn at random (mocap.synthesis.generated)",
}
CREDITS = {
    "cmu": "The data used was obtained from mocap.cs.cmu.edu, created with funding from NSF EIA-0196217.",
    "bandai": "Bandai-Namco-Research-Motiondataset-2, Bandai Namco Research Inc., CC BY-NC 4.0.",
}
ENOUGH = 60  # training files that an error covariance is fitted on, beside the validation files
BANDAI_STEP = 12  # every so many of Bandai's validation clips: they are much alike


def licence(collections: Sequence[str]) -> str:
    """Of weights trained on these collections alone."""
    return licences.NON_COMMERCIAL if "bandai" in collections else licences.PERMISSIVE


def windows(network: str, given: Sequence[Path | Clip]) -> Windowed:
    """As the network sees the motions of these files online."""
    from learned.training import validation

    return validation.cut_for(network, validation.recordings(network, _motions(given)))


def evenly(given: Sequence[Path | Clip]) -> Sequence[Path | Clip]:
    """At most about `ENOUGH` of them."""
    return given[:: max(1, len(given) // ENOUGH)]


def _motions(given: Sequence[Path | Clip]) -> Iterator[tuple[str, Motion]]:
    """Without the faults of the capture, as training sees them."""
    from mocap import faults

    for one in given:
        if isinstance(one, Path):
            yield one.stem, faults.mend(files.motion(one, quiet=True)).motion
        else:
            yield one.name, one.motion(None)


def tell_absent(collections: Sequence[str]) -> None:
    """A note about each archive of these collections that is not there."""
    from mocap import dataset

    for source in dataset.absent(collections):
        note(
            f"{dataset.cache_folder() / source} is not there: without {dataset.NAMES[source]} "
            f"there is less to train on (poser data lists what is used)"
        )


def own_clips(
    collections: Sequence[str], tell: Progress = lambda fraction, words: None
) -> tuple[Corpus, list[str]]:
    """The training clips (`mocap.dataset`) of these of the project's collections, drawn from by `SHARES`; a
    key of each collection that changes with them."""
    from learned.training import corpus
    from mocap import dataset
    from mocap.synthesis import generated

    parts, keys = [], []
    for k, collection in enumerate(collections):
        forward = part(tell, k / len(collections), (k + 1) / len(collections))
        if collection == "generated":
            forward(0.0, "drawing motions at random")
            parts.append(corpus.pack((n, corpus.prepared(m)) for n, m in generated.motions()))
            keys.append(f"{generated.NAME} {generated.VERSION}")
            continue
        clips = dataset.select("train", (collection,))
        parts.append(
            corpus.read(clips, lambda i, n, f=forward: f(i / n, f"reading {i} of {n} motions"))  # type: ignore[misc]
        )
        keys.append(corpus.key_of(clips))
    return corpus.Corpus.join(parts, [SHARES[c] for c in collections]), keys


def learnt(names: Sequence[str], collections: Sequence[str]) -> list[Clip]:
    """The clips of these collections that a corpus names."""
    from mocap import dataset

    named, captured = set(names), [c for c in collections if c != "generated"]
    return [c for c in dataset.select("train", captured) if str(c.path) in named]


def own_split(
    network: str, collections: Sequence[str], tell: Progress
) -> tuple[Corpus, Windowed, dict[str, Any]]:
    """The training clips of these collections, windows of their validation clips, and what all is made of."""
    from mocap import dataset

    captured = [c for c in collections if c != "generated"]
    if not captured:
        raise UsageError("argument --collections: generated only beside another, which validates")
    tell_absent(captured)
    clips, keys = own_clips(collections, part(tell, 0.0, 0.9))
    held: list[Clip] = []
    for collection in captured:
        mine = dataset.select("validation", (collection,))
        held += mine[::BANDAI_STEP] if collection == "bandai" else mine
    about = {
        "what": " and ".join(SOURCES[c] for c in captured) + ", training clips of the project's split"
        + (f"; {SOURCES['generated']}" if "generated" in collections else ""),
        "credit": " ".join(CREDITS[c] for c in captured),
        "key": " ".join(keys), "clips": len(clips.names), "minutes": round(clips.seconds / 60, 1),
        "validation_clips": len(held),
    }  # fmt: skip
    return clips, windows(network, held), about
