// Marks on the stage: targets of the chosen character, trails, the replaced plan, feet in contact.
import * as THREE from "three";
import { labelled, make } from "../ui/dom.js";

const KEPT_AFTER_S = 3;
const TRAIL_S = 4;
const GHOST_MS = 4000;
const STATES = { waiting: 0xf2c94c, met: 0x59c36a, missed: 0xe05555, removed: 0x777777 };
const FEET = ["left heel", "left toe", "right heel", "right toe"];

export class Marks {
  constructor(scene) {
    this._group = new THREE.Group();
    this._targets = new Map(); // id -> {object, state}
    this._trail = line(0x6fb3e0);
    this._ahead = line(0xf2a65a);
    this._ghost = line(0x9aa3ad);
    this._jointTrail = line(0xb79ae0);
    this._joint = make("select", { id: "trail-joint" });
    this._feet = FEET.map(() => disc(0.07, 0x59c36a));
    this._group.add(this._trail, this._jointTrail, this._ahead, this._ghost, ...this._feet);
    scene.add(this._group);
    this.showsTrails = true;
    this.showsContacts = true;
  }

  /** The selection of a joint that leaves a trail besides the root. */
  choice(cast) {
    const show = () => {
      const joints = cast.one?.rig.joints ?? [];
      const before = this._joint.value;
      this._joint.replaceChildren(make("option", { value: "-1" }, "the root alone"), ...joints.map((name, n) => make("option", { value: n }, name)));
      if (before) this._joint.value = before;
    };
    cast.addEventListener("choice", show);
    show();
    return labelled("trail of", this._joint);
  }

  /** Called for every frame drawn. place: the frame that is shown; row: its row. */
  update(member, place, row, nowMs) {
    this._group.visible = Boolean(member && row);
    if (!this._group.visible) return;
    this._showTargets(member, place);
    this._showTrails(member, place, nowMs);
    this._showFeet(member, row);
  }

  _showTargets(member, place) {
    const kept = new Set();
    for (const target of member.info.targets) {
      const isOver = target.last !== null && target.last < place - KEPT_AFTER_S * member.rig.frameRate;
      if (isOver || target.state === "removed") continue;
      kept.add(target.id);
      const held = this._targets.get(target.id);
      if (held?.state === target.state && held.spec === JSON.stringify(target.spec)) continue;
      if (held) discard(held.object);
      const object = targetMark(target);
      this._group.add(object);
      this._targets.set(target.id, { object, state: target.state, spec: JSON.stringify(target.spec) });
    }
    for (const [id, { object }] of this._targets) {
      if (kept.has(id)) continue;
      discard(object);
      this._targets.delete(id);
    }
  }

  _showTrails(member, place, nowMs) {
    const { track, rig } = member;
    const at = Math.floor(place);
    const rows = (from, to) => track.rows.slice(Math.max(from - track.first, 0), Math.max(to - track.first, 0));
    const isShown = this.showsTrails;
    setLine(this._trail, isShown ? rows(at - TRAIL_S * rig.frameRate, at + 1) : [], rig);
    setLine(this._ahead, isShown ? rows(at, track.end) : [], rig);
    const joint = Number(this._joint.value || -1);
    const of = isShown && joint >= 0 ? rows(at - TRAIL_S * rig.frameRate, at + 1) : [];
    setPoints(this._jointTrail, of.map((each) => {
      rig.pose(each);
      return rig.positions.slice(3 * joint, 3 * joint + 3);
    }));
    if (of.length) rig.pose(track.sample(place));
    const ghost = track.replaced;
    setLine(this._ghost, isShown && ghost && nowMs - ghost.atMs < GHOST_MS ? ghost.rows : [], rig);
  }

  _showFeet(member, row) {
    const { rig } = member;
    const contacts = rig.contactsOf(row);
    this._feet.forEach((foot, n) => {
      const joint = rig.feet[n];
      foot.visible = this.showsContacts && Boolean(contacts[n]) && joint !== undefined;
      if (foot.visible) foot.position.set(rig.positions[3 * joint], 0.006, rig.positions[3 * joint + 2]);
    });
  }
}

/** Remove a mark from the stage, and free its GPU memory. */
function discard(object) {
  object.removeFromParent();
  object.traverse((each) => {
    each.geometry?.dispose();
    each.material?.dispose();
  });
}

function targetMark(target) {
  const group = new THREE.Group();
  const colour = STATES[target.state];
  const { spec } = target;
  const material = new THREE.MeshBasicMaterial({ color: colour, transparent: true, opacity: 0.85 });
  if (spec.kind === "waypoint") {
    const ring = disc(0.22, colour, 0.15);
    ring.position.set(spec.x_m, 0.008, spec.z_m);
    const pole = new THREE.Mesh(new THREE.CylinderGeometry(0.012, 0.012, 0.5), material);
    pole.position.set(spec.x_m, 0.25, spec.z_m);
    group.add(ring, pole);
    if (spec.heading_rad !== undefined) group.add(arrow(spec.x_m, spec.z_m, spec.heading_rad, colour));
  } else if (spec.kind === "trajectory" || spec.kind === "path") {
    const path = line(colour);
    const points = spec.positions_m ?? spec.corners_m;
    path.geometry.setFromPoints(points.map(([x, z]) => new THREE.Vector3(x, 0.012, z)));
    group.add(path);
  } else if (spec.positions_m) {
    for (const [x, y, z] of spec.kind === "joint_targets" ? spec.positions_m.slice(spec.joints[0] === 0 ? 1 : 0) : spec.positions_m) {
      const ball = new THREE.Mesh(new THREE.SphereGeometry(spec.kind === "keyframe" ? 0.025 : 0.06, 10, 8), material);
      ball.position.set(x, y, z);
      group.add(ball);
    }
  }
  return group;
}

function arrow(x, z, heading, colour) {
  const way = new THREE.Vector3(Math.sin(heading), 0, Math.cos(heading));
  return new THREE.ArrowHelper(way, new THREE.Vector3(x, 0.02, z), 0.5, colour, 0.15, 0.1);
}

function disc(radius, colour, inner = 0) {
  const geometry = inner ? new THREE.RingGeometry(inner, radius, 28) : new THREE.CircleGeometry(radius, 20);
  const material = new THREE.MeshBasicMaterial({ color: colour, transparent: true, opacity: 0.8 });
  return new THREE.Mesh(geometry.rotateX(-Math.PI / 2), material);
}

function line(colour) {
  const drawn = new THREE.Line(new THREE.BufferGeometry(), new THREE.LineBasicMaterial({ color: colour }));
  drawn.frustumCulled = false;
  return drawn;
}

const MOST_POINTS = 512;

function setLine(drawn, rows, rig) {
  setPoints(drawn, rows.map((row) => {
    const [x, z] = rig.rootOf(row);
    return [x, 0.01, z];
  }));
}

/** points: [[x, y, z]]; if there are too many, the last of them are drawn. */
function setPoints(drawn, points) {
  drawn.visible = points.length > 1;
  if (!drawn.visible) return;
  let places = drawn.geometry.getAttribute("position");
  if (!places) {
    places = new THREE.BufferAttribute(new Float32Array(3 * MOST_POINTS), 3).setUsage(THREE.DynamicDrawUsage);
    drawn.geometry.setAttribute("position", places);
  }
  const count = Math.min(points.length, MOST_POINTS);
  for (let n = 0; n < count; n++) places.setXYZ(n, ...points[points.length - count + n]);
  places.needsUpdate = true;
  drawn.geometry.setDrawRange(0, count);
}
