// Motions from files: frames of a rig that the page knows, or the scene of any other glTF file.
import { AnimationMixer } from "three";
import { GLTFLoader } from "three/addons/loaders/GLTFLoader.js";
import { Track } from "./track.js";

const COLOUR = 0xcfd6de;
const SCENE_HZ = 30; // a scene has no frames of its own; they are counted at this rate

export class OpenedMotion {
  /** rows: of the frames from 0 on. */
  constructor(name, rig, rows) {
    Object.assign(this, { name, rig, numFrames: rows.length, frameRate: rig.frameRate, fromMs: performance.now() });
    this.track = new Track(rig);
    this.track.put(0, rows);
  }

  /** Draw the frame `place`, which may be between two, displaced over the ground. */
  draw(bodies, place, x, z) {
    this.rig.pose(this.track.sample(place));
    this.rig.shift(x, z);
    bodies.add(this.rig, COLOUR);
  }

  dispose() {}
}

class OpenedScene {
  constructor(name, gltf, scene) {
    const [clip] = gltf.animations;
    Object.assign(this, { name, frameRate: SCENE_HZ, numFrames: Math.max(Math.round(clip.duration * SCENE_HZ), 1), fromMs: performance.now() });
    this._group = gltf.scene;
    this._mixer = new AnimationMixer(gltf.scene);
    this._mixer.clipAction(clip).play();
    gltf.scene.traverse((each) => {
      each.castShadow = Boolean(each.isMesh);
      each.frustumCulled = false; // bones move it away from the bounds of its mesh
    });
    scene.add(gltf.scene);
  }

  draw(bodies, place, x, z) {
    this._group.position.set(x, 0, z);
    this._mixer.setTime(place / SCENE_HZ);
  }

  dispose() {
    this._mixer.stopAllAction();
    this._group.removeFromParent();
    this._group.traverse((each) => {
      each.geometry?.dispose();
      for (const material of [each.material ?? []].flat()) material.dispose();
    });
  }
}

/** The first animation of a binary glTF file. Throws if it has none. */
export async function openScene(name, bytes, scene) {
  const gltf = await new GLTFLoader().parseAsync(bytes, "").catch((error) => {
    throw new Error(`${name} cannot be read as a binary glTF: ${error.message}`);
  });
  if (!gltf.animations.length) throw new Error(`${name} has no animation; a glTF file with one can be opened`);
  return new OpenedScene(name, gltf, scene);
}
