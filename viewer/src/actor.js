// A clip as something that moves: the skinned body of its GLB or a character, and the trail of its root on the floor.
import { AnimationMixer, BufferAttribute, BufferGeometry, DoubleSide, Mesh, MeshBasicMaterial, PropertyBinding, Vector3 } from "three";
import { GLTFLoader } from "three/addons/loaders/GLTFLoader.js";

const RIBBON = 0.022; // half the trail's width, metres
const CALM = 0.6; // seconds over which the camera's target is averaged

/** base64 of a gzipped file -> its bytes. */
export async function unpacked(text) {
  const packed = Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
  const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("gzip"));
  return new Response(stream).arrayBuffer();
}

/**
 * @param clip {text, seed, fps, frames, glb}
 * @param character bytes of a character's file whose last animation is the clip; null is our own body
 */
export async function loadActor(clip, character = null) {
  const model = await new GLTFLoader().parseAsync(character ?? (await unpacked(clip.glb)), "");
  const motion = model.animations.at(-1);
  const mixer = new AnimationMixer(model.scene);
  mixer.clipAction(motion).play();
  const meshes = [];
  model.scene.traverse((part) => {
    if (!part.isMesh) return;
    meshes.push(part);
    part.castShadow = true;
    part.frustumCulled = false; // its bounds are those of the rest pose
  });
  const last = clip.frames - 1;
  const path = floorPath(model.scene, motion, clip);
  const targets = averaged(path, Math.round(CALM * clip.fps));
  const trail = ribbon(path);
  return {
    clip,
    /** The mesh of our own body, which takes the colours of the page. */
    body: character ? null : meshes[0],
    model: model.scene,
    trail,
    path,
    duration: last / clip.fps,
    /** Pose the body and draw the trail up to a time; a clip that is over stays in its last pose. */
    pose(time) {
      const now = Math.min(time, last / clip.fps);
      mixer.setTime(Math.min(now, motion.duration - 1e-4));
      trail.past.geometry.setDrawRange(0, 6 * Math.floor(now * clip.fps));
    },
    /** Where the joints are at a time: [x, y, z] each; null where this body has none of a name. */
    joints(names, time) {
      this.pose(time);
      model.scene.updateMatrixWorld(true);
      return names.map((name) => model.scene.getObjectByName(name)?.getWorldPosition(new Vector3()).toArray() ?? null);
    },
    /** Where the camera looks, on the floor. */
    target(time) {
      const at = Math.min(time * clip.fps, last);
      const before = Math.floor(at);
      return targets[before].clone().lerp(targets[Math.min(before + 1, last)], at - before);
    },
    dispose() {
      for (const mesh of [...meshes, trail.past, trail.whole]) {
        mesh.geometry.dispose();
        for (const material of [].concat(mesh.material)) {
          for (const part of Object.values(material)) if (part?.isTexture) part.dispose();
          material.dispose();
        }
        mesh.skeleton?.dispose();
      }
    },
  };
}

/** Where the root is above the floor, frame by frame: of the first joint that moves from its place. */
function floorPath(scene, motion, { frames, fps }) {
  const track = motion.tracks.find(({ name }) => name.endsWith(".position"));
  const { parent } = PropertyBinding.findNode(scene, PropertyBinding.parseTrackName(track.name).nodeName);
  parent.updateWorldMatrix(true, false);
  const place = track.createInterpolant();
  return Array.from({ length: frames }, (_, k) => new Vector3().fromArray(place.evaluate(k / fps)).applyMatrix4(parent.matrixWorld).setY(0));
}

/** Running mean over `width` frames to both sides. */
function averaged(path, width) {
  return path.map((_, at) => {
    const near = path.slice(Math.max(0, at - width), at + width + 1);
    return near.reduce((sum, point) => sum.add(point), new Vector3()).divideScalar(near.length);
  });
}

/** A flat band along a path, once whole and once as far as the clip has come. */
function ribbon(path) {
  const corners = new Float32Array(path.length * 6);
  const side = new Vector3(1, 0, 0);
  path.forEach((point, at) => {
    const along = path[Math.min(at + 1, path.length - 1)].clone().sub(path[Math.max(at - 1, 0)]);
    if (along.length() > 0.01) side.set(along.z, 0, -along.x).normalize();
    const [x, z] = [side.x * RIBBON, side.z * RIBBON];
    corners.set([point.x - x, 0, point.z - z, point.x + x, 0, point.z + z], 6 * at);
  });
  const index = path.slice(1).flatMap((_, k) => [2 * k, 2 * k + 1, 2 * k + 2, 2 * k + 2, 2 * k + 1, 2 * k + 3]);
  const band = (opacity, height) => {
    const geometry = new BufferGeometry();
    geometry.setAttribute("position", new BufferAttribute(corners, 3));
    geometry.setIndex(index);
    const material = new MeshBasicMaterial({ transparent: true, opacity, side: DoubleSide, depthWrite: false });
    const mesh = new Mesh(geometry, material);
    mesh.position.y = height;
    return mesh;
  };
  return { whole: band(0.25, 0.004), past: band(0.9, 0.006) };
}
