// The pointer's tools: walk there, draw a path, drag a hand or foot, turn to face, place a pose.
import * as THREE from "three";
import { HeadingRing } from "../scene/ring.js";
import { make, trying } from "../ui/dom.js";
import { goTo, leadFrames, pathAlong, rootAt } from "./commands.js";

const HANDLE_M = 0.07;
const STEP_M = 0.08;

export class Tools {
  /** inSeconds: how far ahead the target of a tool is. */
  constructor(element, stage, cast, pick, ghosts) {
    Object.assign(this, { _stage: stage, _cast: cast, _pick: pick, _ghosts: ghosts });
    this._ring = new HeadingRing(stage.scene);
    this._handles = new THREE.Group();
    this._drawn = new THREE.Line(new THREE.BufferGeometry(), new THREE.LineBasicMaterial({ color: 0xf2a65a }));
    this._drawn.frustumCulled = false;
    stage.scene.add(this._handles, this._drawn);
    this._drag = null;
    this._tools = {
      walk: ["Walk", "click the ground: walk there", { click: (event) => this._walk(event) }],
      path: ["Path", "drag over the ground: walk along it", this._pathTool()],
      limb: ["Hand, foot", "drag a ball: move the hand or foot there", this._limbTool()],
      face: ["Face", "turn the ring: face that way then, wherever the character is", this._faceTool()],
      pose: ["Pose", "drag the ghost over the ground: have this pose there", this._poseTool()],
    };
    this._seconds = make("input", { id: "tool-seconds", type: "number", min: 0.5, max: 10, step: 0.5, value: 2, title: "seconds after it takes effect" });
    this._buttons = Object.entries(this._tools).map(([name, [label, title]]) =>
      make("button", { id: `tool-${name}`, title, onclick: () => this.choose(name) }, label));
    const clear = make("button", { id: "clear", title: "remove all targets", onclick: () => trying(() => cast.tell({ op: "clear_constraints" })) }, "Clear");
    this._keeps = make("input", { type: "checkbox", id: "keep-prompt", title: "keys and stick only move the character, and keep its prompt" });
    element.append(
      ...this._buttons, make("label", { className: "inline" }, "in s", this._seconds),
      make("label", { className: "inline" }, this._keeps, "keep prompt"), clear,
    );
    this.choose("walk");
    cast.addEventListener("choice", () => this.drop()); // the drag was of another character
  }

  get current() {
    return this._tools[this._name][2];
  }

  /** Whether a velocity keeps the prompt. */
  get keepsPrompt() {
    return this._keeps.checked;
  }

  /** Cancel a drag. */
  drop() {
    this._drag = null;
    this._drawLine([]);
  }

  choose(name) {
    this._name = name;
    this.drop();
    for (const button of this._buttons) button.setAttribute("aria-pressed", String(button.id === `tool-${name}`));
  }

  /** Called for every frame drawn, with the chosen character posed. */
  update(member) {
    this._handles.visible = Boolean(member) && this._name === "limb";
    if (member && this._name === "limb" && !this._drag) this._placeHandles(member);
    const drag = this._drag;
    this._showRing(member);
    if (member && this._name === "pose") {
      const row = drag?.row ?? member.track.row(Math.min(this._frame(member), member.track.end - 1));
      if (row) {
        member.rig.pose(row);
        this._ghosts.add(member.rig, 0xffffff);
      }
    }
  }

  _showRing(member) {
    const root = member && this._name === "face" ? rootAt(member, Math.floor(member.track.playhead())) : null;
    const place = this._drag?.place;
    this._ring.show(root, place && root ? Math.atan2(place.x - root.x, place.z - root.z) : (member?.rig.heading() ?? 0));
  }

  /** World position of a tool's handle: that of the joint of this name, or of the ring's knob. */
  handleAt(name) {
    if (name === "ring") return this._ring.knobAt();
    const joint = this._cast.one?.rig.joints.indexOf(name);
    return this._handles.children.find(({ userData }) => userData.joint === joint)?.position;
  }

  /** Seconds after the edit takes effect, so that there is time for it however late that is. */
  _timing(member) {
    return { frame: Math.round((Number(this._seconds.value) || 2) * member.rig.frameRate), frames_from_effect: true };
  }

  /** The frame that a target set now will probably be for. */
  _frame(member) {
    return Math.floor(member.track.playhead()) + leadFrames(member) + this._timing(member).frame;
  }

  _say(...constraints) {
    return trying(() => this._cast.tell({ op: "add_constraints", constraints }));
  }

  _walk(event) {
    const hit = this._pick.at(event);
    if (hit !== null && hit !== this._cast.chosen) {
      this._cast.choose(hit);
      return;
    }
    const place = this._stage.groundAt(event);
    if (place && this._cast.one && this._cast.role === "control") this._say(goTo(place));
  }

