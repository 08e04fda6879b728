// Options of a character that change while it plays; and cuts, to another place or to the frame that is looked at.
import { labelled, make, trying } from "./dom.js";

const FIELDS = {
  steps: "steps", text_guidance: "guidance by text", constraint_guidance: "by targets", lookahead_frames: "look-ahead, frames", history_frames: "history, frames",
};

export class Options {
  constructor(cast, timeline) {
    this._cast = cast;
    this._fields = Object.fromEntries(Object.keys(FIELDS).map((name) => [name, make("input", { id: `option-${name}`, type: "number", step: "any", min: 0, placeholder: "as it is" })]));
    this._priority = make("select", { id: "option-priority" }, ...["", "hero", "near", "crowd", "batch"].map((name) => make("option", { value: name }, name || "as it is")));
    const [x, z, heading] = ["x", "z", "heading"].map((name) => make("input", { id: `put-${name}`, type: "number", step: "any", value: 0 }));
    const put = () => trying(() => cast.tell({ op: "teleport", x_m: Number(x.value), z_m: Number(z.value), heading_rad: (Number(heading.value) * Math.PI) / 180 }));
    const cut = () => trying(async () => {
      if (timeline.seek === null) throw new Error("first look at a frame that was played: it continues from there");
      await cast.tell({ op: "cut_to", frame: Math.floor(timeline.seek) + 1 });
      timeline.goLive();
    });
    this.element = make(
      "details", { className: "steering", id: "options-panel" }, make("summary", {}, "How it is served, cuts"),
      make("form", { onsubmit: (event) => this._say(event) },
        make("div", { className: "row" }, labelled("class", this._priority), ...Object.entries(FIELDS).map(([name, label]) => labelled(label, this._fields[name])), make("button", { id: "options-set" }, "Set"))),
      make("div", { className: "row" }, labelled("x m", x), labelled("z m", z), labelled("heading °", heading), make("button", { id: "put", onclick: put }, "Put there")),
      make("button", { id: "cut", onclick: cut }, "Continue from the frame looked at"),
    );
  }

  _say(event) {
    event.preventDefault();
    const message = { op: "set_options" };
    for (const [name, field] of Object.entries(this._fields)) if (field.value !== "") message[name] = Number(field.value);
    if (this._priority.value) message.priority = this._priority.value;
    trying(() => this._cast.tell(message));
  }
}
