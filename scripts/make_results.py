"""Tables of docs/results.md and of README from what the benchmarks left in benchmarks/results/.

`python scripts/make_results.py` writes them, `--check` fails where they are not what the files give. No
figure of theirs is typed by hand.
"""

from __future__ import annotations

import argparse
import json
import re
import sys
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
RESULTS = ROOT / "benchmarks" / "results"
PAGE, README = ROOT / "docs" / "results.md", ROOT / "README.md"
BLOCK = re.compile(r"(<!-- results -->\n).*?(<!-- /results -->)", re.DOTALL)

Rows = Sequence[dict[str, Any]]
ERRORS = ("sip_deg", "angular_deg", "position_cm", "jitter")
NAMES = {
    "mean-pose": "mean training pose (no skill)",
    "nearest-pose": "nearest training pose (no skill)",
    "sop": "SOP, offline",
    "sip": "SIP, offline",
    "sip+calibration": "SIP with self-calibration, offline",
    "sip+calibr.": "SIP with self-calibration, offline",
    "sip from truth": "SIP started at the truth",
    "sip from dip": "SIP started from DIP",
    "dip": "DIP, online",
    "hybrid": "hybrid, online",
    "hybrid-dip": "hybrid (DIP), online",
    "frame-dip": "single-frame hybrid (DIP), online",
    "imuposer": "IMUPoser, online",
    "imuposer-adam": "IMUPoser with ten Adam steps, online",
    "hybrid-imuposer": "hybrid (IMUPoser), online",
    "frame-imuposer": "single-frame hybrid (IMUPoser), online",
    "single frame": "single-frame hybrid (DIP), online",
    "default": "hybrid (DIP), online, 5 frames late",
    "lag 20": "hybrid (DIP), online, 20 frames late",
    "sip+constants": "SIP with self-calibration, offline",
    "sip+network": "SIP with the network's word, offline",
    "sip+both": "SIP with both, offline",
}


def load(name: str) -> dict[str, Any] | None:
    """What a benchmark left, or None."""
    path = RESULTS / f"{name}.json"
    return json.loads(path.read_text()) if path.exists() else None


def table(head: Iterable[str], rows: Iterable[Iterable[str]]) -> str:
    """A Markdown table."""
    head = list(head)
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def means(rows: Rows, by: str, names: Sequence[str]) -> list[list[str]]:
    """A line a value of `by`: the mean over its rows of each figure."""
    out = []
    for value in dict.fromkeys(r[by] for r in rows):
        mine = [r for r in rows if r[by] == value]
        cells = [mean(mine, k) for k in names]
        out.append([NAMES.get(value, str(value)), *cells])
    return out


def mean(rows: Rows, name: str, unit: float = 1.0, digits: int = 1) -> str:
    """Mean over rows that have the figure, times unit."""
    values = [r[name] for r in rows if r.get(name) is not None]
    return f"{unit * sum(values) / len(values):.{digits}f}" if values else ""


def made_by(record: dict[str, Any]) -> str:
    """The command and the machine, in small print."""
    return f"`{record['command']}` on {record['machine'].split(';')[0]}."


def offline(record: dict[str, Any], noise: str) -> str:
    """The optimizer on the test split; nothing where the benchmark ran without this noise."""
    rows = [r for r in record["rows"] if r["noise"] == noise]
    return table(("", *ERRORS), means(rows, "method", ERRORS)) if rows else ""


def horizon(record: dict[str, Any]) -> str:
    """The moving horizon beside its network and the optimizer, all on the same recordings."""
    columns = {
        **{k: (k, 1.0, 1) for k in ERRORS},
        "after 1 s": ("m_1s", 100.0, 0),
        "after 5 s": ("m_5s", 100.0, 0),
        "in 1 sigma": ("68 %", 100.0, 0),
        "in 2 sigma": ("95 %", 100.0, 0),
    }
    out = []
    for method in dict.fromkeys(r["variant"] for r in record["rows"]):
        mine = [r for r in record["rows"] if r["variant"] == method]
        cells = [mean(mine, *how) for how in columns.values()]
        out.append([NAMES[method], *cells])
    return table(("", *columns), out)


def horizon_subjects(record: dict[str, Any]) -> str:
    """sip_deg and position_cm by subject."""
    groups = sorted({r["group"] for r in record["rows"]})
    out = []
    for method in dict.fromkeys(r["variant"] for r in record["rows"]):
        cells = []
        for group in groups:
            mine = [r for r in record["rows"] if (r["variant"], r["group"]) == (method, group)]
            cells.append(f"{mean(mine, 'sip_deg')} / {mean(mine, 'position_cm')}")
        out.append([NAMES[method], *cells])
    return table(("sip_deg / position_cm", *groups), out)


