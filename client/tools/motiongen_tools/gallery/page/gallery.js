// The gallery: stick figures on canvases, in sync and from the same side. It needs no library, so it opens from the disk.
"use strict";

const told = JSON.parse(document.getElementById("takes").textContent);
const TILT_RAD = 0.28, DISTANCE_M = 4.6, HEIGHT_M = 0.95, LENS = 1.75, GRID_M = 6, BESIDE_M = 1.4;
const byId = (id) => document.getElementById(id);
const state = { isPlaying: !matchMedia("(prefers-reduced-motion: reduce)").matches, seconds: 0, turn: (35 * Math.PI) / 180 };
const pictures = []; // {canvas, takes: [{take, shift}], longestS, isSeen}

function unpacked(take) {
  if (!take.num_frames) return null;
  const bytes = Uint8Array.from(atob(take.data), (letter) => letter.charCodeAt(0));
  return new Int16Array(bytes.buffer);
}

function make(name, properties, ...children) {
  const element = Object.assign(document.createElement(name), properties);
  element.append(...children);
  return element;
}

function caption(name, take) {
  const said = make("figcaption", {});
  if (told.columns.length > 1) said.append(make("b", {}, name), " ");
  if (take.figures) said.append(take.figures, ". ");
  if (take.detail) said.append(make("span", { className: take.verdict }, take.detail));
  if (take.left_out) said.append(` The first ${(take.num_frames / take.fps).toFixed(0)} s of ${((take.num_frames + take.left_out) / take.fps).toFixed(0)}.`);
  return said;
}

function picture(title, takes) {
  const canvas = make("canvas", { tabIndex: 0 });
  canvas.setAttribute("role", "img");
  canvas.setAttribute("aria-label", `${title}. Left and right arrows turn the view.`);
  const shown = { canvas, takes, isSeen: false, longestS: Math.max(...takes.map(({ take }) => take.num_frames / take.fps)) };
  pictures.push(shown);
  turnable(canvas);
  return shown;
}

function turnable(canvas) {
  let from = null;
  canvas.addEventListener("pointerdown", (event) => {
    from = [event.clientX, state.turn];
    canvas.setPointerCapture(event.pointerId);
  });
  canvas.addEventListener("pointermove", (event) => from && look(from[1] - (event.clientX - from[0]) * 0.01));
  canvas.addEventListener("pointerup", () => (from = null));
  canvas.addEventListener("keydown", (event) => {
    const by = { ArrowLeft: 0.1, ArrowRight: -0.1 }[event.key];
    if (by) look(state.turn + by);
    if (by) event.preventDefault();
  });
}

function look(turn) {
  state.turn = Math.atan2(Math.sin(turn), Math.cos(turn));
  byId("turn").value = Math.round((state.turn * 180) / Math.PI);
}

function build() {
  byId("gallery").style.setProperty("--row", `${Math.min(260 * told.columns.length, 900)}px`);
  for (const [at, part] of told.parts.entries()) {
    byId("parts").append(make("a", { href: `#part-${at}` }, `${part.title} (${part.rows.length})`));
    const rows = make("div", { className: "rows" });
    for (const row of part.rows) rows.append(rowOf(row));
    byId("gallery").append(make("section", {}, make("h2", { id: `part-${at}` }, part.title), rows));
  }
}

function rowOf(row) {
  const verdicts = row.takes.filter(Boolean).map(({ verdict }) => verdict);
  const worst = ["refused", "missed", "met"].find((name) => verdicts.includes(name)) ?? "";
  const figures = make("div", { className: "takes" });
  const there = [], names = [];
  row.takes.forEach((take, column) => {
    if (!take) return;
    const name = told.columns[column], figure = make("figure", {});
    take.numbers = unpacked(take);
    if (take.numbers) {
      figure.append(picture(`${row.title}, ${name}`, [{ take, shift: 0 }]).canvas);
      there.push(take);
      names.push(name);
    }
    figure.append(caption(name, take));
    figures.append(figure);
  });
  if (there.length > 1) {
    const both = there.map((take, n) => ({ take, shift: BESIDE_M * ((there.length - 1) / 2 - n), name: names[n], line: n }));
    const figure = make("figure", { className: "both" }, picture(`${row.title}, side by side`, both).canvas);
    figure.hidden = true;
    figures.append(figure);
  }
  return make("article", { className: `row ${worst}` }, make("h3", {}, row.title), figures);
}

