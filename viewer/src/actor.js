// A clip as something that moves: the skinned body of its GLB, and the trail of its root on the floor.
import { AnimationMixer, BufferAttribute, BufferGeometry, DoubleSide, Mesh, MeshBasicMaterial, Vector3 } from "three";
import { GLTFLoader } from "three/addons/loaders/GLTFLoader.js";

const RIBBON = 0.022; // half the trail's width, metres
const CALM = 0.6; // seconds over which the camera's target is averaged

/** base64 of a gzipped file -> its bytes. */
export async function unpacked(text) {
  const packed = Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
  const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("gzip"));
  return new Response(stream).arrayBuffer();
}

/** clip: {text, seed, fps, frames, glb}. */
export async function loadActor(clip) {
  const model = await new GLTFLoader().parseAsync(await unpacked(clip.glb), "");
  const motion = model.animations[0];
  const root = motion.tracks.find((track) => track.name.endsWith(".position")).values;
  const mixer = new AnimationMixer(model.scene);
  mixer.clipAction(motion).play();
  let body;
  model.scene.traverse((part) => {
    if (!part.isSkinnedMesh) return;
    body = part;
    part.castShadow = true;
    part.frustumCulled = false; // its bounds are those of the rest pose
  });
  const last = clip.frames - 1;
  const path = Array.from({ length: clip.frames }, (_, k) => new Vector3(root[3 * k], 0, root[3 * k + 2]));
  const targets = averaged(path, Math.round(CALM * clip.fps));
  const trail = ribbon(path);
  return {
    clip,
    body,
    model: model.scene,
    trail,
    duration: last / clip.fps,
    /** Pose the body and draw the trail up to a time; a clip that is over stays in its last pose. */
    pose(time) {
      const now = Math.min(time, last / clip.fps);
      mixer.setTime(Math.min(now, motion.duration - 1e-4));
      trail.past.geometry.setDrawRange(0, 6 * Math.floor(now * clip.fps));
    },
    /** Where the camera looks, on the floor. */
    target(time) {
      const at = Math.min(time * clip.fps, last);
      const before = Math.floor(at);
      return targets[before].clone().lerp(targets[Math.min(before + 1, last)], at - before);
    },
    dispose() {
      for (const mesh of [body, trail.past, trail.whole]) {
        mesh.geometry.dispose();
        mesh.material.dispose();
      }
      body.skeleton.dispose();
    },
  };
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
