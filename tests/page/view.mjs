// What the page of a solved scene shows and reads is what the program computed.

import assert from 'node:assert/strict';
import { readFileSync, statSync } from 'node:fs';
import { keep, launch, meanDifference, near, open, pixels, run } from './browser.mjs';
import { faces } from './ply.mjs';

// Mean difference of pictures that is allowed, of 255.
const ALLOWED = 3;
const LUMINANCE = [0.2126, 0.7152, 0.0722];
const luminance = (rgb) => LUMINANCE.reduce((sum, weight, c) => sum + weight * rgb[c], 0);
const linear = (byte) => (byte <= 0.04045 * 255 ? byte / 255 / 12.92 : ((byte / 255 + 0.055) / 1.055) ** 2.4);

// A picture of the page and the pixel in its middle.
async function still(page, width = 320, height = 240) {
    return pixels(page, await page.evaluate((w, h) => radiosity.still(w, h), width, height));
}
const middle = ({ width, height, data }) => [...data.subarray(4 * (Math.floor(height / 2) * width + Math.floor(width / 2)))].slice(0, 3);

// The same view by the program, with the options that the page gives.
async function sameView(page, scene, solve, more = []) {
    const options = await page.evaluate(() => radiosity.options());
    const view = options.replace(/--width \d+ --height \d+/, '--width 320 --height 240').split(' ');
    // The page gives the direction upwards.
    const others = solve.filter((word, k) => word !== '--up' && solve[k - 1] !== '--up');
    run('render', scene, '-o', 'ours.png', '--method', 'radiosity', '--spp', '16', ...others, ...view, ...more);
    return pixels(page, `data:image/png;base64,${readFileSync('ours.png').toString('base64')}`);
}

async function pictures(browser) {
    const views = [
        ['cornell-box.obj', [], '#eye=278,273,-800&look-at=278,273,0&fov=39'],
        ['textured.obj', [], '#eye=0.3,1.8,2.8&look-at=2.5,0.6,0.8&fov=70'],
        ['door-ajar.obj', [], '#eye=5.6,1.9,3.7&look-at=3.2,1,1.2&fov=70'],
        ['scene.obj', ['--up', 'z'], '#eye=380,20,200&look-at=100,250,60&fov=75'],
        ['scene.obj', ['--ignore', 'wall', '--sky', 'overcast:100', '--up', 'z'], '#eye=600,-300,300&look-at=200,150,100&fov=60'],
    ];
    for (const [scene, lights, hash] of views) {
        const solve = ['--patches', '4000', '--rays', '128', ...lights];
        run('solve', scene, '--page', 'page.html', ...solve);
        const page = await open(browser, 'page.html', { hash });
        const difference = meanDifference(await still(page), await sameView(page, scene, solve));
        console.log(`${scene} ${lights.join(' ')}: mean difference ${difference.toFixed(3)} of 255`);
        assert.ok(difference < ALLOWED, `${scene}: the page differs by ${difference} of 255 from the program's picture`);
        await keep(page, `${scene}-${lights.length}`);
        await page.done();
    }
}

async function lightmap(browser) {
    run('bake', 'cornell-box.obj', '-o', 'baked', '--page', 'baked.html', '--resolution', '512', '--final-gather', '16', '--quality', 'draft');
    const page = await open(browser, 'baked.html', { hash: '#eye=278,273,-800&look-at=278,273,0&fov=39' });
    const ours = await sameView(page, 'cornell-box.obj', ['--quality', 'draft'], ['--final-gather', '32']);
    const difference = meanDifference(await still(page), ours);
    console.log(`a lightmap: mean difference ${difference.toFixed(3)} of 255`);
    assert.ok(difference < ALLOWED, `the lightmap differs by ${difference} of 255 from a final gather`);
    const reading = await page.evaluate(() => (radiosity.select([0, -0.5]), radiosity.selected));
    assert.equal(reading.material, 'white');
    assert.ok(luminance(reading.irradiance) > 0);
    await keep(page, 'lightmap');
    await page.done();
}

