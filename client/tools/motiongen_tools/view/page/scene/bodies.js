// Bodies: all characters in one instanced mesh, with one instance per bone; one draw call for any number of them.
import * as THREE from "three";

const PROFILE = [[0, -0.06], [0.55, -0.04], [0.92, 0.06], [1, 0.25], [0.9, 0.7], [0.78, 0.95], [0.45, 1.04], [0, 1.06]];
const COLOURS = [0xf2a65a, 0x6fb3e0, 0x8fd18a, 0xe58aa5, 0xb79ae0, 0xe0cf6a, 0x6fd0c4, 0xd99a76];
const FEW_POINTS = [[0, -0.06], [1, 0.25], [0.8, 0.95], [0, 1.06]];
const MOST_FINE = 24; // most characters whose bones are drawn round; in a larger crowd they look small
const GROWTH = 1.5;

export function colourOf(number) {
  return COLOURS[(number - 1) % COLOURS.length];
}

export class Bodies {
  constructor(scene, { opacity = 1, castShadow = true } = {}) {
    this._scene = scene;
    const turned = (points, sides) => new THREE.LatheGeometry(points.map(([x, y]) => new THREE.Vector2(x, y)), sides);
    this._fine = turned(PROFILE, 9);
    this._coarse = turned(FEW_POINTS, 5);
    this._material = new THREE.MeshLambertMaterial({ transparent: opacity < 1, opacity, depthWrite: opacity === 1 });
    this._castShadow = castShadow;
    this._room = 0;
    this._used = 0;
    this._count = 0;
    this._grow(64);
    this._matrix = new THREE.Matrix4();
    this._turn = new THREE.Quaternion();
    this._scale = new THREE.Vector3();
    this._place = new THREE.Vector3();
    this._colour = new THREE.Color();
  }

  /** Between `begin` and `end`, `add` is called for each character. */
  begin() {
    this._used = 0;
    this._count = 0; // characters
  }

  /** Add a character, whose rig has been posed. */
  add(rig, colour) {
    const bones = rig.bones;
    if (this._used + bones.length > this._room) this._grow(GROWTH * (this._used + bones.length));
    this._colour.set(colour);
    for (const bone of bones) {
      this._turn.fromArray(rig.turns, 4 * bone.joint).multiply(bone.turn);
      this._matrix.compose(
        this._place.fromArray(rig.positions, 3 * bone.joint), this._turn,
        this._scale.set(bone.width, bone.length, bone.radius),
      );
      this.mesh.setMatrixAt(this._used, this._matrix);
      this.mesh.setColorAt(this._used, this._colour);
      this._used++;
    }
    this._count++;
  }

  end() {
    this.mesh.geometry = this._count > MOST_FINE ? this._coarse : this._fine;
    this.mesh.count = this._used;
    this.mesh.instanceMatrix.needsUpdate = true;
    if (this.mesh.instanceColor) this.mesh.instanceColor.needsUpdate = true;
  }

  _grow(room) {
    const before = this.mesh;
    this._room = Math.ceil(room);
    this.mesh = new THREE.InstancedMesh(this._fine, this._material, this._room);
    this.mesh.instanceMatrix.setUsage(THREE.DynamicDrawUsage);
    this.mesh.castShadow = this._castShadow;
    this.mesh.frustumCulled = false;
    if (before) {
      for (let n = 0; n < this._used; n++) {
        before.getMatrixAt(n, (this._copied ??= new THREE.Matrix4()));
        this.mesh.setMatrixAt(n, this._copied);
        before.getColorAt(n, (this._copiedColour ??= new THREE.Color()));
        this.mesh.setColorAt(n, this._copiedColour);
      }
      before.removeFromParent();
      before.dispose();
    }
    this._scene.add(this.mesh);
  }
}
