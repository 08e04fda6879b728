// The page: joins connection, stage, characters, steering and panels, and draws.
import { Cast } from "./cast.js";
import { Connection } from "./net/connection.js";
import { Bodies, colourOf } from "./scene/bodies.js";
import { Stage } from "./scene/stage.js";
import { goTo } from "./steer/commands.js";
import { Pointer } from "./steer/pointer.js";
import { isTyping, Velocity } from "./steer/velocity.js";
import { note, trying } from "./ui/dom.js";
import { People } from "./ui/people.js";
import { PromptBox } from "./ui/prompt.js";
import { Status } from "./ui/status.js";

const byId = (id) => document.getElementById(id);
const address = new URLSearchParams(location.search);
const token = new URLSearchParams(location.hash.slice(1)).get("token") ?? "";

const stage = new Stage(byId("stage"));
const connection = new Connection(address.get("room") ?? "main", token);
const cast = new Cast(connection);
const bodies = new Bodies(stage.scene);
const status = new Status(byId("status"), cast, connection);
new People(byId("people"), cast);
const prompt = new PromptBox(byId("prompt"), cast);
const canSteer = () => cast.role === "control" && Boolean(cast.one) && connection.isOpen;
const velocity = new Velocity(stage, (message) => trying(() => cast.tell(message)), canSteer);
let follows = true;

const walking = {
  click(event) {
    const hit = stage.hit(event, [bodies.mesh]);
    const place = stage.groundAt(event);
    if (hit) cast.choose(bodies.ownerOf(hit.instanceId));
    else if (place && canSteer()) {
      trying(() => cast.tell({ op: "add_constraints", constraints: [goTo(place)] }));
    }
  },
};
new Pointer(stage, () => walking);

cast.addEventListener("server", () => document.body.classList.toggle("watching", cast.role !== "control"));
cast.addEventListener("catalog", addFirst, { once: true });

async function addFirst() {
  await new Promise((resolve) => setTimeout(resolve, 300)); // who is there already is told in the next message
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

addEventListener("keydown", (event) => {
  if (isTyping(event.target) || event.ctrlKey || event.metaKey) return;
  if (event.key === "/") {
    event.preventDefault();
    prompt.focus();
  } else if (event.key === "f") follows = !follows;
});

function draw(nowMs) {
  requestAnimationFrame(draw);
  velocity.update(nowMs);
  bodies.begin();
  for (const member of cast.members.values()) {
    const row = member.track.sample(member.track.playhead(nowMs));
    if (!row) continue;
    member.rig.pose(row);
    bodies.add(member.rig, colourOf(member.number), member.number);
    if (member.number === cast.chosen && follows) stage.follow(member.rig.position(0));
  }
  bodies.end();
  stage.render();
  const rateHz = status.count(nowMs);
  if (rateHz !== null) stage.adapt(rateHz, nowMs);
}
requestAnimationFrame(draw);

// What tests and consoles look at.
globalThis.motiongen = { cast, connection, stage, bodies, status };
