// The chosen character: how it is served, its edits and their outcomes, its take and its plots.
import { list, make, trying } from "./dom.js";

const STATE_SIGNS = { sent: "…", accepted: "✓", refused: "✗" };
const MOST_EDITS = 8;
const MOST_TARGETS = 6;

export class Inspect {
  constructor(element, cast, takes) {
    this._cast = cast;
    this._facts = make("p", { className: "facts" });
    this._edits = make("ol", { className: "log", id: "edits", "aria-label": "Edits" });
    this._targets = make("ol", { className: "log", id: "targets", "aria-label": "Targets" });
    element.append(
      make("h2", {}, "Chosen"), this._facts, make("h2", {}, "Targets: error when reached"), this._targets,
      make("h2", {}, "Edits: first frame, latency"), this._edits, takes,
    );
    for (const name of ["choice", "members"]) cast.addEventListener(name, () => this._show());
    cast.addEventListener("member", (event) => event.detail.number === cast.chosen && this._show());
    this._show();
  }

  _show() {
    const info = this._cast.one?.info;
    if (!info) {
      this._facts.textContent = "There are no characters; add one.";
      this._edits.replaceChildren();
      this._targets.replaceChildren();
      return;
    }
    const facts = [`${info.name}: ${info.model}, ${info.steps} steps, seed ${info.seed}`];
    if (info.failure) facts.push(info.failure);
    if (info.reopenings) facts.push(`reopened ${info.reopenings} times`);
    if (info.resumes) facts.push(`resumed ${info.resumes} times`);
    this._facts.textContent = facts.join(" · ");
    // called at every plan: an unchanged line stays, with the button that somebody may be about to press
    const whose = `${info.number} ${info.seed}`;
    list(this._edits, info.edits.slice(0, MOST_EDITS).map((edit) => [`${whose} ${JSON.stringify(edit)}`, () => editLine(edit)]));
    const last = info.targets.slice(-MOST_TARGETS).reverse();
    list(this._targets, last.map((target) => [`${whose} ${JSON.stringify(target)}`, () => this._targetLine(target)]));
  }

  _targetLine(target) {
    const errors = [];
    if (target.position_error_m !== null) errors.push(`${(100 * target.position_error_m).toFixed(1)} cm`);
    if (target.rotation_error_rad !== null) errors.push(`${((180 / Math.PI) * target.rotation_error_rad).toFixed(0)}°`);
    const when = target.arrival === null ? "" : ` at ${target.arrival}`;
    const line = make("li", { className: target.state }, `${target.spec.kind.replaceAll("_", " ")}${when}: ${target.state} ${errors.join(", ")}`);
    if (target.state === "waiting" && this._cast.role === "control") {
      const drop = () => trying(() => this._cast.tell({ op: "remove_constraints", constraint_ids: [target.id] }));
      const button = make("button", { className: "small", title: "Drop this target", onclick: drop }, "×");
      button.setAttribute("aria-label", button.title);
      line.append(button);
    }
    return line;
  }
}

function editLine(edit) {
  const shows = edit.effective_frame === null ? "" : ` → ${edit.effective_frame}`;
  const latency = edit.latency_ms === null ? "" : `, ${edit.latency_ms} ms`;
  const line = make("li", { className: edit.state }, `${STATE_SIGNS[edit.state]} ${edit.what}${shows}${latency}`);
  if (edit.detail) line.append(make("small", {}, edit.detail));
  return line;
}
