// Track: the past and planned frames of one character by number, and the clock that plays them.

const LONGEST_S = 180; // how much of the played motion a page keeps
const SNAP_S = 0.15;
const SLEW = 0.12;

export class Track {
  constructor(rig) {
    this.rig = rig;
    this.first = 0; // frame of rows[0]
    this.rows = [];
    this.committedTo = 0;
    this.replaced = null; // {first, rows}: the plan that a newer one replaced
    this._place = 0;
    this._pace = 0;
    this._atMs = performance.now();
    this._mixed = new Float32Array(rig.rowWidth);
  }

  get end() {
    return this.first + this.rows.length;
  }

  /** Add frames from `first` on, replacing all from there on. */
  put(first, rows) {
    if (!rows.length && first >= this.end) return;
    if (first > this.end || first < this.first) {
      this.first = first; // a gap, after the connection was lost: the frames before it are of no use
      this.rows = [];
    }
    const gone = this.rows.splice(first - this.first);
    if (gone.length && rows.length) this.replaced = { first, rows: gone, atMs: performance.now() };
    this.rows.push(...rows);
  }

  /** Add older frames before the first one. */
  putHistory(first, rows) {
    if (first < this.first && first + rows.length >= this.first) {
      this.rows.unshift(...rows.slice(0, this.first - first));
      this.first = first;
    }
  }

  /** Take the bridge's playhead; small differences are corrected gradually, without a jump. */
  setHead(place, pace, committedTo, nowMs) {
    const here = this.playhead(nowMs);
    const error = place - here;
    this._place = Math.abs(error) > SNAP_S * this.rig.frameRate || pace === 0 ? place : here + SLEW * error;
    this._pace = pace;
    this._atMs = nowMs;
    this.committedTo = committedTo;
    const surplus = Math.floor(place) - LONGEST_S * this.rig.frameRate - this.first;
    if (surplus > 200) {
      this.rows.splice(0, surplus);
      this.first += surplus;
    }
  }

  /** The frame shown now, with the fraction of the way to the next; never beyond the frames there are. */
  playhead(nowMs = performance.now()) {
    const place = this._place + ((nowMs - this._atMs) / 1000) * this._pace;
    return Math.max(Math.min(place, this.end - 1), this._place > this.end - 1 ? this.end - 1 : 0);
  }

  /** Frames a second at present; 0 while paused or held. */
  get pace() {
    return this._pace;
  }

  row(frame) {
    return this.rows[frame - this.first];
  }

  /** The interpolated row between frames, or null. The same array each time. */
  sample(place) {
    const frame = Math.min(Math.max(Math.floor(place), this.first), this.end - 1);
    const here = this.row(frame);
    const next = this.row(frame + 1);
    const share = place - frame;
    if (!here || !next || share <= 0) return here ?? null;
    return this._mix(here, next, share);
  }

  _mix(here, next, share) {
    const mixed = this._mixed;
    const [start, stop] = this.rig.columns.joint_rotation_quat_wxyz;
    mixed.set(share > 0.5 ? next : here);
    const root = this.rig.columns.root_translation_m[0];
    for (let axis = root; axis < root + 3; axis++) mixed[axis] = here[axis] + share * (next[axis] - here[axis]);
    for (let at = start; at < stop; at += 4) {
      let dot = 0;
      for (let n = 0; n < 4; n++) dot += here[at + n] * next[at + n];
      const far = dot < 0 ? -share : share; // the shorter way; between two frames, a line is close to the arc
      let length = 0;
      for (let n = 0; n < 4; n++) {
        mixed[at + n] = (1 - share) * here[at + n] + far * next[at + n];
        length += mixed[at + n] ** 2;
      }
      length = Math.sqrt(length);
      for (let n = 0; n < 4; n++) mixed[at + n] /= length;
    }
    return mixed;
  }
}
