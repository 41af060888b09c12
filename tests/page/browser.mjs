// A headless Chromium in which a page may neither ask for anything nor complain.

import assert from 'node:assert/strict';
import { execFileSync } from 'node:child_process';
import { mkdirSync, writeFileSync } from 'node:fs';
import { join, resolve } from 'node:path';
import { pathToFileURL } from 'node:url';
import puppeteer from 'puppeteer-core';

export const program = process.argv[2];

// Runs the program. Its messages are shown only if it fails.
export function run(...args) {
    try {
        return execFileSync(program, [...args, '--quiet'], { encoding: 'utf8', stdio: ['ignore', 'pipe', 'pipe'] });
    } catch (error) {
        throw new Error(`radiosity ${args.join(' ')}: ${error.stderr}`);
    }
}

export async function launch() {
    return puppeteer.launch({
        executablePath: process.env.CHROMIUM,
        args: ['--no-sandbox', '--disable-dev-shm-usage', '--use-angle=swiftshader', '--enable-unsafe-swiftshader', '--hide-scrollbars'],
        // Pictures by a processor take their time on a busy machine.
        protocolTimeout: 300_000,
    });
}

// Opens a file of this directory and waits until it is drawn. The page ends with `done`, which looks for requests and complaints.
export async function open(browser, file, { width = 640, height = 480, hash = '', scheme = 'light', touch = false } = {}) {
    const page = await browser.newPage();
    page.setDefaultTimeout(240_000);
    const complaints = [];
    page.on('console', (message) => ['error', 'warn'].includes(message.type()) && complaints.push(message.text()));
    page.on('pageerror', (error) => complaints.push(error.message));
    const url = pathToFileURL(resolve(file)).href;
    page.on('request', (request) => {
        const asked = request.url();
        if (asked.split('#')[0] !== url && !/^(data|blob):/.test(asked)) {
            complaints.push(`a request for ${asked.slice(0, 100)}`);
        }
    });
    await page.emulateMediaFeatures([{ name: 'prefers-color-scheme', value: scheme }]);
    await page.setViewport({ width, height, hasTouch: touch, isMobile: touch });
    await page.goto(url + hash);
    await page.waitForSelector('html[data-ready]');
    page.done = async () => {
        assert.deepEqual(complaints, []);
        await page.close();
    };
    return page;
}

// Leaves a picture of the window, where somebody wants to look at it.
export async function keep(page, name) {
    if (process.env.PICTURES) {
        mkdirSync(process.env.PICTURES, { recursive: true });
        writeFileSync(join(process.env.PICTURES, `${name}.png`), await page.screenshot());
    }
}

// The pixels of a PNG, R G B A; `source` is a data URL.
export async function pixels(page, source) {
    const found = await page.evaluate(async (source) => {
        const image = new Image();
        image.src = source;
        await image.decode();
        const canvas = document.createElement('canvas');
        [canvas.width, canvas.height] = [image.width, image.height];
        const context = canvas.getContext('2d');
        context.drawImage(image, 0, 0);
        const { data } = context.getImageData(0, 0, image.width, image.height);
        let text = '';
        for (let i = 0; i < data.length; i += 8192) {
            text += String.fromCharCode(...data.subarray(i, i + 8192));
        }
        return { width: image.width, height: image.height, data: btoa(text) };
    }, source);
    return { ...found, data: Buffer.from(found.data, 'base64') };
}

// Of all pixels and channels, from 0 to 255.
export function meanDifference(a, b) {
    assert.deepEqual([a.width, a.height], [b.width, b.height]);
    let sum = 0;
    for (let i = 0; i < a.data.length; i++) {
        sum += i % 4 < 3 ? Math.abs(a.data[i] - b.data[i]) : 0;
    }
    return sum / (0.75 * a.data.length);
}

export function near(found, wanted, tolerance, what) {
    assert.ok(Math.abs(found - wanted) <= tolerance, `${what}: ${found} instead of ${wanted} ± ${tolerance}`);
}
