"use strict";
// The newest vector of each direction over the reference: a calibrated one lies on the unit sphere.

class Sphere {
  constructor(canvas) {
    Object.assign(this, { canvas, cells: new Map(), ellipsoid: null, scale: 1, yaw: 0.6, pitch: 0.4 });
    canvas.addEventListener("keydown", (event) => {
      const step = { ArrowLeft: [-0.1, 0], ArrowRight: [0.1, 0], ArrowUp: [0, 0.1], ArrowDown: [0, -0.1] }[event.key];
      if (!step) return;
      event.preventDefault();
      this.turn(...step);
    });
    canvas.addEventListener("pointerdown", (event) => canvas.setPointerCapture(event.pointerId));
    canvas.addEventListener("pointermove", (event) => {
      if (canvas.hasPointerCapture(event.pointerId)) this.turn(event.movementX * 0.01, event.movementY * 0.01);
    });
    new ResizeObserver(() => this.draw()).observe(canvas);
  }

  turn(yaw, pitch) {
    this.yaw += yaw;
    this.pitch = Math.max(-1.57, Math.min(1.57, this.pitch + pitch));
    this.draw();
  }

  show(cells, anew, ellipsoid, reference) {
    if (anew) this.cells.clear();
    for (const [cell, vectors] of Object.entries(cells)) this.cells.set(cell, vectors);
    this.ellipsoid = ellipsoid;
    if (reference) this.reference = reference;
    this.draw();
  }

  // To the screen: x to the right, y up, z towards the eye.
  seen([x, y, z]) {
    const [cy, sy, cp, sp] = [Math.cos(this.yaw), Math.sin(this.yaw), Math.cos(this.pitch), Math.sin(this.pitch)];
    const u = cy * x - sy * y, v = sy * x + cy * y;
    return [u, cp * z + sp * -v, sp * z + cp * v];
  }

  // The raw vector of a direction, by equation (5) inverted, over the reference.
  raw(u) {
    const { matrix: m, bias_nt: b } = this.ellipsoid, w = u.map((one, i) => one + b[i] / this.reference);
    return [0, 3, 6].map((row) => m[row] * w[0] + m[row + 1] * w[1] + m[row + 2] * w[2]);
  }

  draw() {
    const { canvas } = this, ratio = devicePixelRatio || 1, width = canvas.clientWidth, height = canvas.clientHeight;
    if (!width) return;
    canvas.width = width * ratio; canvas.height = height * ratio;
    const ctx = canvas.getContext("2d"), vectors = [...this.cells.values()];
    const far = Math.max(1.15, ...vectors.map((c) => (c[0] == null ? 1 : Math.hypot(c[0], c[1], c[2]))));
    const size = (Math.min(width, height) / 2 - 8) / Math.min(far, 4);
    ctx.scale(ratio, ratio); ctx.translate(width / 2, height / 2);
    const at = (point) => { const [x, y, z] = this.seen(point); return [x * size, -y * size, z]; };
    this.circles(ctx, at, (u) => u, colour("soft"));
    if (this.ellipsoid && this.reference) this.circles(ctx, at, (u) => this.raw(u), colour("before"));
    for (const c of vectors) {
      if (c[0] != null) this.dot(ctx, at(c.slice(0, 3)), colour("before"), true);
      if (c[3] != null) this.dot(ctx, at(c.slice(3)), colour("after"), false);
    }
    ctx.fillStyle = colour("ink"); ctx.font = "12px sans-serif"; ctx.globalAlpha = 1;
    [["x", [1.1, 0, 0]], ["y", [0, 1.1, 0]], ["z", [0, 0, 1.1]]].forEach(([name, end]) => ctx.fillText(name, ...at(end).slice(0, 2)));
  }

  circles(ctx, at, bend, stroke) {
    ctx.strokeStyle = stroke; ctx.globalAlpha = 0.7; ctx.lineWidth = 1;
    for (let axis = 0; axis < 3; axis++) {
      ctx.beginPath();
      for (let i = 0; i <= 60; i++) {
        const a = (i * Math.PI) / 30, u = [0, 0, 0];
        u[(axis + 1) % 3] = Math.cos(a); u[(axis + 2) % 3] = Math.sin(a);
        const [x, y] = at(bend(u));
        ctx.lineTo(x, y);
      }
      ctx.stroke();
    }
  }

  // Raw as squares, calibrated as discs: the shapes tell them apart without colour. What lies behind is faint.
  dot(ctx, [x, y, z], fill, square) {
    ctx.fillStyle = fill; ctx.globalAlpha = z < 0 ? 0.3 : 0.9;
    ctx.beginPath();
    if (square) ctx.rect(x - 2, y - 2, 4, 4); else ctx.arc(x, y, 2.5, 0, 7);
    ctx.fill();
  }
}
