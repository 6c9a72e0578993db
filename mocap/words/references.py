"""What is worth knowing of a motion that becomes a recording's reference."""

from __future__ import annotations

from mocap.findings import Words
from mocap.timeline import seconds

WORDS: dict[str, Words] = {
    "reference-cut": lambda d: (
        f"of its {seconds(*d['of'])}, {seconds(*d['kept'])} are in {d['source']} and kept"
    ),
    "reference-replaced": "the reference motion that it holds is replaced",
    "reference-apart": "its sensors are {apart_deg:.0f} deg (median) from the bones of {source}: is it the "
    "motion of this recording, and does it face the same way?",
}
