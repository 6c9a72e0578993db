"""One HTML page about a comparison: tables, pictures, skeletons that play. Nothing is fetched."""

from __future__ import annotations

import base64
import platform
from collections.abc import Mapping, Sequence
from html import escape
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from poser.report import player
from poser.report.results import Compared, rows

_STYLE = """
body { font: 15px/1.5 system-ui, sans-serif; color: #222; max-width: 72em; margin: 2em auto;
       padding: 0 1em; }
h1 { font-size: 1.5em; } h2 { font-size: 1.15em; margin-top: 2em; }
table { border-collapse: collapse; } th, td { padding: .25em .8em; text-align: right; }
th { border-bottom: 1px solid #888; font-weight: 600; } tr:nth-child(even) td { background: #f6f6f6; }
th:first-child, td:first-child { text-align: left; }
.quiet { color: #666; font-size: .9em; } details { margin: .6em 0; } summary { cursor: pointer; }
/* A wide table scrolls in its own box, the methods' names stay; a shadow tells that there is more. */
.wide { overflow-x: auto; max-width: 100%; background:
  linear-gradient(to right, white 30%, transparent) left / 3em 100% no-repeat local,
  linear-gradient(to left, white 30%, transparent) right / 3em 100% no-repeat local,
  linear-gradient(to left, #0003, transparent) right / .9em 100% no-repeat scroll; }
.wide th:first-child, .wide td:first-child { position: sticky; left: 0; background: white;
  white-space: nowrap; }
.wide tr:nth-child(even) td:first-child { background: #f6f6f6; }
img { max-width: 100%; } figure { margin: 1em 0; } figcaption { color: #555; }
dt { font-weight: 600; } dd { margin: 0 0 .5em 1.5em; }
"""


def page(
    title: str,
    recordings: Sequence[Compared],
    mean: Mapping[str, Mapping[str, Any]],
    pictures: Sequence[tuple[Path, str]],
    facts: Mapping[str, str],
    failures: Sequence[str] = (),
) -> str:
    """The page. mean: of `results.json`. pictures: PNG files and their captions, embedded.

    facts: what was run, on what, with which numbers. failures: sentences about what could not be measured.
    Raises OSError where a picture cannot be read.
    """
    figures = "\n".join(_figure(path, caption) for path, caption in pictures)
    said = "\n".join(f"<dt>{escape(k)}</dt><dd>{escape(v)}</dd>" for k, v in facts.items())
    return f"""<!DOCTYPE html>
<html lang="en">
<head><meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>{escape(title)}</title><style>{_STYLE}</style></head>
<body>
<h1>{escape(title)}</h1>
<div class="wide" tabindex="0">{_table(mean)}</div>
<p class="quiet">Means over recordings of each recording's mean. Angles are geodesic; <em>SIP</em>: hips and
shoulders; <em>angular</em>: 24 joints, root, wrists, hands, ankles and feet masked; <em>position</em>: roots
aligned, masked; <em>global</em>: 24 joints, nothing masked; <em>instr.</em>: bones that carry a sensor that
the method saw; <em>left out</em>: bones whose sensors it did not see, against what those measured.
<em>ms/frame</em>: an offline method's solving time over its frames, an online method's mean time for one
frame of the recording; <em>p50, p99</em>: what half and 99 % of these frames take at most (a network that
runs slower than the recording is not run in all of them); <em>latency</em>: frames that it looks ahead. Mean
pose and nearest pose need no skill: a method has to beat both clearly.</p>
{_failures(failures)}
<h2>Side by side</h2>
{player.section(recordings)}
{figures}
{_each(recordings)}
<h2>What was run on what</h2>
<dl>
{said}
</dl>
</body>
</html>
"""


def _failures(sentences: Sequence[str]) -> str:
    if not sentences:
        return ""
    lines = "\n".join(f"<li>{escape(s)}</li>" for s in sentences)
    return f"<h2>Not measured</h2>\n<ul>\n{lines}\n</ul>"


def _each(recordings: Sequence[Compared]) -> str:
    """A table for each recording where there are several, folded."""
    if len(recordings) < 2:
        return ""
    parts = []
    for r in recordings:
        one = {name: m.to_json() for name, m in r.methods.items()}
        parts.append(
            f"<details><summary>{escape(r.name)} (reference: {escape(r.reference)})</summary>"
            f'<div class="wide" tabindex="0">{_table(one)}</div></details>'
        )
    return "<h2>Each recording</h2>\n" + "\n".join(parts)


def environment(
    packages: Sequence[str] = ("poser-imu", "numpy", "scipy", "casadi", "pin", "torch", "osqp"),
) -> str:
    """Versions of what computed, and the kind of machine."""
    found = [f"Python {platform.python_version()}"]
    for name in packages:
        try:
            found.append(f"{name} {version(name)}")
        except PackageNotFoundError:
            continue
    return f"{', '.join(found)}; {platform.system()} {platform.machine()}"


def _table(mean: Mapping[str, Mapping[str, Any]]) -> str:
    header, body = rows(mean)
    head = "".join(f"<th>{escape(h)}</th>" for h in header)
    lines = "\n".join(
        "<tr>" + "".join(f"<td>{escape(c)}</td>" for c in row) + "</tr>" for row in body
    )
    return f"<table>\n<tr>{head}</tr>\n{lines}\n</table>"


def _figure(path: Path, caption: str) -> str:
    data = base64.b64encode(path.read_bytes()).decode("ascii")
    return (
        f'<figure><img alt="{escape(caption)}" src="data:image/png;base64,{data}">'
        f"<figcaption>{escape(caption)}</figcaption></figure>"
    )
