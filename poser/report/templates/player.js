(function () {
"use strict";
const data = JSON.parse(document.getElementById("player-data").textContent);
const el = id => document.getElementById("pl-" + id);
const bodies = el("bodies"), errors = el("errors"), slider = el("time");
let rec = null, frame = 0, playing = false, yaw = -0.6, tilt = 0.2, last = 0, clock = 0;
function decode(text, kind) {
  const bin = atob(text), bytes = new Uint8Array(bin.length);
  for (let i = 0; i < bin.length; i++) bytes[i] = bin.charCodeAt(i);
  return new kind(bytes.buffer);
}
const skinned = skins(data, decode);
el("look").disabled = !skinned;
if (!skinned) el("look").value = "bones";
data.recordings.forEach((r, i) => {
  const o = document.createElement("option"); o.value = i; o.textContent = r.name;
  el("recording").appendChild(o);
});
function load(i) {
  rec = data.recordings[i];
  rec.tracks.forEach(t => { if (!t.p) { t.p = decode(t.data, Int16Array); t.q = decode(t.turns, Int16Array); } });
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
  const s = cell.h / 2900;
  return [cell.x + cell.w / 2 + s * u, cell.y + cell.h * 0.88 - s * v];
}
function line(g, a, b) { g.beginPath(); g.moveTo(a[0], a[1]); g.lineTo(b[0], b[1]); g.stroke(); }
function body(g, track, cell, ghost) {
  if (el("look").value === "body")
    return skinned(g, track, Math.min(frame, track.frames - 1), cell, yaw, tilt, ghost);
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
el("look").onchange = () => draw();
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