/** Where a point of a take is on a canvas, seen from the following camera: [x, y, metres away]. */
function projection(canvas, centre) {
  const { width, height } = canvas;
  const [sin, cos] = [Math.sin(state.turn), Math.cos(state.turn)];
  const [lift, level] = [Math.sin(TILT_RAD), Math.cos(TILT_RAD)];
  const scale = LENS * Math.min(height, width);
  return (x, y, z) => {
    const [dx, dy, dz] = [x - centre[0], y - HEIGHT_M, z - centre[1]];
    const across = cos * dx - sin * dz, along = sin * dx + cos * dz;
    const away = DISTANCE_M + level * along - lift * dy;
    const up = level * dy + lift * along;
    return away < 0.3 ? null : [width / 2 - (scale * across) / away, height / 2 - (scale * up) / away, away];
  };
}

function draw(shown, colours) {
  const { canvas, takes } = shown;
  const ratio = Math.min(devicePixelRatio, 2);
  const width = Math.round(canvas.clientWidth * ratio), height = Math.round(canvas.clientHeight * ratio);
  if (canvas.width !== width || canvas.height !== height) Object.assign(canvas, { width, height });
  const context = canvas.getContext("2d");
  context.fillStyle = colours.ground;
  context.fillRect(0, 0, width, height);
  const placed = takes.map(({ take, shift, name, line }) => {
    const frame = Math.min(Math.floor((state.seconds % shown.longestS) * take.fps), take.num_frames - 1);
    return { take, shift, name, line, frame, at: frame * take.parents.length * 3 };
  });
  const mean = (axis) => placed.reduce((sum, { take, at, shift }) => sum + take.numbers[at + axis] / 1000 + (axis ? 0 : shift), 0) / placed.length;
  const centre = [mean(0), mean(2)];
  const place = projection(canvas, centre);
  grid(context, place, centre, colours, ratio);
  for (const one of placed) {
    for (const goal of one.take.goals) drawGoal(context, place, one, goal, colours, ratio);
    figure(context, place, one, colours, ratio);
  }
  context.fillStyle = colours.soft;
  context.font = `${11 * ratio}px system-ui, sans-serif`;
  context.fillText(`${(placed[0].frame / placed[0].take.fps).toFixed(1)} s`, 6 * ratio, height - 6 * ratio);
}

function stroke(context, points, colour, width) {
  context.strokeStyle = colour;
  context.lineWidth = width;
  context.lineCap = context.lineJoin = "round";
  context.beginPath();
  let isDown = false;
  for (const point of points) {
    if (point) context[isDown ? "lineTo" : "moveTo"](point[0], point[1]);
    isDown = Boolean(point);
  }
  context.stroke();
}

function grid(context, place, [x, z], colours, ratio) {
  const [cx, cz] = [Math.round(x), Math.round(z)];
  for (let n = -GRID_M; n <= GRID_M; n++) {
    const far = (k) => [k, k + 1];
    for (let k = -GRID_M; k < GRID_M; k++) { // in pieces, without those behind the camera
      stroke(context, far(k).map((m) => place(cx + n, 0, cz + m)), colours.grid, ratio);
      stroke(context, far(k).map((m) => place(cx + m, 0, cz + n)), colours.grid, ratio);
    }
  }
}

