"use strict";
// Plots over time and over frequency, by uPlot; colours come from the style, so dark and light follow the system.

const colour = (name) => getComputedStyle(document.documentElement).getPropertyValue("--" + name).trim();

function clock(seconds) {
  const sign = seconds < 0 ? "-" : "", s = Math.abs(Math.round(seconds)), two = (n) => String(n).padStart(2, "0");
  return `${sign}${Math.floor(s / 3600)}:${two(Math.floor(s / 60) % 60)}:${two(s % 60)}`;
}

const number = (value, digits) => (value == null || !isFinite(value) ? "-" : value.toFixed(digits));

const HEIGHT = 200;

class Plot {
  // place: element; lines: [{label, stroke, dash, width}]; x: how a value of the axis is written; marks: () => [[x, name]].
  constructor(place, lines, x, unit, marks = () => []) {
    Object.assign(this, { place, lines, x, unit, marks, data: [[], ...lines.map(() => [])], plot: null });
    new ResizeObserver(() => this.fit()).observe(place);
    place.addEventListener("keydown", (event) => this.key(event));
    this.build();
  }

  build() {
    if (this.plot) this.plot.destroy();
    const axis = { stroke: colour("soft"), grid: { stroke: colour("line"), width: 1 }, ticks: { stroke: colour("line") } };
    this.plot = new uPlot({
      width: Math.max(this.place.clientWidth, 100), height: HEIGHT,
      scales: { x: { time: false } },
      cursor: { drag: { x: true, y: false } },
      legend: { live: true },
      axes: [
        { ...axis, values: (_, values) => values.map(this.x), space: 70 },
        { ...axis, size: 62, label: this.unit, labelSize: 16, values: (_, values) => values.map((v) => v.toLocaleString("en")) },
      ],
      series: [
        { label: "at", value: (_, v) => (v == null ? "-" : this.x(v)) },
        ...this.lines.map((line) => ({
          label: line.label, stroke: () => colour(line.colour), width: line.width || 1.2, dash: line.dash, spanGaps: false,
          points: { show: false }, value: (_, v) => number(v, line.digits || 0),
        })),
      ],
      hooks: { draw: [(plot) => this.drawMarks(plot)] },
    }, this.data, this.place);
  }

  drawMarks(plot) {
    const { ctx, bbox } = plot;
    ctx.save();
    ctx.strokeStyle = ctx.fillStyle = colour("soft");
    ctx.setLineDash([4, 4]);
    ctx.textAlign = "left";
    ctx.font = `${11 * devicePixelRatio}px sans-serif`;
    this.marks().forEach(([at, name], i) => {
      const x = plot.valToPos(at, "x", true);
      if (x < bbox.left || x > bbox.left + bbox.width) return;
      ctx.beginPath(); ctx.moveTo(x, bbox.top); ctx.lineTo(x, bbox.top + bbox.height); ctx.stroke();
      ctx.fillText(name, x + 4, bbox.top + (12 + 13 * i) * devicePixelRatio);
    });
    ctx.restore();
  }

  fit() {
    const width = this.place.clientWidth;
    if (width > 0 && this.plot && width !== this.plot.width) this.plot.setSize({ width, height: HEIGHT });
  }

  // What a reader has zoomed to stays while data come, until it lies outside of them.
  show(data) {
    const zoom = this.zoom(), x = data[0];
    const stays = zoom && x.length > 1 && zoom.max > x[0] && zoom.min < x[x.length - 1];
    this.data = data;
    this.plot.setData(data, !stays);
    if (stays) this.plot.setScale("x", zoom);
  }

  // The part of the axis that is in sight, null where it is all of it.
  zoom() {
    const { min, max } = this.plot.scales.x, x = this.data[0];
    return x.length > 1 && (min > x[0] || max < x[x.length - 1]) ? { min, max } : null;
  }

  // Arrows move the cursor from sample to sample, + and - zoom at the cursor, 0 shows all.
  key(event) {
    const { plot } = this, x = this.data[0], last = x.length - 1;
    const step = { ArrowLeft: -1, ArrowRight: 1 }[event.key] * (event.shiftKey ? 10 : 1), factor = { "+": 0.5, "=": 0.5, "-": 2 }[event.key];
    if (last < 1 || event.ctrlKey || event.metaKey || event.altKey || !(step || factor || event.key === "0")) return;
    event.preventDefault();
    const { min, max } = plot.scales.x;
    if (event.key === "0") plot.setScale("x", { min: x[0], max: x[last] });
    else if (step) {
      const i = Math.min(Math.max((plot.cursor.idx == null ? last : plot.cursor.idx) + step, 0), last);
      plot.setCursor({ left: plot.valToPos(x[i], "x"), top: 0 });
    } else {
      const middle = plot.cursor.idx == null ? (min + max) / 2 : x[plot.cursor.idx], half = (factor * (max - min)) / 2;
      const from = Math.max(middle - half, x[0]), to = Math.min(middle + half, x[last]);
      if (to - from > (x[last] - x[0]) / x.length) plot.setScale("x", { min: from, max: to });
    }
  }
}
