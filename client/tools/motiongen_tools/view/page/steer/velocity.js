// Walking by keys and gamepad: a velocity relative to the camera, repeated while a key is held.
import { Vector3 } from "three";
import { RUN_MPS, WALK_MPS } from "./commands.js";

const KEYS = {
  KeyW: [0, 1], ArrowUp: [0, 1], KeyS: [0, -1], ArrowDown: [0, -1],
  KeyA: [-1, 0], ArrowLeft: [-1, 0], KeyD: [1, 0], ArrowRight: [1, 0],
};
const AGAIN_MS = 200; // a NEAR session is replanned five times a second at most
const HOLD_S = 0.8;
const STAND_S = 1.0;
const DEAD_ZONE = 0.2;

export class Velocity {
  /** say: sends a message to the chosen character. canSteer: whether that is allowed now. keepsPrompt: keep its prompt. */
  constructor(stage, say, canSteer, keepsPrompt) {
    this._stage = stage;
    this._say = say;
    this._canSteer = canSteer;
    this._keepsPrompt = keepsPrompt;
    this._held = new Set();
    this._last = null;
    this._saidMs = 0;
    this.isRunning = false;
    this.isStrafing = false;
    addEventListener("keydown", (event) => this._press(event, true));
    addEventListener("keyup", (event) => this._press(event, false));
    addEventListener("blur", () => this._held.clear());
    document.addEventListener("visibilitychange", () => document.hidden && this._held.clear());
  }

  /** Called for every frame drawn: send a change, or repeat what lasts. */
  update(nowMs) {
    const wanted = this._canSteer() ? this._wanted() : null;
    if (!wanted && !this._last) return;
    if (!wanted) {
      this._send({ op: "set_velocity", x_mps: 0, z_mps: 0, seconds: STAND_S }, nowMs);
      this._last = null;
      return;
    }
    if (this._last && nowMs - this._saidMs < AGAIN_MS) return;
    const ahead = this._ahead();
    const heading = this.isStrafing ? Math.atan2(ahead.x, ahead.z) : null; // null: where it goes, turning first
    this._last = { ...wanted, heading };
    this._send({ op: "set_velocity", x_mps: wanted.x, z_mps: wanted.z, seconds: HOLD_S, heading_rad: heading }, nowMs);
  }

  _send(message, nowMs) {
    this._saidMs = nowMs;
    this._say(this._keepsPrompt() ? { ...message, keep_prompt: true } : message);
  }

  _press(event, isDown) {
    this.isRunning = event.shiftKey;
    this.isStrafing = event.altKey;
    if (event.key === "Meta") this._held.clear(); // macOS does not report other keys that are released meanwhile
    if (!isDown) this._held.delete(event.code); // wherever the focus is now, and whichever modifiers are held
    if (!KEYS[event.code] || event.ctrlKey || event.metaKey || isTyping(event.target)) return;
    event.preventDefault();
    if (isDown) this._held.add(event.code);
  }

  /** Metres a second in the world, or null if nothing is held. */
  _wanted() {
    let [right, ahead] = [0, 0];
    for (const code of this._held) {
      right += KEYS[code][0];
      ahead += KEYS[code][1];
    }
    let mps = this.isRunning ? RUN_MPS : WALK_MPS;
    const pad = navigator.getGamepads?.().find((each) => each && each.axes.length >= 2);
    if (pad && !right && !ahead) {
      [right, ahead] = [pad.axes[0], -pad.axes[1]];
      const tilt = Math.hypot(right, ahead);
      if (tilt < DEAD_ZONE) return null;
      mps = (pad.buttons[0]?.pressed ? RUN_MPS : WALK_MPS) * Math.min(tilt, 1);
    }
    const length = Math.hypot(right, ahead);
    if (!length) return null;
    const forward = this._ahead();
    const side = new Vector3(-forward.z, 0, forward.x);
    const way = forward.multiplyScalar(ahead).addScaledVector(side, right).setLength(mps);
    return { x: way.x, z: way.z };
  }

  /** The direction of the camera over the ground. */
  _ahead() {
    return this._stage.camera.getWorldDirection(new Vector3()).setY(0).normalize();
  }
}

/** Whether keys belong to an input field, not to the stage. A checkbox only needs Space. */
export function isTyping(element) {
  return element instanceof HTMLElement && (element.matches("input:not([type=checkbox], [type=file]), textarea, select") || element.isContentEditable);
}
