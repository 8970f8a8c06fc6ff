"use strict";
/* The object view: orthographic depth buffers from the camera and from the Sun, then arrows to Sun and observer.
   Body frame; a part that tracks the Sun is turned about its pivot by the row's pose. */
(function () {
  const source = document.getElementById("object-data");
  if (!source) return;
  const data = JSON.parse(source.textContent);
  const canvas = document.getElementById("object-canvas");
  const strip = document.getElementById("object-strip");
  const slider = document.getElementById("object-time");
  const text = document.getElementById("object-text");
  const play = document.getElementById("object-play");
  const SHADOW = 512, AMBIENT = 0.42, EDGE = 1e-6;

  const count = data.parts.reduce((sum, part) => sum + part.triangles.length, 0);
  const corners = new Float32Array(9 * count), normals = new Float32Array(3 * count), colours = new Float32Array(3 * count);
  data.parts.forEach(part => {
    part.rgb = [1, 3, 5].map(i => parseInt(part.colour.slice(i, i + 2), 16) / 255);
  });

  let row = data.start, camera = data.camera, follow = null, timer = null, scale = 0;

  function place() {
    let k = 0;
    data.parts.forEach(part => {
      const m = part.poses ? part.poses[row] : null, p = part.pivot;
      part.triangles.forEach(triangle => {
        for (let c = 0; c < 3; c++) {
          let v = triangle[c];
          if (m) {
            const x = v[0] - p[0], y = v[1] - p[1], z = v[2] - p[2];
            v = [0, 1, 2].map(i => p[i] + m[3 * i] * x + m[3 * i + 1] * y + m[3 * i + 2] * z);
          }
          for (let i = 0; i < 3; i++) corners[9 * k + 3 * c + i] = v[i] - data.middle[i];
        }
        const a = [0, 1, 2].map(i => corners[9 * k + 3 + i] - corners[9 * k + i]);
        const b = [0, 1, 2].map(i => corners[9 * k + 6 + i] - corners[9 * k + i]);
        const n = unit(cross(a, b));
        for (let i = 0; i < 3; i++) { normals[3 * k + i] = n[i]; colours[3 * k + i] = part.rgb[i]; }
        k++;
      });
    });
  }

  const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
  const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
  const unit = a => { const n = Math.hypot(a[0], a[1], a[2]) || 1; return [a[0] / n, a[1] / n, a[2] / n]; };

  function lookingAlong(direction, up) {
    const towards = unit(direction);
    let right = cross(up, towards);
    if (Math.hypot(...right) < 1e-6) right = cross([towards[1], towards[2], towards[0]], towards);
    right = unit(right);
    return [right, cross(towards, right), towards];
  }

  /* Depth towards the viewer and the nearest triangle of each cell, for triangles that face the frame's third row. */
  function nearest(frame, width, height, scale, flip) {
    const depth = new Float32Array(width * height).fill(-Infinity), index = new Int32Array(width * height).fill(-1);
    const q = new Float64Array(9);
    for (let k = 0; k < count; k++) {
      const n = frame[2][0] * normals[3 * k] + frame[2][1] * normals[3 * k + 1] + frame[2][2] * normals[3 * k + 2];
      if (n <= EDGE) continue;
      let x0 = Infinity, x1 = -Infinity, y0 = Infinity, y1 = -Infinity;
      for (let c = 0; c < 3; c++) {
        const o = 9 * k + 3 * c;
        for (let i = 0; i < 3; i++)
          q[3 * c + i] = frame[i][0] * corners[o] + frame[i][1] * corners[o + 1] + frame[i][2] * corners[o + 2];
        q[3 * c] = q[3 * c] * scale + width / 2;
        q[3 * c + 1] = q[3 * c + 1] * scale * flip + height / 2;
        x0 = Math.min(x0, q[3 * c]); x1 = Math.max(x1, q[3 * c]);
        y0 = Math.min(y0, q[3 * c + 1]); y1 = Math.max(y1, q[3 * c + 1]);
      }
      const area = (q[3] - q[0]) * (q[7] - q[1]) - (q[6] - q[0]) * (q[4] - q[1]);
      if (Math.abs(area) < 1e-9) continue;
      const xa = Math.max(0, Math.floor(x0)), xb = Math.min(width, Math.ceil(x1));
      const ya = Math.max(0, Math.floor(y0)), yb = Math.min(height, Math.ceil(y1));
      for (let j = ya; j < yb; j++) {
        const y = j + 0.5;
        for (let i = xa; i < xb; i++) {
          const x = i + 0.5;
          const u = ((q[3] - x) * (q[7] - y) - (q[6] - x) * (q[4] - y)) / area;
          const v = ((q[6] - x) * (q[1] - y) - (q[0] - x) * (q[7] - y)) / area;
          const w = 1 - u - v;
          if (u < -EDGE || v < -EDGE || w < -EDGE) continue;
          const z = u * q[2] + v * q[5] + w * q[8], o = j * width + i;
          if (z > depth[o]) { depth[o] = z; index[o] = k; }
        }
      }
    }
    return { depth, index };
  }

  const layer = document.createElement("canvas");

  function paintObject(width, height, scale) {
    const sun = data.sun[row], frame = lookingAlong(sun, camera[1]);
    const cells = SHADOW / (2.02 * data.radius);
    const fromSun = nearest(frame, SHADOW, SHADOW, cells, 1), seen = nearest(camera, width, height, scale, -1);
    layer.width = width;
    layer.height = height;
    const context = layer.getContext("2d"), image = context.createImageData(width, height);
    for (let j = 0; j < height; j++) for (let i = 0; i < width; i++) {
      const o = j * width + i, k = seen.index[o];
      if (k < 0) continue;
      const n = [normals[3 * k], normals[3 * k + 1], normals[3 * k + 2]];
      const x = (i + 0.5 - width / 2) / scale, y = -(j + 0.5 - height / 2) / scale, z = seen.depth[o];
      const world = [0, 1, 2].map(a => x * camera[0][a] + y * camera[1][a] + z * camera[2][a]);
      const cosine = dot(n, sun);
      let lit = 0;
      if (cosine > 0) {
        const a = Math.min(SHADOW - 1, Math.max(0, Math.floor(dot(frame[0], world) * cells + SHADOW / 2)));
        const b = Math.min(SHADOW - 1, Math.max(0, Math.floor(dot(frame[1], world) * cells + SHADOW / 2)));
        const bias = 3 / cells * (1 + Math.sqrt(Math.max(0, 1 - cosine * cosine)) / Math.max(cosine, 0.05));
        if (fromSun.depth[b * SHADOW + a] <= dot(frame[2], world) + bias) lit = cosine;
      }
      const shade = AMBIENT * (0.6 + 0.4 * dot(n, camera[2])) + (1 - AMBIENT) * lit;
      for (let c = 0; c < 3; c++) image.data[4 * o + c] = Math.min(255, 255 * colours[3 * k + c] * shade);
      image.data[4 * o + 3] = 255;
    }
    context.putImageData(image, 0, 0);
  }

  const colour = name => getComputedStyle(document.documentElement).getPropertyValue(name).trim();

  function arrow(context, centre, reach, direction, name, ink) {
    const x = dot(camera[0], direction), y = -dot(camera[1], direction), length = Math.hypot(x, y);
    const tip = [centre[0] + reach * x, centre[1] + reach * y];
    context.strokeStyle = context.fillStyle = ink;
    context.lineWidth = 2.5;
    context.beginPath();
    context.moveTo(centre[0] + 0.25 * reach * x, centre[1] + 0.25 * reach * y);
    context.lineTo(tip[0], tip[1]);
    context.stroke();
    if (length > 0.05) {
      const a = Math.atan2(y, x);
      context.beginPath();
      context.moveTo(tip[0] + 9 * Math.cos(a), tip[1] + 9 * Math.sin(a));
      context.lineTo(tip[0] + 6 * Math.cos(a + 2.3), tip[1] + 6 * Math.sin(a + 2.3));
      context.lineTo(tip[0] + 6 * Math.cos(a - 2.3), tip[1] + 6 * Math.sin(a - 2.3));
      context.fill();
    } else {
      context.beginPath();
      context.arc(tip[0], tip[1], 5, 0, 7);
      context.fill();
    }
    return [tip[0] + 22 * x / (length || 1), tip[1] + 22 * y / (length || 1) - (length > 0.05 ? 0 : 18), name, ink];
  }

  /* Names beyond the tips of their arrows; the lower one makes room where they would overlap. */
  function names(context, labels) {
    const [low, high] = [...labels].sort((a, b) => b[1] - a[1]);
    if (Math.abs(low[0] - high[0]) < 80 && low[1] - high[1] < 18) low[1] = high[1] + 18;
    context.font = "14px system-ui, sans-serif";
    context.textAlign = "center";
    context.textBaseline = "middle";
    labels.forEach(([x, y, name, ink]) => { context.fillStyle = ink; context.fillText(name, x, y); });
  }

  function draw() {
    if (follow) camera = lookingAlong(data[follow][row], camera[1]);
    const ratio = Math.max(1, window.devicePixelRatio || 1);
    const width = canvas.clientWidth || 640, height = canvas.clientHeight || 400;
    canvas.width = Math.round(width * ratio);
    canvas.height = Math.round(height * ratio);
    const context = canvas.getContext("2d"), fine = Math.min(Math.max(2, ratio), 1400 / width);
    place();
    if (!scale) fit(width, height);
    paintObject(Math.round(width * fine), Math.round(height * fine), scale * fine);
    context.setTransform(ratio, 0, 0, ratio, 0, 0);
    context.clearRect(0, 0, width, height);
    const centre = [width / 2, height / 2], reach = 0.42 * height;
    const arrows = [[data.sun[row], "Sun", colour("--sun")], [data.observer[row], "observer", colour("--observer")]];
    const behind = one => dot(camera[2], one[0]) < 0;
    const labels = arrows.filter(behind).map(one => arrow(context, centre, reach, ...one));
    context.imageSmoothingQuality = "high";
    context.drawImage(layer, 0, 0, width, height);
    labels.push(...arrows.filter(one => !behind(one)).map(one => arrow(context, centre, reach, ...one)));
    names(context, labels);
    triad(context, height);
    drawStrip();
    say();
  }

  /* Pixels per metre at which the object, seen as now, fills the picture with room for the arrows. */
  function fit(width, height) {
    const extent = [0, 0];
    for (let o = 0; o < corners.length; o += 3) for (let i = 0; i < 2; i++) {
      const a = camera[i][0] * corners[o] + camera[i][1] * corners[o + 1] + camera[i][2] * corners[o + 2];
      extent[i] = Math.max(extent[i], 2 * Math.abs(a));
    }
    scale = Math.min(0.82 * width / extent[0], 0.66 * height / extent[1]);
  }

  function triad(context, height) {
    context.strokeStyle = context.fillStyle = colour("--ink");
    context.lineWidth = 1.2;
    context.font = "12px system-ui, sans-serif";
    context.textAlign = "center";
    context.textBaseline = "middle";
    "XYZ".split("").forEach((name, i) => {
      const x = 36 + 22 * camera[0][i], y = height - 36 - 22 * camera[1][i];
      context.beginPath();
      context.moveTo(36, height - 36);
      context.lineTo(x, y);
      context.stroke();
      context.fillText(name, 36 + 30 * camera[0][i], height - 36 - 30 * camera[1][i]);
    });
  }

  function drawStrip() {
    const ratio = window.devicePixelRatio || 1, width = strip.clientWidth || 480, height = strip.clientHeight || 70;
    strip.width = Math.round(width * ratio);
    strip.height = Math.round(height * ratio);
    const context = strip.getContext("2d");
    context.setTransform(ratio, 0, 0, ratio, 0, 0);
    const values = [...data.light.model, ...data.light.observed].filter(v => v !== null);
    const low = Math.min(...values), high = Math.max(...values), last = data.hours.length - 1;
    const x = i => 8 + (width - 16) * (last ? i / last : 0.5);
    const up = data.kind === "mag" ? v => (v - low) : v => (high - v);
    const y = v => 6 + (height - 12) * up(v) / ((high - low) || 1);
    context.fillStyle = colour("--muted");
    data.light.observed.forEach((v, i) => { if (v !== null) context.fillRect(x(i) - 1, y(v) - 1, 2, 2); });
    context.strokeStyle = colour("--model");
    context.lineWidth = 1.5;
    context.beginPath();
    let broken = true;
    data.light.model.forEach((v, i) => {
      if (v === null) { broken = true; return; }
      if (broken) context.moveTo(x(i), y(v)); else context.lineTo(x(i), y(v));
      broken = false;
    });
    context.stroke();
    context.strokeStyle = colour("--ink");
    context.lineWidth = 1;
    context.beginPath();
    context.moveTo(x(row), 0);
    context.lineTo(x(row), height);
    context.stroke();
  }

  function say() {
    const model = data.light.model[row], observed = data.light.observed[row];
    const told = v => v === null ? "no light" : data.kind === "mag" ? v.toFixed(2) + " mag" : v.toPrecision(4);
    const parts = [
      data.time[row] + " " + data.scale, "recorded " + told(observed), "model " + told(model),
      "phase angle " + data.phase[row].toFixed(1) + "°", "nearest glint: " + data.glint[row],
    ];
    text.textContent = parts.join(" · ");
    slider.setAttribute("aria-valuetext", parts.slice(0, 3).join(", "));
  }

  let waiting = false;
  function redraw() {
    if (waiting) return;
    waiting = true;
    requestAnimationFrame(() => { waiting = false; draw(); });
  }

  function turn(right, up) {
    const cx = Math.cos(right), sx = Math.sin(right), cy = Math.cos(up), sy = Math.sin(up), [r, u, t] = camera;
    const mix = (a, p, b, q) => [0, 1, 2].map(i => a[i] * p + b[i] * q);
    const r2 = mix(r, cx, t, sx), t2 = mix(t, cx, r, -sx);
    camera = [r2, mix(u, cy, t2, sy), mix(t2, cy, u, -sy)];
    follow = null;
    mark();
    redraw();
  }

  const views = [...document.querySelectorAll("[data-view]")];
  const mark = () => views.forEach(b => b.setAttribute("aria-pressed", String((b.dataset.view || null) === follow && follow !== null)));
  views.forEach(button => button.addEventListener("click", () => {
    follow = button.dataset.view === "aside" ? null : button.dataset.view;
    camera = follow ? lookingAlong(data[follow][row], camera[1]) : data.camera;
    scale = 0;
    mark();
    redraw();
  }));
  slider.max = String(data.hours.length - 1);
  slider.value = String(row);
  slider.addEventListener("input", () => { row = Number(slider.value); redraw(); });
  const go = to => { row = Math.min(data.hours.length - 1, Math.max(0, to)); slider.value = String(row); redraw(); };
  strip.addEventListener("pointerdown", e => {
    const box = strip.getBoundingClientRect();
    go(Math.round((e.clientX - box.left - 8) / (box.width - 16) * (data.hours.length - 1)));
  });
  let from = null;
  canvas.addEventListener("pointerdown", e => { from = [e.clientX, e.clientY]; canvas.setPointerCapture(e.pointerId); });
  canvas.addEventListener("pointermove", e => {
    if (!from) return;
    turn((from[0] - e.clientX) * 0.01, (e.clientY - from[1]) * 0.01);
    from = [e.clientX, e.clientY];
  });
  ["pointerup", "pointercancel"].forEach(name => canvas.addEventListener(name, () => { from = null; }));
  canvas.addEventListener("keydown", e => {
    const step = { ArrowLeft: [0.1, 0], ArrowRight: [-0.1, 0], ArrowUp: [0, -0.1], ArrowDown: [0, 0.1] }[e.key];
    if (step) { e.preventDefault(); turn(...step); }
  });
  play.addEventListener("click", () => {
    if (timer) { clearInterval(timer); timer = null; } else {
      timer = setInterval(() => go(row + 1 > data.hours.length - 1 ? 0 : row + 1), 80);
    }
    play.textContent = timer ? "Pause" : "Play";
  });
  window.addEventListener("resize", () => { scale = 0; redraw(); });
  window.matchMedia("(prefers-color-scheme: dark)").addEventListener("change", redraw);
  draw();
})();
