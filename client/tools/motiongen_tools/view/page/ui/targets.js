// Targets as numbers: all fields of a constraint, for those who have no pointer or want exact values.
import { frameIn } from "../steer/commands.js";
import { labelled, make, trying } from "./dom.js";

const RADIANS = Math.PI / 180;
const KINDS = {
  place: ["x", "z", "heading"], heading: ["heading"], joint: ["joint", "x", "y", "z"], height: ["y"], foot: ["limb", "x", "z", "heading"], path: ["corners", "speed", "smoothing"],
};
const FEET = ["LeftFoot", "RightFoot"];
const WHENS = { soon: "as soon as possible", at: "at", within: "from … to", after: "this long after it takes effect" };

export class TargetForm {
  constructor(cast) {
    this._cast = cast;
    const number = (id, value, more = {}) => make("input", { id: `target-${id}`, type: "number", step: "any", value, ...more });
    const select = (id, entries) => make("select", { id: `target-${id}`, onchange: () => this._show() }, ...entries.map(([value, name]) => make("option", { value }, name)));
    this._kind = select("kind", Object.keys(KINDS).map((name) => [name, name]));
    this._when = select("when", Object.entries(WHENS));
    this._fields = {
      joint: make("select", { id: "target-joint" }), limb: make("select", { id: "target-limb" }), x: number("x", 0), y: number("y", 1), z: number("z", 2),
      heading: number("heading", "", { placeholder: "free" }), corners: make("input", { id: "target-corners", placeholder: "0,2 2,2 2,4" }),
      speed: number("speed", "", { placeholder: "1.2" }), smoothing: number("smoothing", "", { placeholder: "0.3" }),
    };
    const names = { joint: "joint", limb: "foot", x: "x m", y: "height m", z: "z m", heading: "heading °", corners: "corners x,z m", speed: "m/s", smoothing: "cut m" };
    this._labels = Object.fromEntries(Object.entries(this._fields).map(([name, field]) => [name, labelled(names[name], field)]));
    this._from = labelled("s", number("from", 2));
    this._to = labelled("to s", number("to", 4));
    this._weight = number("weight", "", { placeholder: "1", min: 0, max: 10 });
    this._within = number("tolerance", "", { placeholder: "model's" });
    this._turn = number("tolerance-turn", "", { placeholder: "model's" });
    this._isRelative = make("input", { type: "checkbox", id: "target-relative" });
    this._isAlone = make("input", { type: "checkbox", id: "target-alone" });
    const box = (field, name) => make("label", { className: "inline" }, field, name);
    const row = (...parts) => make("div", { className: "row" }, ...parts);
    const form = make(
      "form", { onsubmit: (event) => this._say(event) },
      row(labelled("target", this._kind), ...Object.values(this._labels)), row(labelled("when", this._when), this._from, this._to),
      row(labelled("weight", this._weight), labelled("within cm", this._within), labelled("within °", this._turn)),
      row(box(this._isRelative, "seen from the character"), box(this._isAlone, "in place of all others")),
      make("button", { id: "target-add" }, "Ask for it"),
    );
    this.element = make("details", { className: "steering", id: "target-panel" }, make("summary", {}, "Target in numbers"), form);
    cast.addEventListener("choice", () => this._showJoints());
    this._show();
  }

  _show() {
    for (const [name, label] of Object.entries(this._labels)) label.hidden = !KINDS[this._kind.value].includes(name);
    const isPath = this._kind.value === "path";
    for (const option of this._when.options) option.disabled = isPath ? option.value !== "soon" : option.value === "soon" && this._kind.value !== "place";
    if (this._when.selectedOptions[0]?.disabled) this._when.value = isPath ? "soon" : "after";
    this._from.hidden = this._when.value === "soon";
    this._to.hidden = this._when.value !== "within";
  }

  _showJoints() {
    const joints = this._cast.one?.rig.joints ?? [];
    this._fields.joint.replaceChildren(...joints.map((name, n) => make("option", { value: n }, name)));
    const feet = FEET.filter((name) => name in (this._cast.one?.rig.limbs ?? {}));
    this._fields.limb.replaceChildren(...feet.map((name) => make("option", { value: name }, name)));
    const hand = joints.indexOf("RightHand");
    if (hand >= 0) this._fields.joint.value = String(hand);
  }

  /** The constraint, in the bridge's JSON form. */
  constraint(member) {
    const value = (name) => (this._fields[name].value === "" ? null : Number(this._fields[name].value));
    const heading = value("heading") === null ? {} : { heading_rad: value("heading") * RADIANS };
    const timed = this._timing(member);
    const wanted = {
      place: () => ({ kind: "waypoint", x_m: value("x"), z_m: value("z"), ...heading }),
      heading: () => ({ kind: "heading", heading_rad: 0, ...heading }),
      joint: () => ({ kind: "joint_targets", joints: [value("joint")], positions_m: [[value("x"), value("y"), value("z")]] }),
      height: () => ({ kind: "joint_targets", joints: [0], positions_m: [[...this._here(member, timed.frame)]].map(([x, z]) => [x, value("y"), z]) }),
      foot: () => ({ kind: "foot_contact", limb: this._fields.limb.value, x_m: value("x"), z_m: value("z"), ...heading }),
      path: () => ({ kind: "path", corners_m: corners(this._fields.corners.value), ...given("speed_mps", value("speed")), ...given("smoothing_m", value("smoothing")) }),
    }[this._kind.value]();
    const said = { ...wanted, ...timed };
    if (this._weight.value) said.weight = Number(this._weight.value);
    if (this._within.value) said.tolerance_m = Number(this._within.value) / 100;
    if (this._turn.value) said.tolerance_rad = Number(this._turn.value) * RADIANS;
    if (this._isRelative.checked) said.is_relative = true;
    return said;
  }

  _timing(member) {
    const [from, to] = [this._from, this._to].map((label) => Number(label.querySelector("input").value));
    if (this._kind.value === "path") return {};
    switch (this._when.value) {
      case "soon":
        return { frame: 0, at_any_frame: true };
      case "after":
        return { frame: Math.round(from * member.rig.frameRate), frames_from_effect: true };
      case "within":
        return { frame: frameIn(member, from), last_frame: frameIn(member, Math.max(from, to)) };
    }
    return { frame: frameIn(member, from) };
  }

  /** The planned place of the root at that time, because only its height is asked for. */
  _here(member, frame) {
    if (this._isRelative.checked) return [0, 0];
    const { track, rig } = member;
    const row = track.row(Math.min(Math.max(frame, track.first), track.end - 1));
    if (!row) throw new Error("this character has no frames yet");
    return rig.rootOf(row);
  }

  _say(event) {
    event.preventDefault();
    const member = this._cast.one;
    if (!member) return;
    const op = this._isAlone.checked ? "set_constraints" : "add_constraints";
    trying(async () => this._cast.tell({ op, constraints: [this.constraint(member)] }));
  }
}

function given(name, value) {
  return value === null ? {} : { [name]: value };
}

/** "0,2 2,2" -> [[0, 2], [2, 2]]. Throws for anything else. */
export function corners(text) {
  const points = text.trim().split(/\s+/).map((pair) => pair.split(",").map(Number));
  if (!points.every((pair) => pair.length === 2 && pair.every(Number.isFinite))) throw new Error(`corners: ${text || "nothing"} was given; allowed are pairs in metres, as 0,2 2,2`);
  return points;
}
