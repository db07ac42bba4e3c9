// The report: what REPORT holds of each session, laid over each other in the sessions' colours.

const COLORS = ["#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000", "#8c8c8c"];
const AXES = [["x", "#D55E00"], ["y", "#009E73"], ["z", "#0072B2"]];
const S = REPORT.sessions, ONE = S.length === 1, $ = id => document.getElementById(id);
const link = { plots: [], now: 0, pick: t => move(t) };

function element(parent, tag, text, name) {
  const made = document.createElement(tag);
  if (text !== undefined) made.textContent = text;
  if (name) made.className = name;
  parent.append(made);
  return made;
}
function index(t, now) {
  let low = 0, high = t.length - 1;
  while (high - low > 1) { const middle = (low + high) >> 1; if (t[middle] <= now) low = middle; else high = middle; }
  return low;
}
const walk = S.flatMap(s => s.phases.filter(p => p[0] === "guiding"));
const range = [Math.min(...S.map(s => s.curves.t[0] ?? 0)), Math.max(...S.map(s => s.curves.t.at(-1) ?? 1))];
const guided = walk.length ? [Math.min(...walk.map(p => p[1])), Math.max(...walk.map(p => p[2]))] : range;

// Who was recorded.
S.forEach((s, i) => {
  const box = element($("sessions"), "div", undefined, "session");
  box.style.borderColor = COLORS[i % 8];
  element(box, "b", s.name + " ");
  element(box, "span", s.ok ? "as it should be" : "not as it should be", s.ok ? "good" : "bad");
  const list = s.reasons.length ? element(box, "ul") : null;
  s.reasons.forEach(reason => element(list, "li", reason));
  const origin = Object.entries(s.origin).filter(([, value]) => value).map(([key, value]) => `${key} ${value}`).join(" · ");
  element(element(box, "div"), "small", origin + (s.fromTruth ? " · positions and forces are the simulator's truth" : " · positions and forces are the sensors'"));
});

