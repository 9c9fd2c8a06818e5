// Validates a GLB with the Khronos glTF validator; prints its report as JSON. usage: node gltf.js FILE, NODE_PATH names its modules
const fs = require("fs");
const validator = require("gltf-validator");

validator
  .validateBytes(new Uint8Array(fs.readFileSync(process.argv[2])))
  .then((report) => console.log(JSON.stringify(report)))
  .catch((error) => { console.error(error); process.exit(1); });
