// The page: connects connection, stage, characters, steering and panels, and draws.
import { Cast } from "./cast.js";
import { Connection } from "./net/connection.js";
import { Bodies, colourOf } from "./scene/bodies.js";
import { Marks } from "./scene/marks.js";
import { Pick } from "./scene/pick.js";
import { Stage } from "./scene/stage.js";
import { Pointer } from "./steer/pointer.js";
import { Tools } from "./steer/tools.js";
import { isTyping, Velocity } from "./steer/velocity.js";
import { Timeline } from "./timeline/timeline.js";
import { Compare } from "./ui/compare.js";
import { note, trying } from "./ui/dom.js";
import { makeHelp } from "./ui/help.js";
import { Inspect } from "./ui/inspect.js";
import { Options } from "./ui/options.js";
import { People } from "./ui/people.js";
import { Plots } from "./ui/plots.js";
import { PromptBox } from "./ui/prompt.js";
import { Status } from "./ui/status.js";
import { Takes } from "./ui/takes.js";
import { TargetForm } from "./ui/targets.js";

const byId = (id) => document.getElementById(id);

const MOST_FAILURES = 20;
const failures = new Set();

/** An error of the page is shown once, however often it occurs; the console says where. */
function sayFailure(error) {
  const what = error instanceof Error ? error.message : String(error);
  if (failures.has(what) || failures.size >= MOST_FAILURES) return;
  failures.add(what);
  note(`an error occurred in the page: ${what}. Reload the page if it stops working`, "error");
}
addEventListener("error", ({ error }) => error && sayFailure(error));
addEventListener("unhandledrejection", ({ reason }) => sayFailure(reason));

const address = new URLSearchParams(location.search);
const token = new URLSearchParams(location.hash.slice(1)).get("token") ?? "";
const room = address.get("room") ?? "main";

const stage = makeStage();
const connection = new Connection(room, token);
const cast = new Cast(connection);
const bodies = new Bodies(stage.scene);
const ghosts = new Bodies(stage.scene, { opacity: 0.35, castShadow: false });
const marks = new Marks(stage.scene);
const pick = new Pick(stage);
const status = new Status(byId("status"), cast, connection);
const timeline = new Timeline(byId("timeline"), cast);
const takes = new Takes(cast, room, token, stage.scene);
const compare = new Compare(cast, takes);
const plots = new Plots();
new People(byId("people"), cast);
new Inspect(byId("inspect"), cast, takes.element);
byId("inspect").append(compare.element, new TargetForm(cast).element, new Options(cast, timeline).element, plots.element, marks.choice(cast));
const prompt = new PromptBox(byId("prompt"), cast);
const tools = new Tools(byId("tools"), stage, cast, pick, ghosts);
const canSteer = () => cast.role === "control" && Boolean(cast.one) && connection.isOpen && timeline.seek === null;
const velocity = new Velocity(stage, (message) => trying(() => cast.tell(message)), canSteer, () => tools.keepsPrompt);
new Pointer(stage, () => tools.current, () => tools.drop());
makeHelp(byId("help"));
let follows = true;

function makeStage() {
  try {
    return new Stage(byId("stage"), address.get("draw") === "plain");
  } catch (error) {
    byId("status").textContent = `motiongen: this browser does not support WebGL, which the page needs (${error.message})`;
    throw error;
  }
}

cast.addEventListener("server", () => document.body.classList.toggle("watching", cast.role !== "control"));
cast.addEventListener("catalog", addFirst, { once: true });

async function addFirst() {
  await new Promise((resolve) => setTimeout(resolve, 300)); // the next message lists the characters that exist
  if (cast.members.size || cast.role !== "control" || address.has("empty")) return;
  const stand = cast.models[0]?.presets.find(({ id }) => id === "stand");
  await trying(() => cast.ask({ op: "add", count: 1, preset: stand?.id ?? null }));
  note("W A S D walks, a click on the ground goes there, ? shows all keys");
}