  _pathTool() {
    return {
      down: (event) => {
        const place = this._stage.groundAt(event);
        this._drag = place && this._cast.one ? { points: [[place.x, place.z]] } : null;
        return Boolean(this._drag);
      },
      move: (event) => {
        const place = this._stage.groundAt(event);
        if (!place || !this._drag) return;
        const { points } = this._drag;
        const [x, z] = points[points.length - 1];
        if (Math.hypot(place.x - x, place.z - z) > STEP_M) points.push([place.x, place.z]);
        this._drawLine(points);
      },
      up: () => {
        const points = this._drag?.points ?? [];
        this._drag = null;
        this._drawLine([]);
        if (points.length > 1) this._say(pathAlong(points));
      },
    };
  }

  _limbTool() {
    return {
      down: (event) => {
        const hit = this._stage.hit(event, this._handles.children);
        this._drag = hit ? { handle: hit.object } : null;
        return Boolean(hit);
      },
      move: (event) => {
        const place = this._drag && this._stage.planeAt(event, this._drag.handle.position);
        if (place) this._drag.handle.position.set(place.x, Math.max(place.y, 0), place.z);
      },
      up: () => {
        const member = this._cast.one, handle = this._drag?.handle;
        this._drag = null;
        if (!member || !handle) return;
        const frame = this._frame(member);
        const root = rootAt(member, frame), here = rootAt(member, Math.floor(member.track.playhead()));
        const { x, y, z } = handle.position;
        // the target moves with the body to where that will be by then
        const hand = [x + root.x - here.x, y, z + root.z - here.z];
        this._say({ kind: "joint_targets", ...this._timing(member), joints: [handle.userData.joint], positions_m: [hand] });
      },
    };
  }

  _faceTool() {
    return {
      down: (event) => {
        this._drag = this._cast.one && this._stage.groundAt(event) ? { place: this._stage.groundAt(event) } : null;
        return Boolean(this._drag);
      },
      move: (event) => {
        const place = this._stage.groundAt(event);
        if (place && this._drag) this._drag.place = place;
      },
      up: () => {
        const member = this._cast.one, place = this._drag?.place;
        this._drag = null;
        if (!member || !place) return;
        const root = rootAt(member, Math.floor(member.track.playhead()));
        this._say({ kind: "heading", ...this._timing(member), heading_rad: Math.atan2(place.x - root.x, place.z - root.z) });
      },
    };
  }

  _poseTool() {
    return {
      down: (event) => {
        const member = this._cast.one, place = this._stage.groundAt(event);
        const row = member?.track.row(Math.min(this._frame(member), member.track.end - 1));
        if (!row || !place) return false;
        this._drag = { row: row.slice(), from: place, root: member.rig.rootOf(row) };
        return true;
      },
      move: (event) => {
        const place = this._stage.groundAt(event), drag = this._drag, member = this._cast.one;
        if (!place || !drag || !member) return;
        const at = member.rig.columns.root_translation_m[0];
        drag.row[at] = drag.root[0] + place.x - drag.from.x;
        drag.row[at + 2] = drag.root[1] + place.z - drag.from.z;
      },
      up: () => {
        const member = this._cast.one, drag = this._drag;
        this._drag = null;
        if (!member || !drag) return;
        member.rig.pose(drag.row);
        const positions = Array.from({ length: member.rig.numJoints }, (_, n) => Array.from(member.rig.positions.subarray(3 * n, 3 * n + 3)));
        this._say({ kind: "keyframe", ...this._timing(member), positions_m: positions });
      },
    };
  }

  /** points: [[x, z]], metres; without any, the line is removed. */
  _drawLine(points) {
    this._drawn.geometry.dispose();
    this._drawn.geometry = new THREE.BufferGeometry();
    if (points.length) this._drawn.geometry.setFromPoints(points.map(([x, z]) => new THREE.Vector3(x, 0.015, z)));
  }

  _placeHandles(member) {
    const joints = member.rig.ends;
    while (this._handles.children.length > joints.length) { // left over from another rig
      const gone = this._handles.children.at(-1);
      gone.removeFromParent();
      gone.geometry.dispose();
      gone.material.dispose();
    }
    while (this._handles.children.length < joints.length) {
      const material = new THREE.MeshBasicMaterial({ color: 0xf2c94c, transparent: true, opacity: 0.75, depthTest: false });
      this._handles.add(new THREE.Mesh(new THREE.SphereGeometry(HANDLE_M, 12, 10), material));
    }
    joints.forEach((joint, n) => {
      const handle = this._handles.children[n];
      handle.userData.joint = joint;
      member.rig.position(joint, handle.position);
    });
  }
}
