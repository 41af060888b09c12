// The pages with charts: points are read with the cursor and with keys, and their numbers are those of the report.

import assert from 'node:assert/strict';
import { readFileSync } from 'node:fs';
import { keep, launch, near, open, run } from './browser.mjs';

// The words beside the cursor at a point of a chart.
async function hover(page, chart, point) {
    const [x, y] = await page.evaluate((chart, point) => {
        const { svg, points, width } = radiosity.charts[chart];
        svg.scrollIntoView({ block: 'center' });
        const box = svg.getBoundingClientRect();
        return points[point].at.map((v, k) => [box.left, box.top][k] + (v * box.width) / width);
    }, chart, point);
    await page.mouse.move(x, y);
    return page.evaluate((chart) => radiosity.charts[chart].tip.textContent, chart);
}

async function tradeoff(browser) {
    run('tradeoff', 'cornell-box.obj', '-o', 'tradeoff', '--patches', '100', '--most-rays', '200000');
    const report = JSON.parse(readFileSync('tradeoff/tradeoff.json'));
    const page = await open(browser, 'tradeoff/tradeoff.html', { width: 900, height: 800 });
    const counts = await page.evaluate(() => radiosity.charts.map((chart) => chart.data.series
        .filter((s) => !s.name.includes('estimated')).reduce((sum, s) => sum + s.points.length, 0)));
    assert.equal(counts[0] + counts[1], report.points.length);
    const points = await page.evaluate(() => radiosity.charts[0].points.map((p) => [p.x, p.y, p.series.name]));
    for (const k of [0, Math.floor(points.length / 2), points.length - 1]) {
        const words = await hover(page, 0, k);
        const found = words.match(/solving and error bars: ([\d.e+-]+) s\nerror: ([\d.e+-]+) %/);
        assert.ok(found, words);
        // Another point may lie under the cursor too.
        assert.ok(points.some((p) => Math.abs(p[0] / found[1] - 1) < 1e-3 && Math.abs(p[1] / found[2] - 1) < 1e-3), words);
    }
    await keep(page, 'tradeoff');
    await page.done();
}

async function validation(browser) {
    try {
        run('validate', 'cornell-box.obj', '--plots', 'plots.html', '--report', 'validation.json', '--patches', '300', '--paths', '256', '--particles', '400000');
    } catch (error) {
        console.log(String(error).split('\n')[0]);
    }
    const report = JSON.parse(readFileSync('validation.json'));
    const page = await open(browser, 'plots.html', { width: 900, height: 800 });
    const verdict = await page.$eval('main > p', (p) => [p.className, p.textContent]);
    assert.equal(verdict[0], report.valid ? 'passed' : 'failed');
    const [scatter, z] = await page.evaluate(() => radiosity.charts.map((chart) => chart.data.series.map((s) => s.points)));
    assert.equal(scatter.length, 2);
    // The mean square of the z-scores, from the middles of the steps, whose width adds a twelfth of its square.
    const spread = Math.sqrt(z[0].reduce((sum, p) => sum + (p.y / 100) * p.x ** 2, 0) - 0.5 ** 2 / 12);
    near(spread, report.comparisons[0].z_spread, 0.15, 'the spread of z-scores');
    near(z[0].reduce((sum, p) => sum + p.y, 0), 100, 1e-6, 'all shares');
    assert.match(await hover(page, 0, 5), /patch \d+ of `/);
    // Keys read the points one after the other.
    await page.focus('.chart');
    await page.keyboard.press('ArrowRight');
    const first = await page.evaluate(() => radiosity.charts[0].tip.textContent);
    await page.keyboard.press('ArrowRight');
    assert.notEqual(await page.evaluate(() => radiosity.charts[0].tip.textContent), first);
    await page.click('details summary');
    await page.waitForFunction(() => document.querySelectorAll('tbody tr').length > 100);
    await keep(page, 'validation');
    await page.done();
}

async function daylight(browser) {
    // The sky shines into the box through its open side.
    run('daylight', 'cornell-box.obj', '-o', 'daylight.npz', '--plots', 'daylight.html', '--report', 'daylight.json', '--quality', 'draft');
    const report = JSON.parse(readFileSync('daylight.json'));
    for (const scheme of ['light', 'dark']) {
        const page = await open(browser, 'daylight.html', { width: 360, height: 700, scheme });
        const [points] = await page.evaluate(() => radiosity.charts[0].data.series.map((s) => s.points));
        assert.equal(points.at(-1).y, 100);
        const note = await page.$$eval('main > p', (all) => all.map((p) => p.textContent).join(' '));
        assert.ok(report.mean_daylight_factor > 0.001);
        near(Number(note.match(/mean daylight factor is ([\d.]+) %/)[1]), 100 * report.mean_daylight_factor, 0.005, 'the mean');
        const width = await page.evaluate(() => document.documentElement.scrollWidth);
        assert.ok(width <= 360, `the page is ${width} pixels wide in a window of 360`);
        await keep(page, `daylight-${scheme}`);
        await page.done();
    }
}

const browser = await launch();
try {
    for (const test of [tradeoff, validation, daylight]) {
        await test(browser);
        console.log(`${test.name}: passed`);
    }
} finally {
    await browser.close();
}
