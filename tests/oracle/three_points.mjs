// Where three.js puts the nodes of a GLB, or a VRM character that plays a VRMA; prints one JSON object.
//
//     cd FOLDER && node --input-type=module - hero.glb [clip.vrma] < three_points.mjs
//
// FOLDER has node_modules with three and @pixiv/three-vrm*; a script from stdin finds packages there.
import { readFileSync } from "node:fs";

const load = (name) => import(name);
const [hero, vrma] = process.argv.slice(2);
globalThis.self = globalThis;
const THREE = await load("three");
const { GLTFLoader } = await load("three/addons/loaders/GLTFLoader.js");
const loader = new GLTFLoader();
if (vrma) {
  const { VRMLoaderPlugin } = await load("@pixiv/three-vrm");
  const { VRMAnimationLoaderPlugin } = await load("@pixiv/three-vrm-animation");
  loader.register((parser) => new VRMLoaderPlugin(parser));
  loader.register((parser) => new VRMAnimationLoaderPlugin(parser));
}
const parse = (path) => {
  const data = readFileSync(path);
  return loader.parseAsync(data.buffer.slice(data.byteOffset, data.byteOffset + data.byteLength), "");
};

const file = await parse(hero);
let clip = file.animations.at(-1);
const vrm = file.userData.vrm;
if (vrma) {
  const { createVRMAnimationClip } = await load("@pixiv/three-vrm-animation");
  clip = createVRMAnimationClip((await parse(vrma)).userData.vrmAnimations[0], vrm);
}
const mixer = new THREE.AnimationMixer(vrm ? vrm.scene : file.scene);
mixer.clipAction(clip).play();
const nodes = [];
file.scene.traverse((node) => node.isBone && nodes.push(node));
const frames = [];
const times = clip.tracks.reduce((most, track) => (track.times.length > most.length ? track.times : most), []);
for (const time of times) {
  mixer.setTime(Math.min(time, clip.duration - 1e-6));
  vrm?.update(0);
  file.scene.updateMatrixWorld(true);
  frames.push(nodes.map((node) => node.getWorldPosition(new THREE.Vector3()).toArray()));
}
const index = (node) => file.parser.associations.get(node)?.nodes;
console.log(JSON.stringify({ three: THREE.REVISION, nodes: nodes.map(index), frames }));
