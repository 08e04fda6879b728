// Finds the body under the pointer from the roots' places on the screen: as cheap for 200 characters as for one.
import { Vector3 } from "three";

const REACH_M = 0.95; // from the root to head or feet
const ASIDE = 0.4; // fraction of REACH_M to the sides

export class Pick {
  constructor(stage) {
    this._stage = stage;
    this._roots = [];
    this._point = new Vector3();
  }

  /** After `begin`, `add` is called for each body that is drawn. */
  begin() {
    this._roots.length = 0;
  }

  add(owner, rig) {
    this._roots.push([owner, rig.positions[0], rig.positions[1], rig.positions[2]]);
  }

  /** The character under a pointer that is nearest to the camera, or null. */
  at(event) {
    const box = this._stage.canvas.getBoundingClientRect();
    const [px, py] = [event.clientX - box.left, event.clientY - box.top];
    let best = null, nearest = Infinity;
    for (const [owner, x, y, z] of this._roots) {
      const away = this._point.set(x, y, z).distanceTo(this._stage.camera.position);
      if (away >= nearest) continue;
      const root = this._stage.onScreen(this._point);
      const head = this._stage.onScreen(this._point.set(x, y + REACH_M, z));
      if (!root || !head) continue;
      const reach = Math.max(Math.hypot(head[0] - root[0], head[1] - root[1]), 4);
      if (Math.abs(py - root[1]) < reach && Math.abs(px - root[0]) < ASIDE * reach) [best, nearest] = [owner, away];
    }
    return best;
  }
}