// Numbers that are read back: of a patch, of exposure, of false colours.
async function readings(browser) {
    const solve = ['--patches', '2000', '--rays', '256'];
    run('solve', 'cornell-box.obj', '--page', 'page.html', '-o', 'out.ply', '--backs', ...solve);
    const known = faces('out.ply');
    const page = await open(browser, 'page.html', { hash: '#eye=278,273,-800&look-at=278,273,0&fov=39' });
    const places = [[0, 0], [0, -0.8], [-0.65, 0], [0.65, 0.1], [-0.2, -0.3], [0, 0.85]];
    const seen = new Set();
    for (const place of places) {
        const reading = await page.evaluate((at) => (radiosity.select(at), radiosity.selected), place);
        const face = known[reading.patch];
        assert.equal(reading.triangle, face.triangle);
        'rgb'.split('').forEach((channel, c) => {
            for (const [found, wanted] of [
                [reading.irradiance[c], face[`irradiance_${channel}`]],
                [reading.error[c], face[`error_${channel}`]],
                [reading.discretisation[c], face[`discretisation_${channel}`]],
                [reading.radiosity[c], face[`radiosity_${channel}`]],
            ]) {
                // Half floats have eleven digits; radiosity is computed from irradiance and so has their error once more.
                near(found, wanted, Math.abs(wanted) / 1000 + 1e-5 * luminance(reading.irradiance), `patch ${reading.patch}`);
            }
        });
        near(reading.area, face.area, 1e-3 * face.area, 'area');
        seen.add(reading.material);
    }
    assert.deepEqual([...seen].sort(), ['green', 'red', 'white']);
    const text = await page.$eval('#reading', (element) => element.textContent);
    assert.match(text, /Patch.*Material.*Position.*Irradiance E.*W\/m².*±.*Radiosity B.*Discretisation/s);

    // Two stops more are four times the light; half as much of the sum of rounding and clipping is left.
    await page.evaluate(() => (radiosity.set({ smooth: false }), radiosity.select([0, 0])));
    const at = async (exposure) => {
        await page.evaluate((exposure) => (radiosity.set({ exposure }), radiosity.picture.uniforms.selected.value = -1), exposure);
        return middle(await still(page)).map(linear);
    };
    const [less, more] = [await at(-3), await at(-1)];
    more.forEach((x, c) => near(x / less[c], 4, 4 * 0.06, 'two stops'));

    // The pixel is the light of the patch, and in false colours its place on the scale.
    const { reading, white, scale, colours } = await page.evaluate(() => {
        radiosity.set({ exposure: -1, show: 'irradiance' });
        return {
            reading: radiosity.selected, white: radiosity.about.white, scale: radiosity.scale,
            colours: radiosity.picture.uniforms.colours.value.map((v) => v.toArray()),
        };
    });
    reading.radiosity.forEach((b, c) => near(more[c], (b / white) * 0.5, 0.004 + 0.02 * more[c], 'exposed radiosity'));
    const share = 8 * (luminance(reading.irradiance) / scale.most);
    const k = Math.min(7, Math.floor(share));
    const wanted = colours[k].map((x, c) => 255 * (x + (colours[k + 1][c] - x) * (share - k)));
    middle(await still(page)).forEach((x, c) => near(x, wanted[c], 3, 'false colour'));
    const legend = await page.$eval('#legend', (element) => element.textContent);
    assert.match(legend, /Irradiance E, W\/m²/);
    await page.evaluate(() => radiosity.set({ isolines: true, smooth: true }));
    await keep(page, 'false-colour');
    for (const show of ['relative-error', 'relative-discretisation', 'error', 'discretisation', 'radiosity']) {
        await page.evaluate((show) => radiosity.set({ show, edges: true }), show);
        assert.equal(await page.evaluate(() => radiosity.state.show), show);
        await keep(page, show);
    }
    await page.done();
}

