// Rig: a skeleton, and its joints' positions from a frame's row.
import { Quaternion, Vector3 } from "three";

const UP = new Vector3(0, 1, 0);
const LEAST_BONE_M = 0.012;
const LIMB = /(hand|foot)$/i;

// Radius of the bone that begins at a joint, metres; the first match decides.
const RADII = [
  [/head/i, 0.095], [/neck/i, 0.05], [/hips|pelvis|waist/i, 0.085], [/spine|chest|torso/i, 0.1],
  [/upleg|thigh|hip/i, 0.075], [/leg|knee|shin/i, 0.055], [/toe/i, 0.035], [/foot|ankle/i, 0.042],
  [/shoulder|clavicle|collar/i, 0.05], [/forearm|elbow/i, 0.038], [/arm/i, 0.045], [/hand|wrist/i, 0.033],
];

export class Rig {
  /** described: as the bridge sends it. positions (3J) metres and turns (4J, x y z w) are those of the last `pose`. */
  constructor(described) {
    Object.assign(this, {
      id: described.id, joints: described.joints, parents: described.parents, frameRate: described.frame_rate_hz,
      rowWidth: described.row_width, columns: described.columns, limbs: described.limbs, hipJoints: described.hip_joints,
    });
    this.numJoints = this.joints.length;
    this.offsets = described.offsets_m.map((offset) => new Vector3(...offset));
    this.positions = new Float32Array(3 * this.numJoints);
    this.turns = new Float32Array(4 * this.numJoints);
    this.bones = this._makeBones();
    this._rotations = this.columns.joint_rotation_quat_wxyz[0];
    this._root = this.columns.root_translation_m[0];
    this._contacts = this.columns.foot_contact?.[0] ?? -1;
    /** Joints of left heel, left toe, right heel, right toe, in the order of contacts; undefined if there is none. */
    this.feet = ["LeftFoot", "RightFoot"].flatMap((name) => [0, 1].map((n) => this.limbs[name]?.[n]));
    /** Joints at the ends of limbs, by which hands and feet are dragged. */
    this.ends = Object.entries(this.limbs).filter(([name]) => LIMB.test(name)).map(([, joints]) => joints[0]);
  }

  /** Forward kinematics of a row: G_j = G_parent q_j, p_j = p_parent + G_parent o_j. */
  pose(row) {
    const { positions: p, turns: g, parents, offsets } = this;
    for (let joint = 0; joint < this.numJoints; joint++) {
      const at = this._rotations + 4 * joint;
      const w = row[at], x = row[at + 1], y = row[at + 2], z = row[at + 3];
      const parent = parents[joint];
      const to = 4 * joint;
      if (parent < 0) {
        for (let axis = 0; axis < 3; axis++) p[3 * joint + axis] = row[this._root + axis];
        g[to] = x; g[to + 1] = y; g[to + 2] = z; g[to + 3] = w;
        continue;
      }
      const q = 4 * parent;
      const a = g[q], b = g[q + 1], c = g[q + 2], d = g[q + 3];
      g[to] = d * x + a * w + b * z - c * y;
      g[to + 1] = d * y - a * z + b * w + c * x;
      g[to + 2] = d * z + a * y - b * x + c * w;
      g[to + 3] = d * w - a * x - b * y - c * z;
      const o = offsets[joint];
      const ux = b * o.z - c * o.y + d * o.x, uy = c * o.x - a * o.z + d * o.y, uz = a * o.y - b * o.x + d * o.z;
      p[3 * joint] = p[3 * parent] + o.x + 2 * (b * uz - c * uy);
      p[3 * joint + 1] = p[3 * parent + 1] + o.y + 2 * (c * ux - a * uz);
      p[3 * joint + 2] = p[3 * parent + 2] + o.z + 2 * (a * uy - b * ux);
    }
  }

  /** Displace the last pose over the ground, metres. */
  shift(x, z) {
    for (let at = 0; at < this.positions.length; at += 3) {
      this.positions[at] += x;
      this.positions[at + 2] += z;
    }
  }

  /** World position of a joint of the last pose. */
  position(joint, target = new Vector3()) {
    return target.fromArray(this.positions, 3 * joint);
  }

  /** Ground position of the root in a row: [x, z], metres. */
  rootOf(row) {
    return [row[this._root], row[this._root + 2]];
  }

  /** Left heel, left toe, right heel, right toe of a row: whether on the ground. */
  contactsOf(row) {
    return this._contacts < 0 ? [] : Array.from(row.subarray(this._contacts, this._contacts + 4), (v) => v > 0.5);
  }

  /** Heading of the last pose: radians about +Y, 0 toward +Z, from the line of the hips. */
  heading() {
    if (!this.hipJoints) {
      const [x, y, z, w] = this.turns;
      return Math.atan2(2 * (x * z + w * y), 1 - 2 * (x * x + y * y));
    }
    const [right, left] = this.hipJoints.map((joint) => this.position(joint));
    return Math.atan2(right.z - left.z, -(right.x - left.x));
  }

  /** What is drawn: bones from a joint along a direction, in the joint's own axes. */
  _makeBones() {
    const bones = [];
    const isParent = new Set(this.parents);
    const add = (joint, along, length, radius, width = radius) =>
      bones.push({ joint, length, radius, width, turn: new Quaternion().setFromUnitVectors(UP, along.clone().normalize()) });
    for (let joint = 1; joint < this.numJoints; joint++) {
      const parent = this.parents[joint];
      const length = this.offsets[joint].length();
      if (length < LEAST_BONE_M) continue;
      const isTrunkToLimb = /hips|pelvis/i.test(this.joints[parent]) && /leg|thigh/i.test(this.joints[joint]);
      add(parent, this.offsets[joint], length, isTrunkToLimb ? 0.07 : radiusOf(this.joints[parent]));
    }
    for (let joint = 1; joint < this.numJoints; joint++) {
      if (isParent.has(joint)) continue;
      if (/head/i.test(this.joints[joint])) {
        add(joint, UP, 0.21, 0.095);
        add(joint, new Vector3(0, 0.45, 1), 0.15, 0.022); // a nose: which way it looks
      } else if (/toe/i.test(this.joints[joint])) add(joint, new Vector3(0, 0, 1), 0.06, 0.033);
    }
    return bones;
  }
}

function radiusOf(name) {
  return RADII.find(([pattern]) => pattern.test(name))?.[1] ?? 0.04;
}
