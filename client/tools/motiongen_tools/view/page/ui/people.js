// The list of characters: choose, add, remove; with which model and options.
import { colourOf } from "../scene/bodies.js";
import { labelled, list, make, trying } from "./dom.js";

export class People {
  constructor(element, cast) {
    this._cast = cast;
    this._list = make("ul", { role: "listbox", "aria-label": "Characters" });
    this._count = make("input", { type: "number", min: 1, max: 200, value: 1, id: "add-count" });
    this._model = make("select", { id: "add-model" });
    this._steps = make("input", { type: "number", id: "add-steps", placeholder: "server's" });
    this._seed = make("input", { type: "text", inputMode: "numeric", id: "add-seed", placeholder: "drawn" });
    this._priority = make("select", { id: "add-priority" });
    for (const name of ["near", "hero", "crowd"]) this._priority.append(make("option", { value: name }, name));
    const more = make(
      "details", {}, make("summary", {}, "how"),
      labelled("model", this._model), labelled("steps", this._steps), labelled("seed", this._seed),
      labelled("class", this._priority),
    );
    const form = make(
      "form", { className: "steering", onsubmit: (event) => this._add(event) },
      make("div", { className: "row" }, labelled("add", this._count), make("button", { id: "add" }, "Add")), more,
    );
    element.append(make("h2", {}, "Characters"), this._list, form);
    cast.addEventListener("members", () => this._show());
    cast.addEventListener("choice", () => this._show());
    cast.addEventListener("catalog", () => this._showModels());
  }

  _showModels() {
    const before = this._model.value;
    this._model.replaceChildren(...this._cast.models.map(({ id }) => make("option", { value: id }, id)));
    if (this._cast.model(before)) this._model.value = before; // keep the choice when the catalogue changes
    const [model] = this._cast.models;
    if (model) [this._steps.min, , this._steps.max] = model.steps.map(String);
  }

  _show() {
    list(this._list, [...this._cast.members.values()].map((member) => [`${member.number} ${member.info.name}`, () => this._entry(member)]));
    for (const entry of this._list.children) entry.setAttribute("aria-selected", String(Number(entry.dataset.number) === this._cast.chosen));
  }

  _entry(member) {
    const dot = make("span", { className: "dot" });
    dot.style.background = `#${colourOf(member.number).toString(16).padStart(6, "0")}`;
    const choose = make("button", { className: "who", onclick: () => this._cast.choose(member.number) }, dot, member.info.name);
    const remove = make(
      "button",
      {
        className: "steering small", title: `Remove ${member.info.name}`,
        onclick: () => trying(() => this._cast.ask({ op: "remove", character: member.number })),
      },
      "×",
    );
    remove.setAttribute("aria-label", remove.title);
    return make("li", { role: "option", dataset: { number: member.number } }, choose, remove);
  }

  async _add(event) {
    event.preventDefault();
    const message = { op: "add", count: Number(this._count.value), preset: this._standing(), priority: this._priority.value };
    if (this._model.value) message.model = this._model.value;
    if (this._steps.value) message.steps = Number(this._steps.value);
    if (this._seed.value.trim()) message.seed = this._seed.value.trim();
    const answer = await trying(() => this._cast.ask(message));
    if (answer?.numbers.length === 1) this._cast.choose(answer.numbers[0]);
  }

  /** A standing character obeys clicks and keys best: without a target, it waits. */
  _standing() {
    const presets = this._cast.models.find(({ id }) => id === this._model.value)?.presets ?? [];
    return (presets.find(({ id }) => id === "stand") ?? presets[0])?.id ?? null;
  }
}