// Lamps one by one: light is linear, and each part is what the program computes for that lamp alone.
async function lamps(browser) {
    const solve = ['--patches', '1500', '--rays', '1024', '--up', 'z'];
    run('solve', 'scene.obj', '--page', 'page.html', ...solve);
    const page = await open(browser, 'page.html', { width: 1000, height: 700 });
    assert.equal(await page.evaluate(() => window.broken), undefined);
    const names = await page.evaluate(() => radiosity.about.layers.map((layer) => layer.name));
    assert.deepEqual([...names].sort(), ['</script><script>window.broken=1</script>', 'blue&lamp']);
    const sum = (weights) => page.evaluate((weights) => {
        radiosity.set({ weights });
        const { model, light } = radiosity;
        return [0, 1, 2].map((c) => model.area.reduce((sum, area, i) => sum + area * light.patch[3 * i + c], 0) * model.unit * radiosity.about.radius ** 2);
    }, weights);
    const whole = await sum([1, 1]);
    const [first, second] = [await sum([1, 0]), await sum([0, 1])];
    const mixed = await sum([0.5, 2]);
    whole.forEach((x, c) => {
        near(first[c] + second[c], x, 1e-3 * x, 'the lamps together');
        near(mixed[c], 0.5 * first[c] + 2 * second[c], 1e-5 * x, 'dimmed lamps');
    });
    const blue = names.indexOf('blue&lamp');
    run('solve', 'scene.obj', '-o', 'one.ply', '--backs', '--emitters', 'blue&lamp', ...solve);
    const flux = [0, 0, 0];
    for (const face of faces('one.ply')) {
        'rgb'.split('').forEach((channel, c) => (flux[c] += face.area * face[`irradiance_${channel}`]));
    }
    // Rays are dealt out anew for one lamp; a thousand of each patch leave less than a percent in the mean.
    [first, second][blue].forEach((x, c) => near(x, flux[c], 0.01 * flux[c], 'one lamp alone'));

    // The slider does the same as the script, by mouse and by keyboard; error bars go when lamps differ.
    await page.evaluate(() => (radiosity.set({ weights: [1, 1] }), radiosity.select([0, 0])));
    assert.ok((await page.evaluate(() => radiosity.selected)).error);
    await page.focus(`#lamp-${blue}`);
    await page.keyboard.press('Home');
    const weights = await page.evaluate(() => radiosity.state.weights);
    assert.deepEqual(weights, [0, 1].map((k) => (k === blue ? 0 : 1)));
    assert.equal((await page.evaluate(() => radiosity.selected)).error, null);
    await keep(page, 'one-lamp-off');
    await page.click(`#lamp-${blue}-on`);
    assert.deepEqual(await page.evaluate(() => radiosity.state.weights), [1, 1]);
    const dimmed = await page.evaluate(() => (radiosity.set({ weights: [2, 2] }), radiosity.selected));
    const usual = await page.evaluate(() => (radiosity.set({ weights: [1, 1] }), radiosity.selected));
    dimmed.error.forEach((x, c) => near(x, 2 * usual.error[c], 1e-5 * x, 'the error bar of twice the light'));
    await page.done();
}

// Which of the methods: their values, their difference, and grey where there is none.
async function methods(browser) {
    try {
        run('validate', 'cornell-box.obj', '--page', 'validate.html', '--patches', '400', '--paths', '256', '--particles', '400000');
    } catch (error) {
        // Another verdict would be another test's business; the page is written all the same.
        console.log(String(error).split('\n')[0]);
    }
    const page = await open(browser, 'validate.html', { width: 1000, height: 700 });
    assert.deepEqual(await page.evaluate(() => radiosity.about.methods.map((m) => m.name)), ['radiosity', 'path tracing', 'light tracing']);
    const reading = await page.evaluate(() => (radiosity.select([0, 0]), radiosity.selected));
    const [radiosity, path] = reading.methods;
    const noise = radiosity.error.map((e, c) => Math.hypot(e, path.error[c]));
    radiosity.irradiance.forEach((x, c) => near(x, path.irradiance[c], 6 * noise[c] + 0.1 * x, 'two methods'));
    await page.select('#method', '1');
    for (const show of ['difference', 'z']) {
        await page.select('#show', show);
        assert.equal(await page.evaluate(() => radiosity.state.show), show);
        const z = await page.evaluate(() => radiosity.number[radiosity.selected.patch] * radiosity.quantities.find((q) => q.name === radiosity.state.show).factor);
        const difference = luminance(path.irradiance) - luminance(radiosity.irradiance);
        const error = Math.hypot(luminance(path.error), luminance(radiosity.error));
        near(z, show === 'z' ? difference / error : difference, 1e-3 * Math.abs(z) + 1e-3, show);
        await keep(page, show);
    }
    await page.done();
}

