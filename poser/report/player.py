"""Skeletons side by side that play in a page: data and script are part of the page, nothing is fetched."""

from __future__ import annotations

import base64
import json
from collections.abc import Sequence
from typing import Any

import numpy as np

from mocap.motion import Motion
from mocap.skeleton import JOINTS, PARENTS
from poser.report.results import COLOURS, NAMES, NO_SKILL, Compared, joint_colour

RATE_HZ = 30.0
BUDGET_BYTES = (
    24_000_000  # of joint positions in a page; recordings beyond it are left out, and said so
)


def section(recordings: Sequence[Compared]) -> str:
    """The player's HTML: as many of the recordings as `BUDGET_BYTES` holds, the first ones."""
    shown: list[dict[str, Any]] = []
    spent = 0
    for compared in recordings:
        entry, size = _entry(compared)
        if shown and spent + size > BUDGET_BYTES:
            break
        shown.append(entry)
        spent += size
    left = len(recordings) - len(shown)
    note = f"<p>{left} further recordings are in the motion files alone.</p>" if left else ""
    data = {
        "parents": list(PARENTS),
        "colours": [joint_colour(name) for name in JOINTS],
        "recordings": shown,
    }
    # No "<" of a recording's name may begin a tag or a comment inside the script element.
    text = json.dumps(data, separators=(",", ":")).replace("<", "\\u003c")
    return (
        f"{_CONTROLS}{note}"
        f'<script type="application/json" id="player-data">{text}</script>\n<script>{_SCRIPT}</script>'
    )


def _entry(compared: Compared) -> tuple[dict[str, Any], int]:
    reference = compared.truth
    rate = min(RATE_HZ, reference.rate_hz)
    tracks: list[dict[str, Any]] = [
        {"name": "reference", "colour": "#888888"} | _positions(reference, rate, reference)
    ]
    for name, result in compared.methods.items():
        if name in NO_SKILL:
            continue
        track: dict[str, Any] = {
            "name": NAMES.get(name, name),
            "colour": COLOURS.get(name, "#333333"),
        }
        track |= _positions(result.motion, rate, reference)
        error = result.metrics.frame_position_cm
        if error is not None:
            source = result.metrics.rate_hz or reference.rate_hz
            at = np.minimum(
                (np.arange(track["frames"]) * source / rate).astype(int), len(error) - 1
            )
            track["error_cm"] = [round(float(e), 1) for e in error[at]]
        tracks.append(track)
    size = sum(len(t["data"]) for t in tracks)
    start = round(compared.start_s, 6)
    return {"name": compared.name, "rate": rate, "start": start, "tracks": tracks}, size


def _positions(motion: Motion, rate_hz: float, reference: Motion) -> dict[str, Any]:
    """Joints in mm as little-endian int16, base64: frame by frame, 24 joints, xyz; the pelvis stays over
    the middle of the floor, as high as the reference's: few methods know where the body is."""
    p = motion.resampled(rate_hz).p_world_joint
    height = reference.resampled(rate_hz).p_world_root[:, 1]
    p = p - p[:, :1]
    p[..., 1] += height[np.minimum(np.arange(len(p)), len(height) - 1)][:, None]
    mm = np.clip(np.round(1000 * p), -32768, 32767).astype("<i2")
    return {"frames": len(p), "data": base64.b64encode(mm.tobytes()).decode("ascii")}


_CONTROLS = """<div id="player">
<p><label>Recording <select id="pl-recording"></select></label>
<button id="pl-play" type="button">Play</button>
<label>Speed <select id="pl-speed"><option>0.25</option><option>0.5</option><option selected>1</option>
<option>2</option></select></label>
<input id="pl-time" type="range" min="0" value="0" aria-label="time"
style="width:22em;max-width:100%;vertical-align:middle">
<output id="pl-clock" style="white-space:nowrap"></output></p>
<canvas id="pl-bodies" style="width:100%;touch-action:none;cursor:grab"></canvas>
<canvas id="pl-errors" style="width:100%;height:170px;cursor:pointer"></canvas>
<p id="pl-legend" style="margin:0 0 .5em 34px;font-size:.85em"></p>
<p class="quiet">Drag to look around. Blue: left, orange: right, light grey behind: the reference,
pelvis on pelvis. Below: distance of the joints to the reference, roots aligned, cm; click to go there.</p>
</div>
"""

