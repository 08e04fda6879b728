// The heading ring around a character's feet, with a knob in the direction that it should face.
import * as THREE from "three";

const RADIUS_M = 0.75;

export class HeadingRing {
  constructor(scene) {
    const material = new THREE.MeshBasicMaterial({ color: 0xf2a65a, transparent: true, opacity: 0.9 });
    const ring = new THREE.Mesh(new THREE.TorusGeometry(RADIUS_M, 0.018, 6, 48).rotateX(Math.PI / 2), material);
    this.knob = new THREE.Mesh(new THREE.SphereGeometry(0.08, 14, 10), material);
    this.knob.position.set(0, 0, RADIUS_M);
    this._group = new THREE.Group().add(ring, this.knob);
    this._group.visible = false;
    scene.add(this._group);
  }

  /** Show it around a place on the ground, with a heading; null hides it. */
  show(place, heading) {
    this._group.visible = Boolean(place);
    if (!place) return;
    this._group.position.set(place.x, 0.03, place.z);
    this._group.rotation.y = heading;
  }

  /** World position of the knob. */
  knobAt(target = new THREE.Vector3()) {
    this._group.updateMatrixWorld();
    return this.knob.getWorldPosition(target);
  }
}