function setTheme(name) {
  document.documentElement.classList.toggle("light", name === "light");
  stage.setTheme(name);
}
const prefersLight = matchMedia("(prefers-color-scheme: light)");
setTheme(prefersLight.matches ? "light" : "dark");
prefersLight.addEventListener("change", () => setTheme(prefersLight.matches ? "light" : "dark"));

function step(by) {
  const numbers = [...cast.members.keys()];
  if (numbers.length) cast.choose(numbers[(numbers.indexOf(cast.chosen) + by + numbers.length) % numbers.length]);
}

function look() {
  const row = cast.one?.track.sample(cast.one.track.playhead());
  if (!row) return;
  cast.one.rig.pose(row);
  stage.frame(cast.one.rig.position(0), cast.one.rig.heading());
}

const KEYS = {
  "/": () => prompt.focus(),
  f: () => (follows = !follows),
  v: look,
  n: () => step(1),
  p: () => step(-1),
  u: () => cast.role === "control" && timeline.undo(),
  " ": () => cast.role === "control" && timeline.togglePause(),
  c: () => compare.toggle(),
  t: () => (marks.showsTrails = marks.showsContacts = !marks.showsTrails),
  l: () => setTheme(document.documentElement.classList.contains("light") ? "dark" : "light"),
  b: () => document.body.classList.toggle("bare"),
  "?": () => byId("help").showModal(),
};
["walk", "path", "limb", "face", "pose"].forEach((name, n) => (KEYS[n + 1] = () => tools.choose(name)));

addEventListener("keydown", (event) => {
  const isControl = event.target instanceof HTMLElement && event.target.matches("button, summary, a, input");
  if (event.repeat || isTyping(event.target) || event.ctrlKey || event.metaKey || (isControl && event.key === " ")) return;
  const act = KEYS[event.key];
  if (!act) return;
  event.preventDefault();
  act();
});

const tip = byId("tip");
stage.canvas.addEventListener("pointermove", (event) => {
  const owner = event.buttons ? null : cast.members.get(pick.at(event));
  tip.hidden = !owner;
  if (owner) {
    tip.textContent = owner.info.name;
    Object.assign(tip.style, { left: `${event.clientX + 12}px`, top: `${event.clientY + 8}px` });
  }
});

let drawnMs = performance.now();

function draw(nowMs) {
  requestAnimationFrame(draw);
  velocity.update(nowMs);
  compare.update(Math.min((nowMs - drawnMs) / 1000, 0.2), timeline.seek);
  drawnMs = nowMs;
  bodies.begin();
  ghosts.begin();
  pick.begin();
  for (const member of cast.members.values()) {
    if (compare.holds(member)) continue;
    const row = member.track.sample(timeline.place(member, nowMs));
    if (!row) continue;
    member.rig.pose(row);
    bodies.add(member.rig, colourOf(member.number));
    pick.add(member.number, member.rig);
  }
  takes.draw(bodies, nowMs, compare.pair?.[1]);
  compare.draw(bodies, ghosts, stage.camera);
  bodies.end();
  stage.setCrowd(cast.members.size);
  drawChosen(nowMs);
  ghosts.end();
  stage.render();
  timeline.draw(nowMs);
  const rateHz = status.count(nowMs);
  if (rateHz !== null) {
    stage.adapt(rateHz, nowMs);
  }
}

/** Draw what belongs only to the chosen character. Rigs are shared, so it is posed again. */
function drawChosen(nowMs) {
  const member = cast.one;
  if (!member) return;
  const place = compare.holds(member) ? compare.frame : timeline.place(member, nowMs);
  plots.draw(member, place, nowMs);
  const row = member.track.sample(place);
  if (row) {
    member.rig.pose(row);
    if (follows) stage.follow(member.rig.position(0));
  }
  marks.update(member, place, compare.pair ? null : row, nowMs); // characters that are drawn displaced have no marks
  tools.update(member);
}
requestAnimationFrame(draw);

// For tests and the console.
globalThis.motiongen = { cast, connection, stage, bodies, status, timeline, tools, takes, compare, velocity, pick, marks, plots };
