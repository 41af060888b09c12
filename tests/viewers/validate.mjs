// Fails when Khronos' glTF validator finds an error or a warning in one of the files.
//
//     node validate.mjs FILE.glb ...

import { readFileSync } from 'node:fs';
import validator from 'gltf-validator';

let failed = 0;
for (const file of process.argv.slice(2)) {
    const report = await validator.validateBytes(new Uint8Array(readFileSync(file)), { maxIssues: 20 });
    const { numErrors, numWarnings, messages } = report.issues;
    console.log(`${file}: ${numErrors} errors, ${numWarnings} warnings`);
    for (const { severity, code, message, pointer } of messages.filter((m) => m.severity < 2)) {
        console.log(`  ${['error', 'warning'][severity]} ${code} at ${pointer}: ${message}`);
    }
    failed += numErrors + numWarnings;
}
process.exit(failed > 0 ? 1 : 0);