function figure(context, place, { take, shift, at, name, line }, colours, ratio) {
  const points = take.parents.map((_, joint) => {
    const n = at + 3 * joint;
    return place(take.numbers[n] / 1000 + shift, take.numbers[n + 1] / 1000, take.numbers[n + 2] / 1000);
  });
  const floor = place(take.numbers[at] / 1000 + shift, 0, take.numbers[at + 2] / 1000);
  if (floor) {
    context.fillStyle = "rgb(0 0 0 / 18%)";
    context.beginPath();
    context.ellipse(floor[0], floor[1], (90 * ratio) / floor[2], (32 * ratio) / floor[2], 0, 0, 7);
    context.fill();
  }
  const bones = take.parents.map((parent, joint) => [parent, joint]).filter(([parent, joint]) => parent >= 0 && points[parent] && points[joint]);
  bones.sort(([a, b], [c, d]) => points[c][2] + points[d][2] - points[a][2] - points[b][2]); // far ones first
  for (const [parent, joint] of bones) {
    stroke(context, [points[parent], points[joint]], colours[take.sides[joint]], (34 * ratio) / points[joint][2]);
  }
  const head = points[take.head];
  if (head) dot(context, head, (50 * ratio) / head[2], colours.middle);
  if (floor && name) {
    context.fillStyle = colours.soft;
    context.font = `${11 * ratio}px system-ui, sans-serif`;
    context.textAlign = "center";
    const under = floor[1] + (20 + 13 * line) * ratio;
    context.fillText(name, floor[0], Math.min(under, context.canvas.height - 5 * ratio)); // whoever is in front is low in the picture
    context.textAlign = "start";
  }
}

function drawGoal(context, place, { take, shift, frame }, goal, colours, ratio) {
  const points = goal.points.map(([x, y, z]) => place(x + shift, y, z));
  if (goal.is_path) {
    stroke(context, points, colours.accent, 2 * ratio);
    return;
  }
  const isNow = Math.abs(frame - goal.frame) < take.fps / 5;
  const size = (points.length > 4 ? 10 : 20) * ratio * (isNow ? 1.5 : 1);
  for (const point of points.filter(Boolean)) dot(context, point, size / point[2], isNow ? colours.good : colours.accent);
}

function dot(context, [x, y], radius, colour) {
  context.fillStyle = colour;
  context.beginPath();
  context.arc(x, y, radius, 0, 7);
  context.fill();
}

function palette() {
  const probe = getComputedStyle(byId("probe"));
  const colours = {};
  for (const name of ["ground", "grid", "soft", "accent", "good", "left", "right", "middle"]) {
    byId("probe").style.color = `var(--${name})`;
    colours[name] = probe.color;
  }
  return colours;
}

const longestS = () => Math.max(1, ...pictures.map((shown) => shown.longestS));
let lastMs = null, colours = null;

function tick(nowMs) {
  requestAnimationFrame(tick);
  const spentS = lastMs === null ? 0 : Math.min((nowMs - lastMs) / 1000, 0.2);
  lastMs = nowMs;
  if (state.isPlaying) {
    state.seconds = (state.seconds + spentS * Number(byId("pace").value)) % longestS();
    byId("moment").value = state.seconds / longestS();
  }
  for (const shown of pictures) if (shown.isSeen && shown.canvas.clientWidth) draw(shown, colours);
}

function start() {
  document.body.append(make("i", { id: "probe", hidden: true }));
  build();
  colours = palette();
  matchMedia("(prefers-color-scheme: light)").addEventListener("change", () => (colours = palette()));
  const seen = new IntersectionObserver((entries) => {
    for (const { target, isIntersecting } of entries) pictures.find(({ canvas }) => canvas === target).isSeen = isIntersecting;
  });
  for (const { canvas } of pictures) seen.observe(canvas);
  const play = byId("play");
  const say = () => {
    play.textContent = state.isPlaying ? "Pause" : "Play";
    play.setAttribute("aria-pressed", String(state.isPlaying));
  };
  play.addEventListener("click", () => {
    state.isPlaying = !state.isPlaying;
    say();
  });
  byId("moment").addEventListener("input", (event) => {
    state.isPlaying = false;
    state.seconds = Number(event.target.value) * longestS() * 0.9999;
    say();
  });
  byId("turn").addEventListener("input", (event) => (state.turn = (Number(event.target.value) * Math.PI) / 180));
  byId("together").parentElement.hidden = told.columns.length < 2;
  byId("together").addEventListener("change", (event) => {
    for (const each of document.querySelectorAll(".takes:has(.both) > figure")) each.hidden = each.classList.contains("both") !== event.target.checked;
  });
  byId("missed").addEventListener("change", (event) => {
    for (const row of document.querySelectorAll(".row")) row.hidden = event.target.checked && !row.matches(".missed, .refused");
  });
  say();
  requestAnimationFrame(tick);
}

start();
globalThis.gallery = { state, pictures }; // for tests and the console
