// Prints what Khronos' validator says of glTF files, as JSON. usage: node validate.mjs FILE...
import { readFileSync } from "node:fs";
import validator from "gltf-validator";

const reports = [];
for (const file of process.argv.slice(2)) {
  reports.push(await validator.validateBytes(new Uint8Array(readFileSync(file))));
}
console.log(JSON.stringify(reports));
