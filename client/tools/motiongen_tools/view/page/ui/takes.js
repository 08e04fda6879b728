// Takes: download what was played, open a motion file and see it played beside.
import { Rig } from "../motion/rig.js";
import { splitRows, unpack } from "../net/messages.js";
import { make, note, trying } from "./dom.js";

const FORMATS = ["npz", "bvh", "glb", "session.json", "constraints.json"];

export class Takes {
  constructor(cast, room, token) {
    this._cast = cast;
    this._room = room;
    this._headers = { Authorization: `Bearer ${token}` };
    this.opened = []; // {name, rig, rows, fromMs}
    const buttons = FORMATS.map((format) =>
      make("button", { className: "preset", dataset: { take: format }, onclick: () => trying(() => this._save(format)) }, format));
    this._file = make("input", { type: "file", id: "open-file", accept: ".npz,.bvh,.csv", onchange: () => trying(() => this._open()) });
    this._list = make("ul", { id: "opened" });
    this.element = make(
      "section", { "aria-label": "Takes" }, make("h2", {}, "Save what was played as"), make("div", { id: "takes" }, ...buttons),
      make("label", { className: "steering" }, make("span", {}, "open a motion file"), this._file), this._list,
    );
  }

  /** Draw the opened motions, looped. */
  draw(bodies, nowMs) {
    this.opened.forEach(({ rig, rows, fromMs }, n) => {
      const frame = Math.floor(((nowMs - fromMs) / 1000) * rig.frameRate) % rows.length;
      rig.pose(rows[frame]);
      for (let joint = 0; joint < rig.numJoints; joint++) rig.positions[3 * joint] += 1.2 * (n + 1); // beside the others
      bodies.add(rig, 0xcfd6de, null);
    });
  }

  async _save(format) {
    const member = this._cast.one;
    if (!member) throw new Error("no character is chosen");
    const name = `${member.info.name.replaceAll(/[^\w-]+/g, "-")}.${format}`;
    const answer = await fetch(`take/${this._room}/${member.number}/${name}`, { headers: this._headers });
    if (!answer.ok) throw new Error((await answer.json()).error);
    const link = make("a", { href: URL.createObjectURL(await answer.blob()), download: name });
    link.click();
    setTimeout(() => URL.revokeObjectURL(link.href), 10_000);
    note([`saved ${name}`, answer.headers.get("X-Warnings")].filter(Boolean).join("; "));
  }

  async _open() {
    const [file] = this._file.files;
    if (!file) return;
    const answer = await fetch(`motion?name=${encodeURIComponent(file.name)}`, { method: "POST", body: file, headers: this._headers });
    if (!answer.ok) throw new Error(answer.status === 401 ? await answer.text() : (await answer.json()).error);
    const { header, rows } = unpack(await answer.arrayBuffer());
    const rig = new Rig(header.rig);
    const one = { name: header.name, rig, rows: splitRows(rows, rig.rowWidth, 0, header.num_frames), fromMs: performance.now() };
    this.opened.push(one);
    this._file.value = "";
    this._showOpened();
  }

  _showOpened() {
    this._list.replaceChildren(...this.opened.map((one) => {
      const close = () => {
        this.opened.splice(this.opened.indexOf(one), 1);
        this._showOpened();
      };
      return make("li", {}, `${one.name}, ${one.rows.length} frames `, make("button", { className: "small", title: `Close ${one.name}`, onclick: close }, "×"));
    }));
  }
}
