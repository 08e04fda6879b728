// Stage: renderer, light, ground and camera.
import * as THREE from "three";
import { OrbitControls } from "three/addons/controls/OrbitControls.js";

const GROUND_M = 400;
const TILE_PX = 128;
const LEAST_HZ = 24;
const TRIED_MS = 2500;
const LEAST_RATIO = 0.5;
const PLAIN_MS = 60; // between two frames with software rendering: the processor has other work too
const THEMES = {
  dark: { sky: 0x14171c, ground: "#2a2f37", line: "#4a5360" },
  light: { sky: 0xe9edf2, ground: "#ccd3db", line: "#9aa6b4" },
};

export class Stage {
  /** isPlain: for software rendering: no shadows, no antialiasing, fewer pixels, 15 frames a second. */
  constructor(canvas, isPlain = false) {
    this.canvas = canvas;
    this.renderer = new THREE.WebGLRenderer({ canvas, antialias: !isPlain, preserveDrawingBuffer: false });
    this.renderer.shadowMap.enabled = !isPlain;
    this.renderer.shadowMap.type = THREE.PCFShadowMap;
    this._ratio = isPlain ? LEAST_RATIO : Math.min(devicePixelRatio, 2);
    this._slowSinceMs = null;
    this._drawn = 0;
    this._pauseMs = isPlain ? PLAIN_MS : 0;
    this._drawnMs = -Infinity;
    this._shadowEvery = 1;
    this.renderer.shadowMap.autoUpdate = false;
    this.renderer.setPixelRatio(this._ratio);
    this.scene = new THREE.Scene();
    this.camera = new THREE.PerspectiveCamera(42, 1, 0.1, 300);
    this.camera.position.set(2.6, 2.1, -4.6);
    this.controls = new OrbitControls(this.camera, canvas);
    this.controls.target.set(0, 0.95, 0);
    this.controls.maxPolarAngle = Math.PI * 0.495;
    this.controls.minDistance = 1;
    this.controls.maxDistance = 80;
    this.controls.enableDamping = true;
    this._raycaster = new THREE.Raycaster();
    this._plane = new THREE.Plane(new THREE.Vector3(0, 1, 0), 0);
    this._addLight();
    this._addGround();
    new ResizeObserver(() => this._resize()).observe(canvas);
    this._resize();
  }

  setTheme(name) {
    const theme = THEMES[name];
    this.scene.background = new THREE.Color(theme.sky);
    this.scene.fog = new THREE.Fog(theme.sky, 30, 110);
    this._ground.material.map?.dispose();
    this._ground.material.map = this._tile(theme);
    this._ground.material.needsUpdate = true;
  }

  /** Let camera and target follow a place on the ground smoothly. */
  follow(place) {
    if (!isPlace(place)) return;
    const wanted = new THREE.Vector3(place.x, this.controls.target.y, place.z);
    const step = wanted.sub(this.controls.target).multiplyScalar(0.12);
    this.controls.target.add(step);
    this.camera.position.add(step);
  }

  /** Put the camera behind a place, facing in its direction, or above a crowd of some radius. */
  frame(place, heading, radiusM = 0) {
    if (!isPlace(place)) return;
    const distance = 4.6 + 2.1 * radiusM;
    this.controls.target.set(place.x, 0.95, place.z);
    this.camera.position.set(
      place.x - distance * Math.sin(heading + 0.5), 1.9 + 0.8 * radiusM, place.z - distance * Math.cos(heading + 0.5),
    );
  }

  /** Where a pointer's ray meets the ground, or null. */
  groundAt(event) {
    this._aim(event);
    return this._raycaster.ray.intersectPlane(this._plane, new THREE.Vector3());
  }

  /** What a pointer's ray meets first among objects, or null. */
  hit(event, objects) {
    this._aim(event);
    return this._raycaster.intersectObjects(objects, false)[0] ?? null;
  }

  /** Where a pointer's ray meets the plane through a point that faces the camera, or null. */
  planeAt(event, point) {
    this._aim(event);
    const normal = this.camera.getWorldDirection(new THREE.Vector3());
    const plane = new THREE.Plane().setFromNormalAndCoplanarPoint(normal, point);
    return this._raycaster.ray.intersectPlane(plane, new THREE.Vector3());
  }

