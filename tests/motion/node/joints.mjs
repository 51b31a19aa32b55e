// Plays a glTF file by three.js and prints where the joints of each hand are, as JSON, null where it cannot be seen;
// and, with the word "skin", the corners of its mesh. usage: node joints.mjs FILE '[second, ...]' [skin]
import { readFileSync } from "node:fs";
import { AnimationMixer, LoopOnce, Vector3 } from "three";
import { GLTFLoader } from "three/addons/loaders/GLTFLoader.js";

globalThis.self = globalThis; // what browsers have
globalThis.ProgressEvent ??= class extends Event {};
const [file, times, skin] = process.argv.slice(2);
const { buffer, byteOffset, byteLength } = readFileSync(file);
const gltf = await new GLTFLoader().parseAsync(buffer.slice(byteOffset, byteOffset + byteLength), "");
const mixer = new AnimationMixer(gltf.scene);
const action = mixer.clipAction(gltf.animations[0]).setLoop(LoopOnce, 1);
action.clampWhenFinished = true; // or its end would be its beginning
const hands = ["left", "right"].map((side) => gltf.scene.getObjectByName(`${side}_hand`));

function joints(hand) {
  if (!hand || hand.scale.x === 0) return null;
  const found = [];
  hand.traverse((node) => node !== hand && found.push([node.name, node.getWorldPosition(new Vector3()).toArray()]));
  return Object.fromEntries(found);
}

function corners(hand) {
  if (!hand || hand.scale.x === 0) return null;
  const mesh = gltf.scene.getObjectByName(hand.name.replace("_hand", "_bones"));
  const count = mesh.geometry.attributes.position.count;
  return Array.from({ length: count }, (_, i) => mesh.localToWorld(mesh.getVertexPosition(i, new Vector3())).toArray());
}

const frames = JSON.parse(times).map((second) => {
  action.reset().play();
  mixer.setTime(second);
  gltf.scene.updateMatrixWorld(true);
  return hands.map(skin ? corners : joints);
});
const { duration } = gltf.animations[0];
const camera = gltf.cameras[0];
console.log(JSON.stringify({ frames, duration, fov: camera.fov, aspect: camera.aspect }));
