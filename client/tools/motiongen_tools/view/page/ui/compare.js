// Compare two takes at the same time, of two characters or of one and a file; and repeat a take with other options.
// Times are counted in frames of the first take; the frame rate of the second may differ.
import * as THREE from "three";
import { colourOf } from "../scene/bodies.js";
import { labelled, make, note, trying } from "./dom.js";

const APART_M = 0.75;
const BESIDE = "beside";

export class Compare {
  constructor(cast, takes) {
    Object.assign(this, { _cast: cast, _takes: takes });
    this.pair = null; // [a, b]: members, or opened motions
    this.frame = 0;
    this._side = new THREE.Vector3();
    this._other = make("select", { id: "compare-with" });
    this._how = make("select", { id: "compare-how" }, make("option", { value: BESIDE }, "side by side"), make("option", { value: "over" }, "laid over"));
    this._start = make("button", { id: "compare", onclick: () => this.toggle() }, "Compare");
    this._said = make("output", { id: "compare-said" });
    this._steps = make("input", { id: "again-steps", type: "number", min: 1, placeholder: "same" });
    this._model = make("select", { id: "again-model" });
    const again = make("button", { id: "again", title: "another character with the same seed and the same edits at the same frames", onclick: () => this._again() }, "Again");
    this.element = make(
      "details", { id: "compare-panel" }, make("summary", {}, "Compare takes"),
      make("div", { className: "row steering" }, labelled("model", this._model), labelled("steps", this._steps), again),
      make("div", { className: "row" }, labelled("with", this._other), labelled("how", this._how), this._start), this._said,
    );
    for (const name of ["members", "choice", "catalog"]) cast.addEventListener(name, () => this._list());
    takes.addEventListener("opened", () => this._list());
    this._list();
  }

  holds(one) {
    return this.pair !== null && this.pair.includes(one);
  }

  toggle() {
    if (this.pair) this._end();
    else trying(async () => this._begin());
  }

  /** Start comparing the chosen character with another one or an opened file. */
  _begin() {
    const [kind, key] = [this._other.value[0], Number(this._other.value.slice(1))];
    const other = kind === "c" ? this._cast.members.get(key) : this._takes.opened[key];
    if (!this._cast.one || !other) throw new Error("there is nothing to compare with: make a take again, or open a file");
    this.pair = [this._cast.one, other];
    for (const one of this.pair) {
      if (one.info && one.track.first > one.info.first_kept) trying(() => this._cast.askHistory(one, one.info.first_kept, one.track.first));
    }
    this.frame = this._range()[0];
    this._start.textContent = "Stop comparing";
  }

  _end() {
    this.pair = null;
    this._start.textContent = "Compare";
    this._said.value = "";
  }

  /** Move to the current frame. seek: the frame that is looked at on the timeline, or null. */
  update(spentS, seek) {
    if (!this.pair) return;
    if (this.pair.some((one) => (one.info ? this._cast.members.get(one.number) !== one : !this._takes.opened.includes(one)))) {
      this._end();
      return;
    }
    const [first, last] = this._range();
    const rate = this.pair[0].rig.frameRate;
    this.frame = seek ?? this.frame + spentS * rate;
    if (this.frame > last) this.frame = seek === null && !this.pair.some((one) => one.info?.is_rehearsing) ? first : last;
    this.frame = Math.max(this.frame, first);
  }

  /** First and last of the frames that both have. */
  _range() {
    const begins = this.pair.map((one) => (one.track?.first ?? 0) * this._framesPer(one));
    const ends = this.pair.map((one) => (one.info ? Math.floor(one.track.playhead()) : one.numFrames - 1) * this._framesPer(one));
    return [Math.max(...begins), Math.max(Math.min(...ends), Math.max(...begins))];
  }

  draw(bodies, ghosts, camera) {
    if (!this.pair) return;
    camera.getWorldDirection(this._side).setY(0).normalize();
    this._side.set(-this._side.z, 0, this._side.x); // to the right of the camera's view
    const apart = this._how.value === BESIDE ? APART_M : 0;
    const places = this.pair.map((one, n) => {
      const [x, z] = [this._side.x * apart * (2 * n - 1), this._side.z * apart * (2 * n - 1)];
      const into = n && !apart ? ghosts : bodies;
      if (one.info) {
        const row = one.track.sample(this._placeIn(one));
        if (!row) return null; // it has no frames yet
        one.rig.pose(row);
        one.rig.shift(x, z);
        into.add(one.rig, colourOf(one.number));
      } else one.draw(into, this._placeIn(one), x, z);
      return one.rig ? unshifted(one.rig, x, z) : null;
    });
    this._say(places);
  }

  /** Frames of the first take for each frame of a take. */
  _framesPer(one) {
    return this.pair[0].rig.frameRate / (one.frameRate ?? one.rig.frameRate);
  }

  /** The current frame, in frames of a take; may be between two. */
  _placeIn(one) {
    const place = this.frame / this._framesPer(one);
    return one.info ? place : Math.min(place, one.numFrames - 1);
  }

  _say([a, b]) {
    let said = `frame ${Math.floor(this.frame)}`;
    if (a && b && a.length === b.length) {
      let sum = 0;
      for (let at = 0; at < a.length; at += 3) sum += Math.hypot(a[at] - b[at], a[at + 1] - b[at + 1], a[at + 2] - b[at + 2]);
      const roots = Math.hypot(a[0] - b[0], a[2] - b[2]);
      said += `: roots ${(100 * roots).toFixed(1)} cm apart, joints ${((300 * sum) / a.length).toFixed(1)} cm on average`;
    }
    if (this._said.value !== said) this._said.value = said;
  }

  async _again() {
    const member = this._cast.one;
    const changes = { name: `${member?.info.name ?? ""} again` };
    if (this._steps.value) changes.steps = Number(this._steps.value);
    if (this._model.value && this._model.value !== member?.info.model) changes.model = this._model.value;
    const words = [changes.model, changes.steps && `${changes.steps} steps`].filter(Boolean).join(", ");
    if (words) changes.name += `, ${words}`;
    const answer = await trying(() => this._cast.tell({ op: "again", changes }));
    if (!answer) return;
    note(`${changes.name}: it gets the same edits, from its first frame on`);
    this._wanted = `c${answer.numbers[0]}`;
    this._list();
  }

  _list() {
    const chosen = this._cast.chosen;
    const characters = [...this._cast.members.values()].filter(({ number }) => number !== chosen)
      .map(({ number, info }) => make("option", { value: `c${number}` }, info.name));
    const files = this._takes.opened.map(({ name }, n) => make("option", { value: `f${n}` }, name));
    const before = this._wanted ?? this._other.value;
    this._other.replaceChildren(...characters, ...files);
    if ([...this._other.options].some(({ value }) => value === before)) this._other.value = before;
    if (this._other.value === this._wanted) this._wanted = undefined;
    const models = this._cast.models.map(({ id }) => id);
    if ([...this._model.options].map(({ value }) => value).join() === models.join()) return;
    this._model.replaceChildren(...models.map((id) => make("option", { value: id }, id)));
    if (models.includes(this._cast.one?.info.model)) this._model.value = this._cast.one.info.model;
  }
}

/** The joints' positions in the last pose, without its displacement on the stage. */
function unshifted(rig, x, z) {
  const where = rig.positions.slice();
  for (let at = 0; at < where.length; at += 3) {
    where[at] -= x;
    where[at + 2] -= z;
  }
  return where;
}