// The walk, from above and along the path from the side.
class Scene {
  constructor(canvas, axes, labels) {
    Object.assign(this, { canvas, axes, labels });
    const points = S.flatMap(s => s.path.points.concat(slice(s, "p_H"), slice(s, "p_R")));
    const of = k => points.map(p => p[axes[k]]).filter(Number.isFinite);
    this.box = points.length ? [Math.min(...of(0)) - .35, Math.max(...of(0)) + .35, Math.min(...of(1)) - .35, Math.max(...of(1)) + .35] : [-1, 1, -1, 1];
    if (axes[1] === 2) this.box[2] = 0;
  }
  draw(now) {
    const [pen, width, height] = sharp(this.canvas), [a, b, c, d] = this.box;
    const scale = Math.min((width - 40) / (b - a), (height - 34) / (d - c));
    const ox = 32 + (width - 40 - scale * (b - a)) / 2, oy = height - 24 - (height - 34 - scale * (d - c)) / 2;
    const P = p => [ox + (p[this.axes[0]] - a) * scale, oy - (p[this.axes[1]] - c) * scale];
    this.grid(pen, P, scale);
    S.forEach((s, i) => this.session(pen, P, scale, s, ONE ? null : COLORS[i % 8], now));
  }
  grid(pen, P, scale) {
    const [a, b, c, d] = this.box, at = (u, v) => { const p = [0, 0, 0]; p[this.axes[0]] = u; p[this.axes[1]] = v; return P(p); };
    pen.strokeStyle = LINE; pen.fillStyle = SOFT; pen.lineWidth = 1;
    for (const u of steps(a, b, 6)[0]) { line(pen, [at(u, c), at(u, d)]); pen.textAlign = "center"; pen.fillText(u, at(u, c)[0], at(u, c)[1] + 14); }
    for (const v of steps(c, d, 5)[0]) { line(pen, [at(a, v), at(b, v)]); pen.textAlign = "right"; pen.fillText(v, at(a, v)[0] - 4, at(a, v)[1] + 4); }
    pen.textAlign = "left"; pen.fillStyle = INK; pen.fillText(this.labels, 6, 14);
  }
  session(pen, P, scale, s, color, now) {
    const c = s.curves, above = this.axes[1] === 1;
    pen.setLineDash([6, 4]); pen.strokeStyle = "#333"; pen.lineWidth = 1; line(pen, s.path.points.map(P)); pen.setLineDash([]);
    if (above) for (const [x, y, r] of s.path.posts) { const [u, v] = P([x, y, 0]); pen.fillStyle = "#d9d9d9"; disc(pen, u, v, r * scale); }
    pen.lineWidth = 1.6; pen.strokeStyle = color || "#009E73"; line(pen, slice(s, "p_H").map(P));
    pen.globalAlpha = .4; pen.lineWidth = 1; pen.strokeStyle = color || "#0072B2"; line(pen, slice(s, "p_R").map(P)); pen.globalAlpha = 1;
    if (!c.t.length) return;
    const i = index(c.t, now), hand = P(c.p_H[i]), robot = P(c.p_R[i]), pull = Math.hypot(...c.f_c[i]);
    pen.strokeStyle = tension(pull); pen.lineWidth = pull > .01 ? 2.5 : 1; pen.setLineDash(pull > .01 ? [] : [2, 3]); line(pen, [hand, robot]); pen.setLineDash([]);
    arrow(pen, hand, P(c.p_H[i].map((x, k) => x + .3 * c.f_c[i][k])), "#D55E00");
    if (c.u_A && c.u_A[i]) arrow(pen, robot, P(c.p_R[i].map((x, k) => x + .3 * c.u_A[i][k])), "#8c8c8c");
    if (c.head && c.head[i]) { pen.strokeStyle = SOFT; pen.lineWidth = 1; circle(pen, ...P(c.head[i]), .1 * scale); }
    pen.fillStyle = color || "#009E73"; disc(pen, ...hand, 5); pen.strokeStyle = INK; if (!c.held[i]) circle(pen, ...hand, 8);
    pen.fillStyle = color || "#0072B2"; pen.strokeStyle = color || "#0072B2"; pen.lineWidth = 2;
    const arm = .14 * scale;
    if (above) for (const [u, v] of [[1, 1], [1, -1], [-1, 1], [-1, -1]]) { line(pen, [robot, [robot[0] + u * arm, robot[1] + v * arm]]); circle(pen, robot[0] + u * arm, robot[1] + v * arm, .09 * scale); }
    else { line(pen, [[robot[0] - arm, robot[1]], [robot[0] + arm, robot[1]]]); for (const u of [-1, 1]) line(pen, [[robot[0] + u * arm - .09 * scale, robot[1] - 4], [robot[0] + u * arm + .09 * scale, robot[1] - 4]]); }
  }
}
function slice(s, name) {
  const c = s.curves, span = s.phases.filter(p => p[0] === "guiding");
  return (c[name] || []).filter((_, i) => !span.length || span.some(([, a, b]) => c.t[i] >= a && c.t[i] < b));
}
function line(pen, points) { pen.beginPath(); points.forEach(([x, y], i) => i ? pen.lineTo(x, y) : pen.moveTo(x, y)); pen.stroke(); }
function circle(pen, x, y, r) { pen.beginPath(); pen.arc(x, y, r, 0, 7); pen.stroke(); }
function disc(pen, x, y, r) { pen.beginPath(); pen.arc(x, y, r, 0, 7); pen.fill(); }
function tension(pull) { const f = Math.min(pull / 2.5, 1); return `rgb(${Math.round(60 + 180 * f)},${Math.round(130 - 70 * f)},${Math.round(200 - 160 * f)})`; }
function arrow(pen, from, to, color) {
  const long = Math.hypot(to[0] - from[0], to[1] - from[1]);
  if (long < 4) return;
  const a = Math.atan2(to[1] - from[1], to[0] - from[0]);
  pen.strokeStyle = pen.fillStyle = color; pen.lineWidth = 1.6; line(pen, [from, to]);
  pen.beginPath(); pen.moveTo(...to); for (const w of [2.7, -2.7]) pen.lineTo(to[0] + 8 * Math.cos(a + w), to[1] + 8 * Math.sin(a + w)); pen.fill();
}
const scenes = [new Scene($("above"), [0, 1], "from above: x, y (m)"), new Scene($("aside"), [0, 2], "from the side: x, z (m)")];

// Numbers.
{
  const head = element(element($("numbers"), "thead"), "tr");
  ["", ...S.map(s => s.name), "at most", "definition"].forEach((text, i) => element(head, "th", text, i && i <= S.length + 1 ? "n" : ""));
  const body = element($("numbers"), "tbody");
  for (const n of REPORT.numbers) {
    const row = element(body, "tr"), limit = S[0].limits[n.key];
    element(row, "td", n.name);
    for (const s of S) {
      const value = s.numbers[n.key], bad = s.limits[n.key] !== undefined && !(value <= s.limits[n.key]);
      element(row, "td", value === null ? "unknown" : `${Number(value.toPrecision(4))} ${n.unit}`, bad ? "n bad" : "n");
    }
    element(row, "td", limit === undefined ? "" : `${Number(limit.toPrecision(4))} ${n.unit}`, "n");
    element(row, "td", n.definition, "def");
  }
}

