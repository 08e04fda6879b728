// The prompt box: text, presets, earlier prompts; for now or for a later time.
import { frameIn } from "../steer/commands.js";
import { labelled, make, note, trying } from "./dom.js";

const MOST_SAID = 30;
const STORED = "motiongen-prompts";

export class PromptBox {
  constructor(form, cast) {
    this._cast = cast;
    this._said = stored();
    this._text = make("input", {
      id: "prompt-text", type: "text", autocomplete: "off", placeholder: "a person walks forward", list: "prompt-said",
    });
    this._when = make("input", { id: "prompt-when", type: "number", min: 0, step: 0.5, value: 0 });
    this._seconds = make("input", { id: "prompt-seconds", type: "number", min: 0, step: 0.5, placeholder: "on" });
    this._history = make("datalist", { id: "prompt-said" });
    this._presets = make("div", { id: "presets", role: "group", "aria-label": "Presets" });
    form.append(
      make("div", { className: "row" },
        labelled("prompt", this._text), make("button", { id: "prompt-send" }, "Do it"),
        labelled("in s", this._when), labelled("for s", this._seconds)),
      this._presets, this._history,
    );
    form.addEventListener("submit", (event) => {
      event.preventDefault();
      this._say({ text: this._text.value });
    });
    cast.addEventListener("catalog", () => this._showPresets());
    cast.addEventListener("choice", () => this._showPresets());
    this._showSaid();
  }

  focus() {
    this._text.focus();
    this._text.select();
  }

  async _say(prompt) {
    const member = this._cast.one;
    const message = { op: "set_prompt", ...prompt };
    const wait = Number(this._when.value), lasts = Number(this._seconds.value);
    if (member && (wait > 0 || lasts > 0)) {
      message.frame = frameIn(member, wait);
      if (lasts > 0) message.end_frame = message.frame + Math.max(Math.round(lasts * member.rig.frameRate), 1);
    }
    const answer = await trying(() => this._cast.tell(message));
    if (!answer) return;
    if (prompt.text) this._remember(prompt.text.trim());
    if (message.frame !== undefined) note(`from frame ${message.frame} on`);
    this._when.value = "0";
    this._seconds.value = "";
  }

  _remember(text) {
    this._said = [text, ...this._said.filter((each) => each !== text)].slice(0, MOST_SAID);
    try {
      localStorage.setItem(STORED, JSON.stringify(this._said));
    } catch {
      // this browser stores nothing for pages: earlier prompts are offered until it is closed
    }
    this._showSaid();
  }

  _showSaid() {
    this._history.replaceChildren(...this._said.map((text) => make("option", { value: text })));
  }

  _showPresets() {
    const model = this._cast.model(this._cast.one?.info.model) ?? this._cast.models[0];
    if (!model) return;
    this._presets.replaceChildren(...model.presets.map(({ id, text, expect }) =>
      make("button", { type: "button", className: "preset", title: `${text}. ${expect}`, dataset: { preset: id },
        onclick: () => this._say({ preset: id }) }, id)));
  }
}

/** Earlier prompts, as far as this browser has stored them and the stored value is valid. */
function stored() {
  try {
    const said = JSON.parse(localStorage.getItem(STORED));
    return Array.isArray(said) ? said.filter((each) => typeof each === "string").slice(0, MOST_SAID) : [];
  } catch {
    return [];
  }
}
