// Khronos' glTF validator on a file; prints its issues as JSON.
//
//     node validate_glb.mjs FILE
import fs from 'node:fs';
import validator from 'gltf-validator';

const report = await validator.validateBytes(new Uint8Array(fs.readFileSync(process.argv[2])));
console.log(JSON.stringify(report.issues));
