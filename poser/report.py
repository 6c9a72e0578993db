"""One HTML page about a comparison: table, pictures, what was run on what. Nothing is fetched."""

from __future__ import annotations

import base64
import platform
from collections.abc import Mapping, Sequence
from html import escape
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from poser.results import rows

_STYLE = """
body { font: 15px/1.5 system-ui, sans-serif; color: #222; max-width: 72em; margin: 2em auto;
       padding: 0 1em; }
h1 { font-size: 1.5em; } h2 { font-size: 1.15em; margin-top: 2em; }
table { border-collapse: collapse; } th, td { padding: .25em .8em; text-align: right; }
th { border-bottom: 1px solid #888; font-weight: 600; } tr:nth-child(even) td { background: #f6f6f6; }
th:first-child, td:first-child { text-align: left; }
img { max-width: 100%; } figure { margin: 1em 0; } figcaption { color: #555; }
dt { font-weight: 600; } dd { margin: 0 0 .5em 1.5em; }
"""


def page(
    title: str,
    mean: Mapping[str, Mapping[str, Any]],
    pictures: Sequence[tuple[Path, str]],
    facts: Mapping[str, str],
) -> str:
    """The page. mean: of `results.json`. pictures: PNG files and their captions, embedded.

    facts: what was run, on what, with which numbers. Raises OSError where a picture cannot be read.
    """
    figures = "\n".join(_figure(path, caption) for path, caption in pictures)
    said = "\n".join(f"<dt>{escape(k)}</dt><dd>{escape(v)}</dd>" for k, v in facts.items())
    return f"""<!DOCTYPE html>
<html lang="en">
<head><meta charset="utf-8"><title>{escape(title)}</title><style>{_STYLE}</style></head>
<body>
<h1>{escape(title)}</h1>
{_table(mean)}
<p>Angles are geodesic; <em>SIP</em>: hips and shoulders; <em>angular</em>: 24 joints, root, wrists,
hands, ankles and feet masked; <em>position</em>: roots aligned, masked; <em>global</em>: 24 joints,
nothing masked; <em>instr.</em>: bones that carry a sensor. Mean pose and nearest pose need no skill: a
method has to beat both clearly.</p>
{figures}
<h2>What was run on what</h2>
<dl>
{said}
</dl>
</body>
</html>
"""


def environment(packages: Sequence[str] = ("poser-imu", "numpy", "scipy", "casadi")) -> str:
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