def devices(record: dict[str, Any]) -> str:
    """One to three devices, by their number; nothing where the benchmark ran without them."""
    rows, out = record["rows"].get("imuposer", []), []
    if not rows:
        return ""
    methods = list(dict.fromkeys(r["method"] for r in rows))
    for label, few in (("1", 1), ("2", 2), ("3", 3), ("all 24 combinations", 0)):
        part = [r for r in rows if not few or len(r["devices"]) == few]
        cells = [
            " / ".join(
                mean([r for r in part if r["method"] == m], k) for k in ("position_cm", "sip_deg")
            )
            for m in methods
        ]
        out.append([label, *cells])
    return table(("devices", *(NAMES.get(m, m) for m in methods)), out)


def real(record: dict[str, Any]) -> str:
    """The real person, by window."""
    rows = [r for r in record["rows"] if r["orientation"] == "file"]
    windows = list(dict.fromkeys(r["window"] for r in rows))
    out = []
    for method in dict.fromkeys(r["method"] for r in rows):
        cells = [
            mean([r for r in rows if r["method"] == method and r["window"] == w], "left_out_deg")
            for w in windows
        ]
        out.append([NAMES.get(method, method), *cells])
    return table(("left_out_deg", *windows), out)


def page() -> str:
    """The whole page."""
    parts = [
        "# Results",
        "Every table is made by `python scripts/make_results.py` from the files that the benchmarks left in "
        "`benchmarks/results/`. Figures are on this data only: do not set them beside published ones on "
        "DIP-IMU or TotalCapture.",
        "**Test split**: CMU subjects 02, 05 and 09, nobody's training motion; virtual sensors with the "
        "realistic noise of `mocap.synthesis.Noise`; frames with a fault of the capture left out "
        "(`poser data`). Root, wrists and feet are masked as the field does it. Means over clips; sip_deg "
        "and angular_deg in deg, position_cm in cm, jitter in 100 m/s^3. after 1 s, 5 s: error of the "
        "root's path in cm. in 1 sigma, 2 sigma: per cent of the joints' errors, axis by axis, inside the "
        "deviations that the method states (68 and 95 would be right).",
    ]
    sections = (
        ("split", "Offline, six sensors, realistic noise", lambda r: offline(r, "realistic")),
        ("split", "Offline, six sensors, clean", lambda r: offline(r, "none")),
        ("horizon", "Six sensors at 60 Hz, realistic noise: all on the same recordings", horizon),
        ("horizon", "The same by subject", horizon_subjects),
        (
            "validation",
            "People and another rig that no network has learnt from (validation)",
            horizon,
        ),
        ("validation", "The same by subject and rig", horizon_subjects),
        ("methods", "Online, one to three devices at 25 Hz: position_cm / sip_deg", devices),
        ("real", "A real person: angle to the sensors that no method saw", real),
    )
    for name, title, make in sections:
        record = load(name)
        if record is not None and (body := make(record)):
            parts += [f"## {title}", body, made_by(record)]
    return "\n\n".join(parts) + "\n"


def clips(rows: Rows) -> str:
    """How many clips the rows are of."""
    return str(len({r["clip"] for r in rows}))


def summary() -> str:
    """README's one table: what a newcomer asks first."""
    split, online = load("split"), load("horizon")
    names = ("sip_deg", "angular_deg", "position_cm", "jitter")
    rows = []
    if split:
        kept = [r for r in split["rows"] if r["noise"] == "realistic"]
        order = ("mean-pose", "nearest-pose", "sop")
        found = means([r for m in order for r in kept if r["method"] == m], "method", names)
        rows += [[*line, clips(kept)] for line in found]
    if online:
        order = ("dip", "single frame", "default", "sip", "sip+both")
        fresh = [r for m in order for r in online["rows"] if r["variant"] == m]
        rows += [[*line, clips(fresh)] for line in means(fresh, "variant", names)]
    return table(("test split, six noisy sensors", *names, "clips"), rows) + "\n"


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "--check", action="store_true", help="write nothing, fail where they differ"
    )
    check = parser.parse_args().check
    readme = README.read_text()
    made = {PAGE: page(), README: BLOCK.sub(lambda m: m[1] + summary() + m[2], readme)}
    stale = [path for path, text in made.items() if path.read_text() != text]
    for path in stale:
        if check:
            print(
                f"{path.relative_to(ROOT)} is not what benchmarks/results/ gives", file=sys.stderr
            )
        else:
            path.write_text(made[path])
    return int(check and bool(stale))


if __name__ == "__main__":
    sys.exit(main())
