// Running plots of the chosen character: root speed, how fast feet on the ground slide, and the distance to
// its next target, which is the residual once the target's frame is reached.
import { make } from "./dom.js";

const SECONDS = 6;
const HEIGHT = 64;
const MOST_MPS = 3;
const PERIOD_MS = 200;

export class Plots {
  constructor() {
    this._canvas = make("canvas", { width: 262, height: HEIGHT });
    this._canvas.setAttribute("aria-label", "Root speed, sliding of feet and distance to the next target over the last seconds");
    this._context = this._canvas.getContext("2d");
    this.element = make("section", {}, make("h2", {}, "Root speed, foot slide (m/s), distance to the target (m), up to 3"), this._canvas);
    this._drawnMs = 0;
    this.drawn = { speeds: [], slides: [], ways: [] };
  }

  /** Called for every frame drawn. place: the frame that is shown. */
  draw(member, place, nowMs) {
    if (nowMs - this._drawnMs < PERIOD_MS || !member || !this.element.checkVisibility()) return;
    this._drawnMs = nowMs;
    const { width } = this._canvas;
    const context = this._context;
    context.clearRect(0, 0, width, HEIGHT);
    const { speeds, slides, ways } = (this.drawn = figures(member, Math.floor(place)));
    const style = getComputedStyle(document.documentElement);
    draw(context, speeds, width, style.getPropertyValue("--accent"));
    draw(context, slides, width, style.getPropertyValue("--bad"));
    draw(context, ways, width, style.getPropertyValue("--good"));
  }
}

/** For each of the last frames: metres a second of the root and of the fastest foot in contact; metres to the target. */
export function figures(member, last) {
  const { rig, track } = member;
  const { feet } = rig;
  const speeds = [], slides = [], ways = [];
  let before = null;
  for (let frame = Math.max(last - SECONDS * rig.frameRate, track.first); frame <= last; frame++) {
    const row = track.row(frame);
    if (!row) continue;
    rig.pose(row);
    const contacts = rig.contactsOf(row);
    const here = { root: rig.rootOf(row), feet: feet.map((joint) => [rig.positions[3 * joint], rig.positions[3 * joint + 2]]), contacts };
    ways.push(wayLeft(member, frame, rig));
    if (before) {
      const mps = ([x, z], [px, pz]) => Math.hypot(x - px, z - pz) * rig.frameRate;
      speeds.push(mps(here.root, before.root));
      slides.push(Math.max(0, ...feet.map((joint, n) => (joint !== undefined && contacts[n] && before.contacts[n] ? mps(here.feet[n], before.feet[n]) : 0))));
    }
    before = here;
  }
  return { speeds, slides, ways };
}

/** Metres from the rig's pose to the next target at a frame; NaN if there is none. */
function wayLeft(member, frame, rig) {
  const next = member.info.targets.find(({ last, arrival, state }) => state !== "removed" && (arrival ?? last) >= frame);
  const { spec } = next ?? {};
  if (!spec || spec.is_relative) return NaN;
  if (spec.kind === "waypoint") return Math.hypot(rig.positions[0] - spec.x_m, rig.positions[2] - spec.z_m);
  if (spec.kind !== "joint_targets" && spec.kind !== "keyframe") return NaN;
  const off = spec.positions_m.map(([x, y, z], n) => {
    const at = 3 * (spec.joints?.[n] ?? n);
    return Math.hypot(rig.positions[at] - x, rig.positions[at + 1] - y, rig.positions[at + 2] - z);
  });
  return Math.max(...off);
}

function draw(context, values, width, colour) {
  context.strokeStyle = colour;
  context.beginPath();
  values.forEach((value, n) => Number.isNaN(value) || context.lineTo((n / (values.length - 1 || 1)) * width, HEIGHT - 2 - (Math.min(value, MOST_MPS) / MOST_MPS) * (HEIGHT - 4)));
  context.stroke();
}