  /** A point's place on the canvas: [x, y] in CSS pixels, or null behind the camera. */
  onScreen(point) {
    const seen = point.clone().project(this.camera);
    if (seen.z > 1) return null;
    return [((seen.x + 1) / 2) * this.canvas.clientWidth, ((1 - seen.y) / 2) * this.canvas.clientHeight];
  }

  /** A crowd's shadows are redrawn every second or third frame: nobody sees that, and they take half of the time. */
  setCrowd(count) {
    this._shadowEvery = count <= 20 ? 1 : count <= 60 ? 2 : 3;
  }

  /** Reduce the quality if this machine does not keep up: first no shadows, then fewer pixels. */
  adapt(rateHz, nowMs) {
    this._slowSinceMs = rateHz >= LEAST_HZ || document.hidden ? null : (this._slowSinceMs ?? nowMs);
    if (this._slowSinceMs === null || nowMs - this._slowSinceMs < TRIED_MS) return;
    this._slowSinceMs = null;
    if (this.renderer.shadowMap.enabled && this._sun.castShadow) this._sun.castShadow = false;
    else if (this._ratio > LEAST_RATIO) {
      this._ratio = Math.max(this._ratio / 1.5, LEAST_RATIO);
      this.renderer.setPixelRatio(this._ratio);
      this._resize();
    }
  }

  render() {
    this.controls.update();
    const nowMs = performance.now();
    if (nowMs - this._drawnMs < this._pauseMs) return;
    this._drawnMs = nowMs;
    const { x, z } = this.controls.target;
    this._ground.position.set(Math.round(x), 0, Math.round(z));
    if (this._drawn++ % this._shadowEvery === 0) { // the light only moves when its shadows are redrawn
      this._sun.position.set(x + 5, 11, z - 4);
      this._sun.target.position.set(x, 0, z);
      this.renderer.shadowMap.needsUpdate = true;
    }
    this.renderer.render(this.scene, this.camera);
  }

  _aim(event) {
    const box = this.canvas.getBoundingClientRect();
    const x = ((event.clientX - box.left) / box.width) * 2 - 1;
    const y = 1 - ((event.clientY - box.top) / box.height) * 2;
    this._raycaster.setFromCamera(new THREE.Vector2(x, y), this.camera);
  }

  _addLight() {
    this.scene.add(new THREE.HemisphereLight(0xffffff, 0x6b7480, 1.5));
    const sun = (this._sun = new THREE.DirectionalLight(0xfff4e2, 2.1));
    sun.castShadow = true;
    sun.shadow.mapSize.set(1024, 1024);
    Object.assign(sun.shadow.camera, { left: -14, right: 14, top: 14, bottom: -14, near: 1, far: 40 });
    sun.shadow.normalBias = 0.03;
    this.scene.add(sun, sun.target);
  }

  _addGround() {
    const material = new THREE.MeshLambertMaterial({ depthWrite: false }); // nothing is below the ground
    this._ground = new THREE.Mesh(new THREE.PlaneGeometry(GROUND_M, GROUND_M).rotateX(-Math.PI / 2), material);
    this._ground.receiveShadow = true;
    this._ground.renderOrder = -1;
    this.scene.add(this._ground);
  }

  /** A square metre of ground with its edges. */
  _tile(theme) {
    const canvas = Object.assign(document.createElement("canvas"), { width: TILE_PX, height: TILE_PX });
    const context = canvas.getContext("2d");
    context.fillStyle = theme.ground;
    context.fillRect(0, 0, TILE_PX, TILE_PX);
    context.strokeStyle = theme.line;
    context.lineWidth = 3;
    context.strokeRect(0, 0, TILE_PX, TILE_PX);
    const tile = new THREE.CanvasTexture(canvas);
    tile.colorSpace = THREE.SRGBColorSpace;
    tile.wrapS = tile.wrapT = THREE.RepeatWrapping;
    tile.repeat.set(GROUND_M, GROUND_M);
    tile.anisotropy = Math.min(this.renderer.capabilities.getMaxAnisotropy(), 8);
    return tile;
  }

  _resize() {
    const { clientWidth: width, clientHeight: height } = this.canvas;
    if (!width || !height) return;
    this.renderer.setSize(width, height, false);
    this.camera.aspect = width / height;
    this.camera.updateProjectionMatrix();
  }
}

/** A broken frame has no place: a camera that followed it would never come back. */
function isPlace({ x, z }) {
  return Number.isFinite(x) && Number.isFinite(z);
}
