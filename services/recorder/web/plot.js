// Line plots on a canvas: shared time, zoom by dragging, values under the pointer.

const INK = "#1b1b1b", SOFT = "#777", LINE = "#e3e3e3";

function sharp(canvas) {
  const ratio = window.devicePixelRatio || 1, width = canvas.clientWidth, height = canvas.clientHeight;
  canvas.width = width * ratio; canvas.height = height * ratio;
  const pen = canvas.getContext("2d");
  pen.setTransform(ratio, 0, 0, ratio, 0, 0);
  pen.clearRect(0, 0, width, height);
  pen.font = "11px system-ui, sans-serif";
  return [pen, width, height];
}

function steps(low, high, about) {
  const raw = (high - low) / about, power = 10 ** Math.floor(Math.log10(raw));
  const step = [1, 2, 5, 10].map(m => m * power).find(s => s >= raw);
  const found = [];
  for (let v = Math.ceil(low / step) * step; v <= high + step * 1e-6; v += step) found.push(Math.abs(v) < step * 1e-6 ? 0 : v);
  return [found, Math.max(0, -Math.floor(Math.log10(step)))];
}

class Plot {
  // lines: {name, color, x, y, dash, width}; options: {label, unit, xLabel, range, bands, lines at y}
  constructor(canvas, lines, options, link) {
    Object.assign(this, { canvas, lines: lines.filter(l => l.x && l.y && l.x.length), options, link, hidden: new Set() });
    this.full = options.range || this.extent();
    this.view = [...this.full];
    this.hover = null; this.drag = null;
    canvas.addEventListener("pointerdown", e => { this.drag = [this.at(e), this.at(e)]; canvas.setPointerCapture(e.pointerId); });
    canvas.addEventListener("pointermove", e => { this.hover = this.at(e); if (this.drag) this.drag[1] = this.hover; this.draw(); });
    canvas.addEventListener("pointerleave", () => { this.hover = null; this.draw(); });
    canvas.addEventListener("pointerup", e => this.drop(e));
    canvas.addEventListener("dblclick", () => this.zoom([...this.full]));
  }
  extent() {
    const all = this.lines.flatMap(l => [l.x[0], l.x[l.x.length - 1]]);
    return all.length ? [Math.min(...all), Math.max(...all)] : [0, 1];
  }
  at(event) {
    const box = this.canvas.getBoundingClientRect(), f = (event.clientX - box.left - 52) / (box.width - 62);
    return this.view[0] + Math.min(Math.max(f, 0), 1) * (this.view[1] - this.view[0]);
  }
  drop() {
    if (!this.drag) return;
    const [a, b] = this.drag.sort((p, q) => p - q), span = this.view[1] - this.view[0];
    this.drag = null;
    if (b - a > 0.01 * span) this.zoom([a, b]);
    else if (this.link && this.link.pick) this.link.pick(a);
  }
  zoom(view) {
    for (const plot of this.link ? this.link.plots : [this]) { plot.view = [...view]; plot.draw(); }
  }
  span() {
    let low = Infinity, high = -Infinity;
    const window = this.options.scaleTo && this.view[0] === this.full[0] && this.view[1] === this.full[1] ? this.options.scaleTo : this.view;
    for (const l of this.lines) for (let i = 0; i < l.x.length; i++) {
      const y = l.y[i];
      if (y === null || l.x[i] < window[0] || l.x[i] > window[1]) continue;
      if (y < low) low = y; if (y > high) high = y;
    }
    for (const y of this.options.levels || []) { low = Math.min(low, y); high = Math.max(high, y); }
    if (low > high) return [0, 1];
    const room = 0.07 * (high - low || 1);
    return [low - room, high + room];
  }
  draw() {
    const [pen, width, height] = sharp(this.canvas), box = [52, 22, width - 10, height - 24];
    if (width < 80) return;
    const [x0, x1] = this.view, [y0, y1] = this.span();
    const X = x => box[0] + (x - x0) / (x1 - x0) * (box[2] - box[0]), Y = y => box[3] - (y - y0) / (y1 - y0) * (box[3] - box[1]);
    (this.options.bands || []).forEach(([name, a, b], i) => {
      if (b < x0 || a > x1) return;
      const left = Math.max(X(a), box[0]), right = Math.min(X(b), box[2]);
      if (i % 2) { pen.fillStyle = "#f4f4f4"; pen.fillRect(left, box[1], right - left, box[3] - box[1]); }
      if (pen.measureText(name).width < right - left - 4) { pen.fillStyle = "#aaa"; pen.textAlign = "center"; pen.fillText(name, (left + right) / 2, box[3] - 5); }
    });
    pen.lineWidth = 1; pen.strokeStyle = LINE; pen.fillStyle = SOFT;
    const [ys, dy] = steps(y0, y1, 4), [xs, dx] = steps(x0, x1, 10);
    pen.textAlign = "right"; pen.textBaseline = "middle";
    for (const y of ys) { pen.beginPath(); pen.moveTo(box[0], Y(y)); pen.lineTo(box[2], Y(y)); pen.stroke(); pen.fillText(y.toFixed(dy), box[0] - 5, Y(y)); }
    pen.textAlign = "center"; pen.textBaseline = "top";
    for (const x of xs) pen.fillText(x.toFixed(dx), X(x), box[3] + 5);
    pen.textAlign = "right"; pen.fillText(this.options.xLabel || "s", box[2], box[3] + 5 + 0 * xs.length);
    pen.textBaseline = "alphabetic";
    pen.save(); pen.beginPath(); pen.rect(box[0], box[1], box[2] - box[0], box[3] - box[1]); pen.clip();
    pen.strokeStyle = "#999"; pen.setLineDash([2, 3]);
    for (const y of this.options.levels || []) { pen.beginPath(); pen.moveTo(box[0], Y(y)); pen.lineTo(box[2], Y(y)); pen.stroke(); }
    for (const l of this.lines) {
      pen.strokeStyle = l.color; pen.lineWidth = l.width || 1.3; pen.setLineDash(l.dash || []); pen.globalAlpha = l.alpha || 1;
      pen.beginPath();
      let down = false;
      for (let i = 0; i < l.x.length; i++) {
        if (l.y[i] === null) { down = false; continue; }
        if (down) pen.lineTo(X(l.x[i]), Y(l.y[i])); else pen.moveTo(X(l.x[i]), Y(l.y[i]));
        down = true;
      }
      pen.stroke();
    }
    pen.globalAlpha = 1; pen.setLineDash([]); pen.lineWidth = 1;
    if (this.link && this.link.now !== undefined) { pen.strokeStyle = INK; pen.beginPath(); pen.moveTo(X(this.link.now), box[1]); pen.lineTo(X(this.link.now), box[3]); pen.stroke(); }
    if (this.drag) { pen.fillStyle = "rgba(0,114,178,.12)"; pen.fillRect(X(this.drag[0]), box[1], X(this.drag[1]) - X(this.drag[0]), box[3] - box[1]); }
    if (this.hover !== null) { pen.strokeStyle = "#bbb"; pen.beginPath(); pen.moveTo(X(this.hover), box[1]); pen.lineTo(X(this.hover), box[3]); pen.stroke(); }
    pen.restore();
    this.legend(pen, box, dy);
  }
  legend(pen, box) {
    const x = this.hover !== null ? this.hover : undefined;
    pen.textAlign = "left"; pen.fillStyle = INK;
    let left = box[0];
    const title = this.options.label + (this.options.unit ? ` (${this.options.unit})` : "");
    pen.font = "bold 11px system-ui, sans-serif"; pen.fillText(title, left, 13); left += pen.measureText(title).width + 14;
    pen.font = "11px system-ui, sans-serif";
    if (x !== undefined) { const text = `at ${x.toFixed(2)}:`; pen.fillStyle = SOFT; pen.fillText(text, left, 13); left += pen.measureText(text).width + 8; }
    for (const l of this.lines) {
      if (!l.name) continue;
      const value = x === undefined ? null : near(l, x), text = l.name + (value === null || value === undefined ? "" : ` ${value.toFixed(2)}`);
      pen.strokeStyle = l.color; pen.lineWidth = 2; pen.setLineDash(l.dash || []);
      pen.beginPath(); pen.moveTo(left, 9); pen.lineTo(left + 14, 9); pen.stroke(); pen.setLineDash([]);
      pen.fillStyle = INK; pen.fillText(text, left + 18, 13); left += pen.measureText(text).width + 30;
    }
  }
}

function near(line, x) {
  let low = 0, high = line.x.length - 1;
  while (high - low > 1) { const middle = (low + high) >> 1; if (line.x[middle] <= x) low = middle; else high = middle; }
  return line.y[x - line.x[low] <= line.x[high] - x ? low : high];
}
