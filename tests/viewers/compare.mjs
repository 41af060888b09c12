// Fails if a viewer in headless Chromium shows a glTF file differently from a picture of ours: with a mean difference of 2 of 255 or
// more, with lights of the viewer on or off.
//
//     node compare.mjs VIEWER SCENE.glb OURS.png EYE LOOK-AT UP FOV [PICTURE.png]
//
// VIEWER is three or babylon: the page VIEWER.html. EYE, LOOK-AT and UP are x,y,z, and FOV is in degrees, as `radiosity render` takes
// them. PICTURE.png receives what the viewer shows. The environment variable CHROMIUM names the browser.

import { spawn } from 'node:child_process';
import { mkdtempSync, readFileSync, writeFileSync } from 'node:fs';
import { createServer } from 'node:http';
import { dirname, extname, join, normalize } from 'node:path';
import { fileURLToPath } from 'node:url';

const ALLOWED = 2;
const PATIENCE = 120_000;
const here = dirname(fileURLToPath(import.meta.url));
const [viewer, glb, png, eye, lookAt, up, fov, picture] = process.argv.slice(2);
const ours = readFileSync(png);
const [width, height] = [ours.readUInt32BE(16), ours.readUInt32BE(20)];
const point = (text) => text.split(',').map(Number);
const distance = Math.hypot(...point(eye).map((x, i) => x - point(lookAt)[i]));

function shown(lights) {
    const job = {
        width, height, lights, fov: Number(fov), eye: point(eye), lookAt: point(lookAt), up: point(up),
        near: distance / 1000, far: distance * 100,
    };
    const types = { '.js': 'text/javascript', '.html': 'text/html' };
    return new Promise((resolve, reject) => {
        // Processes of the browser may still write there when it has ended, so whoever made this folder removes it.
        const profile = mkdtempSync(join(process.cwd(), 'profile-'));
        let browser;
        const end = (action, value) => {
            clearTimeout(timer);
            server.close();
            server.closeAllConnections();
            browser.once('exit', () => action(value));
            browser.kill();
        };
        const server = createServer((request, response) => {
            const send = (type, body) => response.writeHead(200, { 'Content-Type': type }).end(body);
            if (request.url === '/') return send('text/html', readFileSync(join(here, `${viewer}.html`)));
            if (request.url === '/pixels.js') return send('text/javascript', readFileSync(join(here, 'pixels.js')));
            if (request.url === '/job') return send('application/json', JSON.stringify(job));
            if (request.url === '/scene.glb') return send('model/gltf-binary', readFileSync(glb));
            if (request.url === '/ours.png') return send('image/png', ours);
            if (request.url === '/done') {
                let body = '';
                request.on('data', (part) => (body += part));
                request.on('end', () => {
                    send('text/plain', 'thanks');
                    end(resolve, JSON.parse(body));
                });
                return undefined;
            }
            const path = normalize(request.url);
            if (!/^\/(three|babylonjs|babylonjs-loaders)\//.test(path)) return response.writeHead(404).end();
            return send(types[extname(path)] ?? 'text/plain', readFileSync(join(here, 'node_modules', path)));
        });
        const timer = setTimeout(() => end(reject, new Error('the browser showed nothing in time')), PATIENCE);
        server.listen(0, '127.0.0.1', () => {
            const url = `http://127.0.0.1:${server.address().port}/`;
            const flags = ['--headless=new', '--no-sandbox', '--disable-dev-shm-usage', '--use-angle=swiftshader',
                '--enable-unsafe-swiftshader', '--no-first-run', `--user-data-dir=${profile}`];
            browser = spawn(process.env.CHROMIUM ?? 'chromium', [...flags, url], { stdio: 'ignore' });
        });
    });
}

let failed = false;
for (const lights of [false, true]) {
    const { difference, picture: data } = await shown(lights);
    console.log(`${glb} in ${viewer}: mean difference ${difference.toFixed(3)} of 255 with the viewer's lights ${lights ? 'on' : 'off'}`);
    failed ||= !(difference < ALLOWED);
    if (picture && !lights) {
        writeFileSync(picture, Buffer.from(data, 'base64'));
    }
}
process.exit(failed ? 1 : 0);