// Keys, the address, the options to copy, and small and dark windows.
async function handling(browser) {
    run('solve', 'scene.obj', '--page', 'page.html', '--quality', 'draft', '--up', 'z');
    let page = await open(browser, 'page.html', { width: 1000, height: 700 });
    const eye = () => page.evaluate(() => radiosity.camera().eye);
    await page.focus('#canvas');
    await page.keyboard.press('Enter');
    assert.match(await page.$eval('#reading', (element) => element.textContent), /Irradiance/);
    await page.keyboard.press(']');
    assert.equal(await page.evaluate(() => radiosity.state.exposure), 0.5);
    await page.keyboard.press('2');
    assert.equal(await page.evaluate(() => radiosity.state.show), 'irradiance');
    await page.keyboard.press('1');
    const hold = async (key) => {
        const before = await eye();
        await page.keyboard.down(key);
        await page.waitForFunction((before) => radiosity.camera().eye.some((x, k) => Math.abs(x - before[k]) > 1), {}, before);
        await page.keyboard.up(key);
        return [before, await eye()];
    };
    const [from, to] = await hold('ArrowRight');
    const target = await page.evaluate(() => radiosity.camera().lookAt);
    const distance = (p) => Math.hypot(...p.map((x, k) => x - target[k]));
    near(distance(to), distance(from), 1e-3 * distance(from), 'the distance of turning around');
    await page.keyboard.press('p');
    // Steps are level, and go where one looks.
    const look = await page.evaluate(() => radiosity.camera());
    const [start, end] = await hold('w');
    near(end[2], start[2], 1e-3, 'the height of a walk');
    const ahead = [0, 1].map((k) => look.lookAt[k] - look.eye[k]);
    const step = [0, 1].map((k) => end[k] - start[k]);
    near((ahead[0] * step[0] + ahead[1] * step[1]) / Math.hypot(...ahead) / Math.hypot(...step), 1, 1e-4, 'forward');

    // A click reads what lies under the cursor, as a script does.
    const box = await page.$eval('#canvas', (canvas) => canvas.getBoundingClientRect().toJSON());
    await page.mouse.click(box.x + 0.7 * box.width, box.y + 0.6 * box.height);
    const clicked = await page.evaluate(() => radiosity.selected);
    const scripted = await page.evaluate(() => (radiosity.select([0.4, -0.2]), radiosity.selected));
    assert.equal(clicked.patch, scripted.patch);
    await page.mouse.move(box.x + 0.5 * box.width, box.y + 0.55 * box.height);
    await page.waitForFunction(() => !document.getElementById('hint').hidden);
    assert.match(await page.$eval('#hint', (element) => element.textContent), /^E [\d.e+-]+ ± [\d.e+-]+ W\/m²/);

    // The address holds the view, for another window.
    await page.waitForFunction(() => location.hash === radiosity.toAddress());
    const hash = await page.evaluate(() => location.hash);
    const options = await page.evaluate(() => radiosity.options());
    await keep(page, 'desktop');
    await page.done();
    page = await open(browser, 'page.html', { width: 1000, height: 700, hash, scheme: 'dark' });
    assert.equal(await page.evaluate(() => radiosity.options()), options);
    assert.equal(await page.$eval('#options', (area) => area.labels.length), 1);
    const unnamed = await page.$$eval('input, select, textarea, button', (all) =>
        all.filter((e) => !(e.labels?.length || e.textContent.trim() || e.getAttribute('aria-label'))).map((e) => e.id));
    assert.deepEqual(unnamed, []);
    await keep(page, 'desktop-dark');
    await page.done();

    for (const scheme of ['light', 'dark']) {
        page = await open(browser, 'page.html', { width: 360, height: 740, scheme, touch: true });
        const width = await page.evaluate(() => document.documentElement.scrollWidth);
        assert.ok(width <= 360, `the page is ${width} pixels wide in a window of 360`);
        await keep(page, `narrow-${scheme}`);
        await page.tap('#toggle');
        const panel = await page.$eval('#panel', (panel) => [panel.scrollWidth, panel.clientWidth]);
        assert.ok(panel[0] <= panel[1], `the settings need ${panel[0]} of ${panel[1]} pixels`);
        await keep(page, `narrow-${scheme}-settings`);
        await page.done();
    }
}

// 100,000 patches: below 10 MB, and picked within a moment.
async function large(browser) {
    run('solve', 'cornell-box.obj', '--page', 'large.html', '--patches', '100000', '--rays', '16');
    const size = statSync('large.html').size;
    const page = await open(browser, 'large.html');
    const { patches, milliseconds } = await page.evaluate(() => {
        const start = performance.now();
        radiosity.select([0, 0]);
        return { patches: radiosity.model.patches, milliseconds: performance.now() - start };
    });
    console.log(`${patches} patches: ${(size / 1e6).toFixed(2)} MB, picked in ${milliseconds.toFixed(0)} ms`);
    assert.ok(patches > 90_000 && size < 100 * patches, `${size} bytes for ${patches} patches`);
    await page.done();
}

const browser = await launch();
try {
    for (const test of [pictures, lightmap, readings, lamps, methods, handling, large]) {
        await test(browser);
        console.log(`${test.name}: passed`);
    }
} finally {
    await browser.close();
}
