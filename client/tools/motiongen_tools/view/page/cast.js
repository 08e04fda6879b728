// Cast: the characters of the room, the server's catalogue, and which character is chosen.
import { Rig } from "./motion/rig.js";
import { Track } from "./motion/track.js";
import { splitRows } from "./net/messages.js";

export class Cast extends EventTarget {
  /** Events: "catalog", "members", "choice", "server", "member" (detail: one of `members`). */
  constructor(connection) {
    super();
    this.members = new Map(); // number -> {number, rig, track, info}
    this.models = [];
    this.limits = {};
    this.role = "control";
    this.server = { state: "connecting", address: "", detail: "" };
    this.chosen = null;
    this._rigs = new Map();
    this._connection = connection;
    connection.addEventListener("message", (event) => this._hear(event.detail));
    connection.addEventListener("binary", (event) => this._hearRows(event.detail));
  }

  /** The chosen member, or undefined. */
  get one() {
    return this.members.get(this.chosen);
  }

  choose(number) {
    if (number === this.chosen || (number !== null && !this.members.has(number))) return;
    this.chosen = number;
    this._tell("choice");
  }

  /** Send a message to the chosen character; resolves with the answer. */
  tell(message) {
    if (this.chosen === null) return Promise.reject(new Error("no character is chosen; add one"));
    return this._connection.ask({ ...message, character: this.chosen });
  }

  ask(message) {
    return this._connection.ask(message);
  }

  /** Ask for frames that were played before this page was opened. */
  askHistory(member, first, end) {
    return this.ask({ op: "history", character: member.number, first_frame: first, end_frame: end });
  }

  model(id) {
    return this.models.find((model) => model.id === id);
  }

  _hear(message) {
    switch (message.type) {
      case "server":
        this.role = message.role;
        this.server = message;
        this._tell("server");
        break;
      case "catalog": // sent again whenever it changes; existing characters keep their rigs
        this._rigs = new Map(message.rigs.map((rig) => [rig.id, new Rig(rig)]));
        this.models = message.models;
        this.limits = message.limits;
        this._tell("catalog");
        break;
      case "characters":
        this._keep(new Set(message.numbers));
        break;
      case "character":
        this._note(message);
        break;
    }
  }

  _keep(numbers) {
    for (const number of this.members.keys()) if (!numbers.has(number)) this.members.delete(number);
    if (!this.members.has(this.chosen)) {
      this.chosen = this.members.keys().next().value ?? null;
      this._tell("choice");
    }
    this._tell("members");
  }

  _note(info) {
    let member = this.members.get(info.number);
    if (!member || member.info.seed !== info.seed) { // a restarted bridge reuses numbers
      const rig = this._rigs.get(info.rig) ?? (info.described && new Rig(info.described)); // one not offered any more
      if (!rig) return; // the catalogue has not arrived yet
      member = { number: info.number, rig, track: new Track(rig), info };
      this.members.set(info.number, member);
      this.members = new Map([...this.members].sort(([a], [b]) => a - b));
      if (this.chosen === null) this.choose(info.number);
      this._tell("members");
    }
    member.info = info;
    this._tell("member", member);
  }

  _hearRows({ header, rows }) {
    const nowMs = performance.now();
    if (header.type === "history") {
      const member = this.members.get(header.character);
      member?.track.putHistory(header.first_frame, splitRows(rows, member.rig.rowWidth, 0, header.num_frames));
      return;
    }
    let at = 0;
    header.heads.forEach(([number, place, pace, committedTo, , first, count], n) => {
      const member = this.members.get(number), width = header.widths[n];
      const own = rows.subarray(at, at + count * width);
      at += count * width;
      if (!member) return; // it was removed, or is not known yet
      if (count) member.track.put(first, splitRows(own, width, 0, count));
      member.track.setHead(place, pace, committedTo, nowMs);
    });
  }

  _tell(name, detail) {
    this.dispatchEvent(new CustomEvent(name, { detail }));
  }
}