// Along the path: every run, and mean and standard deviation over the runs (E8).
{
  const runs = S.filter(s => s.errorOfS.length), stations = runs.length ? runs[0].errorOfS.map((_, i) => i / (runs[0].errorOfS.length - 1)) : [];
  const lines = runs.map(s => ({ name: s.name, color: COLORS[S.indexOf(s) % 8], x: stations, y: s.errorOfS }));
  if (runs.length > 1) {
    const stat = stations.map((_, i) => { const v = runs.map(s => s.errorOfS[i]).filter(e => e !== null), m = v.reduce((a, b) => a + b, 0) / v.length; return [v.length ? m : null, v.length > 1 ? Math.sqrt(v.reduce((a, b) => a + (b - m) ** 2, 0) / (v.length - 1)) : null]; });
    lines.push({ name: "mean", color: INK, width: 2.5, x: stations, y: stat.map(([m]) => m) });
    for (const sign of [-1, 1]) lines.push({ name: sign > 0 ? "± standard deviation" : "", color: INK, dash: [4, 3], width: 1, x: stations, y: stat.map(([m, d]) => d === null ? null : m + sign * d) });
  }
  new Plot($("error"), lines, { label: "e_H(s), left of the path positive", unit: "cm", xLabel: "s", range: [0, 1], levels: [-5, 0, 5] }).draw();
}

// Over time.
function plot(label, unit, make, options = {}) {
  const lines = S.flatMap((s, i) => s.curves.t.length ? make(s.curves, ONE ? null : COLORS[i % 8], s) : []).filter(l => l.y);
  const made = new Plot(element($("plots"), "canvas", undefined, "plot"), lines, { label, unit, range, scaleTo: guided, bands: S[0].phases, ...options }, link);
  link.plots.push(made);
}
const part = (values, k) => values && values.map(v => v === null ? null : v[k]);
const size = values => values && values.map(v => v === null ? null : Math.hypot(...v));
const vector = name => (c, color, s) => AXES.map(([axis, own], k) => ({ name: ONE ? axis : axis === "x" ? s.name : "", color: color || own, dash: ONE ? [] : [[], [5, 3], [1, 3]][k], x: c.t, y: part(c[name], k) }));
const wanted = (name, label) => c => ONE ? AXES.map(([, own], k) => ({ name: k ? "" : label, color: own, dash: [4, 3], width: 1, x: c.t, y: part(c[name], k) })) : [];
plot("hand's distance from the path", "cm", (c, color, s) => [{ name: ONE ? "‖e_H‖" : s.name, color: color || INK, x: c.t, y: c.e_H }], { levels: [5] });
plot("hand p_H", "m", (c, color, s) => [...vector("p_H")(c, color, s), ...wanted("p_H_d", "desired")(c)]);
plot("robot p_R", "m", (c, color, s) => [...vector("p_R")(c, color, s), ...wanted("sent", "set-point")(c)]);
plot("cable force f_c", "N", (c, color, s) => [...vector("f_hat")(c, color, s), ...wanted("f_d", "desired")(c)]);
plot("force on the hand", "N", (c, color, s) => [{ name: ONE ? "‖f‖" : s.name, color: color || INK, x: c.t, y: size(c.f_hand) }], { levels: [2.5] });
plot("energy of the filter", "J", (c, color, s) => [["stored", "by the virtual mass", "#0072B2"], ["guidance", "paid for guidance", "#E69F00"], ["dissipated", "dissipated", "#D55E00"], ["tank", "left in the tank", "#009E73"]].map(([key, name, own], k) => ({ name: ONE ? name : k ? "" : s.name, color: color || own, dash: ONE ? [] : [[], [5, 3], [1, 3], [8, 2]][k], x: c.t, y: c[key] })));
plot("progress s", "", (c, color, s) => [{ name: ONE ? "s" : s.name, color: color || INK, x: c.t, y: c.s }]);

// From the hand to the set-point: medians end to end, and where the 99 % are.
S.forEach(s => {
  const stages = Object.entries(s.latency).filter(([name]) => name !== "total"), total = s.latency.total;
  if (!total) { element($("latency"), "p", `${s.name}: unknown`, "hint"); return; }
  if (!ONE) element($("latency"), "b", s.name);
  const table = element($("latency"), "table"), head = element(element(table, "thead"), "tr");
  ["stage", "median", "90 %", "99 %", "largest", ""].forEach((text, i) => element(head, "th", text, i && i < 5 ? "n" : ""));
  const body = element(table, "tbody");
  let before = 0;
  for (const [name, l] of [...stages, ["total", total]]) {
    const row = element(body, "tr");
    element(row, "td", name);
    for (const key of ["p50", "p90", "p99", "max"]) element(row, "td", `${l[key].toFixed(1)} ms`, "n");
    const cell = element(row, "td"), top = total.p99 * 1.05, start = name === "total" ? 0 : before;
    cell.style.width = "45%";
    cell.innerHTML = `<svg width="100%" height="16" viewBox="0 0 100 16" preserveAspectRatio="none"><rect x="${100 * start / top}" y="3" width="${100 * l.p50 / top}" height="10" fill="#0072B2"/><rect x="${100 * (start + l.p50) / top}" y="6" width="${100 * (l.p99 - l.p50) / top}" height="4" fill="#0072B2" opacity=".35"/></svg>`;
    before += l.p50;
  }
});

