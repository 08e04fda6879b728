// Draws the timeline: ruler, committed and planned frames, prompt spans, targets, seams, underruns.

export const ROWS = { ruler: [0, 18], plan: [20, 30], spans: [34, 58], targets: [64, 82], marks: [84, 96] };
const SIGNS = { waypoint: "◆", trajectory: "▬", path: "▬", keyframe: "☻", joint_targets: "✚", heading: "➤", joint_rotations: "↻" };
const HUES = [24, 200, 120, 340, 270, 50, 170, 90];

/** colours: of the theme; seek: the frame looked at, or null while live. drag: a span that is being moved. */
export function drawTimeline(context, view, member, { colours, place, seek, drag }) {
  const { track, info, rig } = member;
  const height = ROWS.marks[1];
  context.clearRect(0, 0, view.width, height);
  context.font = "11px system-ui, 'DejaVu Sans', sans-serif";
  context.textBaseline = "middle";
  ruler(context, view, rig.frameRate, colours, height);
  bar(context, view, track.first, track.end, colours.planned, ROWS.plan);
  bar(context, view, track.first, Math.min(track.committedTo, track.end), colours.committed, ROWS.plan);
  for (const span of spansShown(info, drag)) drawSpan(context, view, span, colours, track);
  context.fillStyle = colours.soft;
  for (const seam of info.seams) context.fillRect(view.toX(seam), ROWS.plan[0] - 1, 1, 12);
  context.fillStyle = colours.bad;
  for (const frame of info.underrun_frames) context.fillRect(view.toX(frame) - 1, ROWS.marks[0], 3, 10);
  for (const target of info.targets) drawTarget(context, view, target, colours);
  line(context, view.toX(place), colours.accent, height, 2);
  if (seek !== null) line(context, view.toX(seek), colours.text, height, 2);
}

/** The spans, with a dragged one at its new place. */
export function spansShown(info, drag) {
  return info.spans.map((span) => (drag && span.prompt_id === drag.prompt_id && span.start === drag.from ? { ...span, ...drag } : span));
}

/** Where a span ends on the timeline: at its own end, or where a later span takes over. */
export function endOf(span, spans, horizon) {
  if (span.end !== null) return span.end;
  const later = spans.filter(({ start }) => start > span.start).map(({ start }) => start);
  return Math.min(...later, Math.max(horizon, span.start + 1));
}

function ruler(context, view, rate, colours, height) {
  const step = [1, 2, 5, 10, 30].find((seconds) => seconds * rate * view.pixelsPerFrame > 60) ?? 60;
  const from = Math.max(Math.floor(view.first / (step * rate)), 0) * step;
  for (let second = from; view.toX(second * rate) < view.width; second += step) {
    const x = view.toX(second * rate);
    context.fillStyle = colours.grid;
    context.fillRect(x, 0, 1, height);
    context.fillStyle = colours.soft;
    context.fillText(`${second} s · ${second * rate}`, x + 4, 9);
  }
}

function bar(context, view, from, to, colour, [top, bottom]) {
  const x = Math.max(view.toX(from), 0);
  context.fillStyle = colour;
  context.fillRect(x, top, Math.max(Math.min(view.toX(to), view.width) - x, 0), bottom - top);
}

function drawSpan(context, view, span, colours, track) {
  const horizon = Math.max(track.end, view.toFrame(view.width));
  const [top, bottom] = ROWS.spans;
  const x = Math.max(view.toX(span.start), -4), end = Math.min(view.toX(span.end ?? horizon), view.width + 4);
  if (end <= x) return;
  const name = span.preset ?? span.text;
  context.fillStyle = `hsl(${HUES[hash(name) % HUES.length]} 55% ${colours.isLight ? 78 : 32}%)`;
  context.fillRect(x, top, end - x - 1, bottom - top);
  if (span.scheduled) {
    context.strokeStyle = colours.text;
    context.strokeRect(x + 0.5, top + 0.5, end - x - 2, bottom - top - 1);
  }
  context.save();
  context.beginPath();
  context.rect(x, top, end - x - 4, bottom - top);
  context.clip();
  context.fillStyle = colours.text;
  context.fillText(name, Math.max(x, 0) + 5, (top + bottom) / 2);
  context.restore();
}

function drawTarget(context, view, target, colours) {
  if (target.first === null) return;
  const [top, bottom] = ROWS.targets;
  const colour = { met: colours.good, missed: colours.bad, removed: colours.grid, waiting: colours.text }[target.state];
  if (target.last > target.first) {
    context.fillStyle = colours.grid;
    context.fillRect(view.toX(target.first), (top + bottom) / 2 - 1, view.toX(target.last) - view.toX(target.first), 3);
  }
  context.fillStyle = colour;
  context.fillText(SIGNS[target.spec.kind] ?? "●", view.toX(target.arrival ?? target.last) - 5, (top + bottom) / 2);
}

function line(context, x, colour, height, width) {
  context.fillStyle = colour;
  context.fillRect(x - width / 2, 0, width, height);
}

function hash(text) {
  let sum = 0;
  for (const letter of text) sum = (sum * 31 + letter.codePointAt(0)) >>> 0;
  return sum;
}
