// Takes: download what was played; open a motion file, a session file or a list of constraints.
import { openScene, OpenedMotion } from "../motion/opened.js";
import { Rig } from "../motion/rig.js";
import { splitRows, unpack } from "../net/messages.js";
import { make, note, trying } from "./dom.js";

const FORMATS = ["npz", "bvh", "glb", "session.json", "constraints.json"];
const BESIDE_M = 1.2;
const MOST_SAID = 200;

export class Takes extends EventTarget {
  /** Event: "opened", whenever `opened` has changed. scene: a three.js scene. */
  constructor(cast, room, token, scene) {
    super();
    Object.assign(this, { _cast: cast, _room: room, _scene: scene });
    this._headers = { Authorization: `Bearer ${token}` };
    this.opened = []; // instances of the classes in motion/opened.js
    const buttons = FORMATS.map((format) =>
      make("button", { className: "preset", dataset: { take: format }, onclick: () => trying(() => this._save(format)) }, format));
    this._file = make("input", { type: "file", id: "open-file", accept: ".npz,.bvh,.csv,.glb,.json", onchange: () => trying(() => this._open()) });
    this._list = make("ul", { id: "opened" });
    this.element = make(
      "section", { "aria-label": "Takes" }, make("h2", {}, "Save what was played as"), make("div", { id: "takes" }, ...buttons),
      make("label", { className: "steering" }, make("span", {}, "open a motion, a session file or constraints"), this._file), this._list,
    );
  }

  /** Draw the opened motions, looped, side by side; except the one that is drawn elsewhere. */
  draw(bodies, nowMs, elsewhere = null) {
    this.opened.forEach((one, n) => {
      if (one !== elsewhere) one.draw(bodies, ((nowMs - one.fromMs) / 1000) * one.frameRate % one.numFrames, BESIDE_M * (n + 1), 0);
    });
  }

  async _save(format) {
    const member = this._cast.one;
    if (!member) throw new Error("no character is chosen");
    const name = `${member.info.name.replaceAll(/[^\w-]+/g, "-")}.${format}`;
    const answer = await this._fetch(`take/${this._room}/${member.number}/${name}`);
    const link = make("a", { href: URL.createObjectURL(await answer.blob()), download: name });
    link.click();
    setTimeout(() => URL.revokeObjectURL(link.href), 10_000);
    note([`saved ${name}`, answer.headers.get("X-Warnings")].filter(Boolean).join("; "));
  }

  async _open() {
    const [file] = this._file.files;
    if (!file) return;
    try {
      if (/\.json$/i.test(file.name)) await this._load(file);
      else if (/\.glb$/i.test(file.name)) this._add(await openScene(file.name, await file.arrayBuffer(), this._scene));
      else this._add(await this._read(file));
    } finally {
      this._file.value = "";
    }
  }

  _send(address, body) {
    return this._fetch(address, { method: "POST", body });
  }

  /** A successful answer. Otherwise throws the message of the bridge, or of a proxy before it. */
  async _fetch(address, how = {}) {
    const answer = await fetch(address, { ...how, headers: this._headers }).catch(() => {
      throw new Error("the bridge does not answer; is it running?");
    });
    if (answer.ok) return answer;
    const said = await answer.text();
    const isJson = answer.headers.get("Content-Type")?.startsWith("application/json");
    throw new Error((isJson ? JSON.parse(said).error : said.slice(0, MOST_SAID)) || `the bridge answers ${answer.status}`);
  }

  async _read(file) {
    const answer = await this._send(`motion?name=${encodeURIComponent(file.name)}`, file);
    const { header, rows } = unpack(await answer.arrayBuffer());
    const rig = new Rig(header.rig);
    return new OpenedMotion(header.name, rig, splitRows(rows, rig.rowWidth, 0, header.num_frames));
  }

  /** A session file is replayed by a new character; a list of constraints is for the chosen one. */
  async _load(file) {
    const held = parsed(file.name, await file.text());
    if (!Array.isArray(held)) {
      const answer = await (await this._send(`session/${this._room}?name=${encodeURIComponent(file.name)}`, file)).json();
      note(`${file.name} is replayed by character ${answer.numbers[0]}`);
      return;
    }
    const member = this._cast.one;
    if (!member) throw new Error("choose the character that these constraints are for");
    const list = `constraints/${this._room}/${member.number}?name=${encodeURIComponent(file.name)}`;
    const answer = await (await this._send(list, file)).json();
    note(`${answer.count} constraints of ${file.name}, from now on`);
  }

  _add(one) {
    this.opened.push(one);
    this._showOpened();
  }

  _showOpened() {
    this._list.replaceChildren(...this.opened.map((one) => {
      const close = () => {
        one.dispose();
        this.opened.splice(this.opened.indexOf(one), 1);
        this._showOpened();
      };
      const button = make("button", { className: "small", title: `Close ${one.name}`, onclick: close }, "×");
      button.setAttribute("aria-label", button.title);
      return make("li", {}, `${one.name}, ${one.numFrames} frames `, button);
    }));
    this.dispatchEvent(new Event("opened"));
  }
}

function parsed(name, text) {
  try {
    return JSON.parse(text);
  } catch (error) {
    throw new Error(`${name} is neither a session file nor a list of constraints, which are JSON: ${error.message}`);
  }
}