// Health: a strip for each service, darker where its loop was later, red where periods were missed.
S.forEach(s => {
  if (!ONE) element($("health"), "b", s.name);
  const table = element($("health"), "table");
  for (const [service, h] of Object.entries(s.health)) {
    const row = element(table, "tr");
    element(row, "td", service).style.width = "13em";
    const cell = element(row, "td");
    if (!h.t.length) { element(cell, "span", "silent", "hint"); continue; }
    const width = range[1] - range[0], late = Math.max(...h.late), cpu = h.cpu.reduce((a, b) => a + b, 0) / h.cpu.length;
    const bars = h.t.map((t, i) => `<rect x="${100 * (t - .5 - range[0]) / width}" y="0" width="${52 / width}" height="14" fill="${h.missed[i] ? "#b3261e" : "#009E73"}" opacity="${h.missed[i] ? Math.min(.4 + h.missed[i] / 20, 1) : .15 + .85 * Math.min(h.late[i] / 10, 1)}"><title>${t.toFixed(1)} s: ${h.late[i]} ms late, ${h.missed[i]} missed, ${h.cpu[i]} % of a core</title></rect>`);
    cell.innerHTML = `<svg width="100%" height="14" viewBox="0 0 100 14" preserveAspectRatio="none">${bars.join("")}</svg>`;
    const missed = h.missed.reduce((a, b) => a + b, 0), refused = h.rejected.at(-1) || 0;
    element(row, "td", `${late.toFixed(1)} ms late at most (99 %), ${missed} missed, ${cpu.toFixed(0)} % of a core${refused ? `, ${refused} refused` : ""}`, "def").style.width = "27em";
  }
});

// Alarms and notes.
S.forEach(s => {
  if (!ONE) element($("alarms"), "b", s.name);
  const said = [...s.alarms.map(a => [a.from, `${a.from.toFixed(1)} to ${a.to.toFixed(1)} s, ${a.phase}`, a.level, a.text]), ...s.notes.map(n => [n.t, `${n.t.toFixed(1)} s`, "note", `${n.text} (${n.operator})`])];
  if (!said.length) { element($("alarms"), "p", "none", "hint"); return; }
  const table = element($("alarms"), "table");
  said.sort((a, b) => a[0] - b[0]).forEach(([t, when, level, text]) => {
    const row = element(table, "tr");
    element(row, "td", when).style.whiteSpace = "nowrap";
    element(row, "td", level, level === "note" || level === "warn" ? "" : "bad");
    element(row, "td", text);
    row.onclick = () => move(t);
  });
});

// The slider moves everything.
function move(t) {
  link.now = Math.min(Math.max(t, range[0]), range[1]);
  $("time").value = link.now;
  const s = S[0], c = s.curves, i = c.t.length ? index(c.t, link.now) : -1;
  const phase = s.phases.find(([, a, b]) => link.now >= a && link.now < b);
  $("now").textContent = `${link.now.toFixed(1)} s  ${phase ? phase[0] : ""}` + (i >= 0 && c.s && c.s[i] !== null ? `  s = ${c.s[i].toFixed(2)}` : "") + (i >= 0 ? `  ${Math.hypot(...c.f_c[i]).toFixed(2)} N` : "");
  scenes.forEach(scene => scene.draw(link.now));
  link.plots.forEach(p => p.draw());
}
const slider = $("time");
[slider.min, slider.max] = range;
slider.oninput = () => move(Number(slider.value));
let playing = null;
$("play").onclick = () => {
  if (playing) { cancelAnimationFrame(playing); playing = null; $("play").textContent = "▶"; return; }
  $("play").textContent = "⏸";
  let last = null;
  const step = at => {
    if (last !== null) move(link.now + 2 * (at - last) / 1000);
    last = at;
    playing = link.now < range[1] ? requestAnimationFrame(step) : null;
    if (!playing) $("play").textContent = "▶";
  };
  if (link.now >= range[1]) move(range[0]);
  playing = requestAnimationFrame(step);
};
window.addEventListener("resize", () => move(link.now));
move(guided[0] + 0.45 * (guided[1] - guided[0]));
document.body.dataset.ready = "yes";
