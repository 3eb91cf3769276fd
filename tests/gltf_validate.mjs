// Validate GLB files with Khronos' validator: prints {path: {errors, warnings, infos, messages}} as JSON.
import { readFileSync } from "node:fs";
import validator from "gltf-validator";

const reports = {};
for (const path of process.argv.slice(2)) {
  const { issues } = await validator.validateBytes(new Uint8Array(readFileSync(path)));
  const { numErrors: errors, numWarnings: warnings, numInfos: infos, messages } = issues;
  reports[path] = { errors, warnings, infos, messages: messages.map((m) => `${m.code} ${m.pointer}: ${m.message}`) };
}
console.log(JSON.stringify(reports, null, 2));