_SCRIPT = r"""
(function () {
"use strict";
const data = JSON.parse(document.getElementById("player-data").textContent);
const el = id => document.getElementById("pl-" + id);
const bodies = el("bodies"), errors = el("errors"), slider = el("time");
let rec = null, frame = 0, playing = false, yaw = -0.6, tilt = 0.2, last = 0, clock = 0;
function decode(text) {
  const bin = atob(text), bytes = new Uint8Array(bin.length);
  for (let i = 0; i < bin.length; i++) bytes[i] = bin.charCodeAt(i);
  return new Int16Array(bytes.buffer);
}
data.recordings.forEach((r, i) => {
  const o = document.createElement("option"); o.value = i; o.textContent = r.name;
  el("recording").appendChild(o);
});
function load(i) {
  rec = data.recordings[i];
  rec.tracks.forEach(t => { if (!t.p) t.p = decode(t.data); });
  slider.max = rec.tracks[0].frames - 1;
  frame = clock = 0; legend(); layout(); draw();
}
// The chart's methods by their colours.
function legend() {
  el("legend").replaceChildren(...rec.tracks.filter(t => t.error_cm).flatMap(t => {
    const item = document.createElement("span"), swatch = document.createElement("span");
    item.style.cssText = "white-space:nowrap;margin-right:1.4em;color:" + t.colour;
    swatch.style.cssText = "display:inline-block;width:1.6em;vertical-align:middle;margin-right:.4em;" +
      "border-top:3px solid " + t.colour;
    item.append(swatch, t.name);
    // The space between two items is where a line may break.
    return [item, " "];
  }));
}
function layout() {
  const ratio = window.devicePixelRatio || 1, width = bodies.clientWidth;
  const columns = Math.min(rec.tracks.length, Math.max(2, Math.floor(width / 230)));
  const rows = Math.ceil(rec.tracks.length / columns), side = width / columns;
  bodies.style.height = rows * side * 1.15 + "px";
  for (const c of [bodies, errors]) { c.width = c.clientWidth * ratio; c.height = c.clientHeight * ratio; }
  rec.cell = { columns, w: bodies.width / columns, h: bodies.height / rows };
}
function project(x, y, z, cell) {
  const cx = Math.cos(yaw), sx = Math.sin(yaw);
  const u = cx * x + sx * z, d = -sx * x + cx * z;
  const v = Math.cos(tilt) * y - Math.sin(tilt) * d;
  const s = cell.h / 2500;
  return [cell.x + cell.w / 2 + s * u, cell.y + cell.h * 0.88 - s * v];
}
function line(g, a, b) { g.beginPath(); g.moveTo(a[0], a[1]); g.lineTo(b[0], b[1]); g.stroke(); }
function body(g, track, cell, ghost) {
  const t = Math.min(frame, track.frames - 1) * 72, p = track.p;
  const at = j => project(p[t + 3 * j], p[t + 3 * j + 1], p[t + 3 * j + 2], cell);
  g.lineCap = "round";
  for (let j = 1; j < 24; j++) {
    g.strokeStyle = ghost ? "#d4d4d4" : data.colours[j];
    g.lineWidth = (ghost ? 7 : 3.5) * cell.h / 330;
    line(g, at(data.parents[j]), at(j));
  }
  const neck = at(12), head = at(15);
  g.lineWidth = 2 * cell.h / 330; g.strokeStyle = ghost ? "#d4d4d4" : data.colours[15];
  g.beginPath();
  g.arc(head[0] + (head[0] - neck[0]) * 0.6, head[1] + (head[1] - neck[1]) * 0.6, 0.038 * cell.h, 0, 7);
  g.stroke();
}
function draw() {
  const g = bodies.getContext("2d"), c = rec.cell;
  g.clearRect(0, 0, bodies.width, bodies.height);
  rec.tracks.forEach((track, i) => {
    const cell = { x: (i % c.columns) * c.w, y: Math.floor(i / c.columns) * c.h, w: c.w, h: c.h };
    g.strokeStyle = "#e2ddd2"; g.lineWidth = 1;
    for (let k = -2; k <= 2; k++) {
      line(g, project(k * 300, 0, -600, cell), project(k * 300, 0, 600, cell));
      line(g, project(-600, 0, k * 300, cell), project(600, 0, k * 300, cell));
    }
    if (i) body(g, rec.tracks[0], cell, true);
    body(g, track, cell, false);
    g.fillStyle = track.colour; g.font = "600 " + 0.048 * cell.h + "px system-ui, sans-serif";
    g.textAlign = "center";
    const e = !track.error_cm ? "" :
      "  " + track.error_cm[Math.min(frame, track.frames - 1)].toFixed(1) + " cm";
    g.fillText(track.name + e, cell.x + cell.w / 2, cell.y + 0.055 * cell.h);
  });
  chart();
  slider.value = frame;
  const time = k => (rec.start + k / rec.rate).toFixed(2);
  el("clock").textContent = time(frame) + " s of " + (rec.start ? time(0) + " to " : "") +
    time(rec.tracks[0].frames - 1) + " s";
}
function chart() {
  const g = errors.getContext("2d"), w = errors.width, h = errors.height, n = rec.tracks[0].frames;
  const r = window.devicePixelRatio || 1, left = 34 * r, foot = 16 * r;
  g.clearRect(0, 0, w, h);
  let top = 5;
  rec.tracks.forEach(t => (t.error_cm || []).forEach(e => { if (e > top) top = e; }));
  const x = k => left + (w - left - 4) * k / Math.max(1, n - 1), y = e => (h - foot) * (1 - e / (1.05 * top));
  g.font = 11 * r + "px system-ui, sans-serif"; g.textAlign = "right"; g.lineWidth = r;
  const step = top > 40 ? 20 : top > 20 ? 10 : top > 10 ? 5 : 2;
  for (let e = 0; e <= top; e += step) {
    g.strokeStyle = "#e5e5e5"; line(g, [left, y(e)], [w, y(e)]);
    g.fillStyle = "#666"; g.fillText(e + (e ? "" : " cm"), left - 3 * r, y(e) + 4 * r);
  }
  g.textAlign = "center";
  const seconds = (n - 1) / rec.rate, every = seconds > 40 ? 10 : seconds > 12 ? 5 : 1;
  // Whole seconds of the recording's clock; none right at the left edge, where "0 cm" stands.
  for (let s = every * Math.ceil((rec.start + 0.04 * seconds) / every); s < rec.start + seconds; s += every)
    g.fillText(s + " s", x((s - rec.start) * rec.rate), h - 2 * r);
  rec.tracks.forEach(t => {
    if (!t.error_cm) return;
    g.strokeStyle = t.colour; g.lineWidth = 1.3 * r; g.beginPath();
    t.error_cm.forEach((e, k) => k ? g.lineTo(x(k), y(e)) : g.moveTo(x(k), y(e)));
    g.stroke();
  });
  g.strokeStyle = "#222"; line(g, [x(frame), 0], [x(frame), h - foot]);
  errors.seek = px => Math.round((px * r - left) / (w - left - 4) * (n - 1));
}
function go(k) { frame = Math.max(0, Math.min(rec.tracks[0].frames - 1, k)); clock = frame; draw(); }
function tick(now) {
  if (!playing) return;
  clock += (now - last) / 1000 * rec.rate * parseFloat(el("speed").value);
  last = now;
  if (clock > rec.tracks[0].frames - 1) clock = 0;
  if (Math.floor(clock) !== frame) { frame = Math.floor(clock); draw(); }
  requestAnimationFrame(tick);
}
el("play").onclick = function () {
  playing = !playing; this.textContent = playing ? "Pause" : "Play";
  if (playing) { last = performance.now(); requestAnimationFrame(tick); }
};
slider.oninput = () => go(parseInt(slider.value, 10));
el("recording").onchange = e => load(parseInt(e.target.value, 10));
errors.onclick = e => go(errors.seek(e.offsetX));
let grip = null;
bodies.onpointerdown = e => { grip = [e.clientX, e.clientY]; bodies.setPointerCapture(e.pointerId); };
bodies.onpointermove = e => {
  if (!grip) return;
  yaw += (e.clientX - grip[0]) * 0.01; tilt += (e.clientY - grip[1]) * 0.01;
  tilt = Math.max(-0.2, Math.min(1.5, tilt));
  grip = [e.clientX, e.clientY]; draw();
};
bodies.onpointerup = bodies.onpointercancel = () => { grip = null; };
window.addEventListener("resize", () => { layout(); draw(); });
load(0);
go(Math.floor(rec.tracks[0].frames / 2));
})();
"""
