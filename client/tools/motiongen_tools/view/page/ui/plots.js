// Plots of the chosen character that run with what is shown: root speed, and how feet on the ground slide.
import { make } from "./dom.js";

const SECONDS = 6;
const HEIGHT = 64;
const MOST_MPS = 3;
const PERIOD_MS = 200;

export class Plots {
  constructor() {
    this._canvas = make("canvas", { width: 262, height: HEIGHT });
    this._canvas.setAttribute("aria-label", "Root speed and sliding of feet over the last seconds");
    this._context = this._canvas.getContext("2d");
    this.element = make("section", {}, make("h2", {}, "Root speed, foot slide (m/s, to 3)"), this._canvas);
    this._drawnMs = 0;
  }

  /** At every frame that is drawn. place: the frame that is shown. */
  draw(member, place, nowMs) {
    if (nowMs - this._drawnMs < PERIOD_MS || !member || !this.element.checkVisibility()) return;
    this._drawnMs = nowMs;
    const { width } = this._canvas;
    const context = this._context;
    context.clearRect(0, 0, width, HEIGHT);
    const { speeds, slides } = figures(member, Math.floor(place));
    const style = getComputedStyle(document.documentElement);
    draw(context, speeds, width, style.getPropertyValue("--accent"));
    draw(context, slides, width, style.getPropertyValue("--bad"));
  }
}

/** Metres a second at each of the last frames: of the root, and of the fastest foot that is said to stand. */
export function figures(member, last) {
  const { rig, track } = member;
  const feet = ["LeftFoot", "LeftToeBase", "RightFoot", "RightToeBase"].map((name) => rig.joints.indexOf(name));
  const speeds = [], slides = [];
  let before = null;
  for (let frame = Math.max(last - SECONDS * rig.frameRate, track.first); frame <= last; frame++) {
    const row = track.row(frame);
    if (!row) continue;
    rig.pose(row);
    const contacts = rig.contactsOf(row);
    const here = { root: rig.rootOf(row), feet: feet.map((joint) => [rig.positions[3 * joint], rig.positions[3 * joint + 2]]), contacts };
    if (before) {
      const mps = ([x, z], [px, pz]) => Math.hypot(x - px, z - pz) * rig.frameRate;
      speeds.push(mps(here.root, before.root));
      slides.push(Math.max(0, ...feet.map((joint, n) => (joint >= 0 && contacts[n] && before.contacts[n] ? mps(here.feet[n], before.feet[n]) : 0))));
    }
    before = here;
  }
  return { speeds, slides };
}

function draw(context, values, width, colour) {
  context.strokeStyle = colour;
  context.beginPath();
  values.forEach((value, n) => context.lineTo((n / (values.length - 1 || 1)) * width, HEIGHT - 2 - (Math.min(value, MOST_MPS) / MOST_MPS) * (HEIGHT - 4)));
  context.stroke();
}
