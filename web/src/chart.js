// A page of charts. The points are read with the cursor, with a finger, or with the arrow keys.

import { about as readAbout } from './data.js';
import { number, step, unit as written } from './scale.js';

const SVG = 'http://www.w3.org/2000/svg';
const [LEFT, RIGHT, TOP, BOTTOM] = [70, 16, 12, 48];

function make(name, attributes = {}, ...children) {
    const element = document.createElement(name);
    Object.entries(attributes).forEach(([key, value]) => element.setAttribute(key, value));
    element.append(...children);
    return element;
}

function draw(parent, name, attributes, text) {
    const element = document.createElementNS(SVG, name);
    Object.entries(attributes).forEach(([key, value]) => element.setAttribute(key, value));
    if (text !== undefined) {
        element.textContent = text;
    }
    parent.append(element);
    return element;
}

// An axis from values to pixels, with the values that get a line and a label.
class Axis {
    constructor({ label, unit, log }, values, from, to) {
        Object.assign(this, { label, unit, log, from, to });
        const good = values.filter((x) => Number.isFinite(x) && (!log || x > 0));
        let [low, high] = good.length ? [good.reduce((a, b) => Math.min(a, b)), good.reduce((a, b) => Math.max(a, b))] : [log ? 0.1 : 0, 1];
        if (log) {
            [this.low, this.high] = [low / 1.5, high * 1.5];
        } else {
            const by = step(high - low || Math.abs(high) || 1);
            [this.low, this.high] = [Math.floor(low / by) * by, Math.ceil(high / by) * by];
            if (this.low === this.high) {
                this.high += by;
            }
        }
    }

    at(value) {
        const f = this.log ? Math.log : (x) => x;
        return this.from + ((this.to - this.from) * (f(value) - f(this.low))) / (f(this.high) - f(this.low));
    }

    holds(value) {
        return Number.isFinite(value) && value >= this.low && value <= this.high;
    }

    ticks() {
        // A label needs about 80 pixels.
        const many = Math.max(2, Math.abs(this.to - this.from) / 80);
        if (!this.log) {
            const by = step(this.high - this.low, Math.min(6, many));
            const first = Math.ceil(this.low / by - 1e-6);
            const count = Math.floor(this.high / by + 1e-6) - first + 1;
            return Array.from({ length: count }, (_, k) => (first + k) * by);
        }
        const decades = Math.log10(this.high / this.low);
        const digits = 3 * decades < many ? [1, 2, 5] : [1];
        const [first, last] = [Math.floor(Math.log10(this.low)), Math.ceil(Math.log10(this.high))];
        const every = Math.ceil(decades / many);
        return Array.from({ length: last - first + 1 }, (_, k) => first + k)
            .filter((power) => power % every === 0)
            .flatMap((power) => digits.map((digit) => Number(`${digit}e${power}`)))
            .filter((value) => this.holds(value));
    }
}

const MARKS = {
    dot: (x, y) => ['circle', { cx: x, cy: y, r: 4 }],
    ring: (x, y) => ['circle', { cx: x, cy: y, r: 4, hollow: 1 }],
    small: (x, y) => ['circle', { cx: x, cy: y, r: 2, 'fill-opacity': 0.55 }],
    diamond: (x, y) => ['path', { d: `M${x} ${y - 6}l6 6l-6 6l-6-6z` }],
    cross: (x, y) => ['path', { d: `M${x - 4} ${y - 4}l8 8m0-8l-8 8`, hollow: 1 }],
};

class Chart {
    constructor(parent, data) {
        this.data = data;
        this.hidden = new Set();
        this.box = make('div', { class: 'chart' });
        this.tip = make('div', { class: 'tip', role: 'status' });
        this.tip.hidden = true;
        const section = make('section', {}, make('h2', {}, data.title));
        if (data.text) {
            section.append(make('p', {}, data.text));
        }
        section.append(this.box, this.key(), this.table());
        parent.append(section);
        this.draw();
        new ResizeObserver(() => this.box.clientWidth !== this.drawn && this.draw()).observe(this.box);
        this.box.tabIndex = 0;
        this.box.setAttribute('role', 'group');
        this.box.setAttribute('aria-label', `${data.title}. Left and right arrow keys read the points.`);
        this.box.addEventListener('pointermove', (event) => this.near(event));
        this.box.addEventListener('pointerdown', (event) => this.near(event));
        this.box.addEventListener('pointerleave', () => this.show(null));
        this.box.addEventListener('blur', () => this.show(null));
        this.box.addEventListener('keydown', (event) => {
            const by = { ArrowRight: 1, ArrowDown: 1, ArrowLeft: -1, ArrowUp: -1 }[event.key];
            if (by && this.points.length) {
                event.preventDefault();
                const next = (this.points.indexOf(this.current) + by + this.points.length) % this.points.length;
                this.show(this.points[next]);
            }
        });
    }

    draw() {
        const { data } = this;
        // One unit is one pixel, so that letters are as large as elsewhere.
        this.drawn = this.box.clientWidth;
        const WIDTH = Math.max(280, this.drawn - 18);
        const HEIGHT = Math.max(260, Math.min(430, 0.55 * WIDTH));
        this.width = WIDTH;
        const shown = data.series.filter((_, k) => !this.hidden.has(k));
        const of = (k) => data.series.flatMap((s) => s.points.map((p) => p[k]));
        const x = new Axis(data.x, of('x'), LEFT, WIDTH - RIGHT);
        const y = new Axis(data.y, [...of('y'), ...(data.band ? [data.band] : [])], HEIGHT - BOTTOM, TOP);
        const svg = document.createElementNS(SVG, 'svg');
        svg.setAttribute('viewBox', `0 0 ${WIDTH} ${HEIGHT}`);
        svg.setAttribute('aria-hidden', 'true');
        this.svg = svg;
        if (data.band) {
            const top = y.at(data.band);
            draw(svg, 'rect', { class: 'band', x: LEFT, y: top, width: WIDTH - RIGHT - LEFT, height: HEIGHT - BOTTOM - top });
        }
        for (const value of x.ticks()) {
            draw(svg, 'line', { class: 'grid', x1: x.at(value), x2: x.at(value), y1: TOP, y2: HEIGHT - BOTTOM });
            draw(svg, 'text', { x: x.at(value), y: HEIGHT - BOTTOM + 16, 'text-anchor': 'middle' }, number(value, 3));
        }
        for (const value of y.ticks()) {
            draw(svg, 'line', { class: 'grid', x1: LEFT, x2: WIDTH - RIGHT, y1: y.at(value), y2: y.at(value) });
            draw(svg, 'text', { x: LEFT - 6, y: y.at(value) + 4, 'text-anchor': 'end' }, number(value, 3));
        }
        const name = ({ label, unit }) => (unit ? `${label}, ${unit}` : label);
        draw(svg, 'text', { x: (LEFT + WIDTH - RIGHT) / 2, y: HEIGHT - 8, 'text-anchor': 'middle' }, name(data.x));
        draw(svg, 'text', {
            x: 14, y: (TOP + HEIGHT - BOTTOM) / 2, 'text-anchor': 'middle', transform: `rotate(-90 14 ${(TOP + HEIGHT - BOTTOM) / 2})`,
        }, name(data.y));
        this.points = [];
        for (const line of data.lines ?? []) {
            const ends = [[line.from[0], line.from[1]], [line.to[0], line.to[1]]].map(([a, b]) => [x.at(a), y.at(b)]);
            draw(svg, 'path', { class: 'axis', fill: 'none', 'stroke-dasharray': '4 3', d: `M${ends[0]}L${ends[1]}` });
        }
        for (const series of shown) {
            const places = series.points.filter((p) => x.holds(p.x) && y.holds(p.y)).map((p) => ({ ...p, at: [x.at(p.x), y.at(p.y)], series }));
            if (series.line && places.length > 1) {
                draw(svg, 'path', {
                    fill: 'none', stroke: series.colour, 'stroke-width': 2, d: `M${places.map((p) => p.at).join('L')}`,
                    ...(series.line === 'dashed' ? { 'stroke-dasharray': '6 4' } : {}),
                });
            }
            for (const p of places) {
                const [shape, { hollow, ...attributes }] = MARKS[series.mark](...p.at);
                const look = hollow ? { fill: 'none', stroke: series.colour, 'stroke-width': 2 } : { fill: series.colour };
                draw(svg, shape, { ...look, ...attributes });
            }
            this.points.push(...places);
        }
        this.points.sort((a, b) => a.at[0] - b.at[0]);
        this.ring = draw(svg, 'circle', { class: 'near', r: 7, visibility: 'hidden' });
        this.box.replaceChildren(svg, this.tip);
        this.current = null;
    }

    near(event) {
        const box = this.svg.getBoundingClientRect();
        const scale = this.width / box.width;
        const [px, py] = [(event.clientX - box.left) * scale, (event.clientY - box.top) * scale];
        let best = null;
        let nearest = 40;
        for (const p of this.points) {
            const distance = Math.hypot(p.at[0] - px, p.at[1] - py);
            if (distance < nearest) {
                [best, nearest] = [p, distance];
            }
        }
        this.show(best);
    }

    show(point) {
        this.current = point;
        this.tip.hidden = !point;
        this.ring.setAttribute('visibility', point ? 'visible' : 'hidden');
        if (!point) {
            return;
        }
        this.ring.setAttribute('cx', point.at[0]);
        this.ring.setAttribute('cy', point.at[1]);
        this.tip.textContent = this.words(point);
        const box = this.box.getBoundingClientRect();
        const scale = this.svg.getBoundingClientRect().width / this.width;
        const x = Math.max(4, Math.min(box.width - this.tip.offsetWidth - 4, point.at[0] * scale + 14));
        const above = point.at[1] * scale - this.tip.offsetHeight - 10;
        this.tip.style.left = `${x}px`;
        this.tip.style.top = `${above > 0 ? above : point.at[1] * scale + 18}px`;
    }

    words(point) {
        const { x, y } = this.data;
        const value = (axis, v) => `${number(v)}${axis.unit ? ` ${axis.unit}` : ''}`;
        return `${point.series.name}\n${x.label}: ${value(x, point.x)}\n${y.label}: ${value(y, point.y)}${point.text ? `\n${point.text}` : ''}`;
    }

    key() {
        const list = make('ul', { class: 'key' });
        this.data.series.forEach((series, k) => {
            const box = make('input', { type: 'checkbox', checked: '' });
            box.addEventListener('change', () => {
                this.hidden[box.checked ? 'delete' : 'add'](k);
                this.draw();
            });
            const swatch = make('span', { class: 'swatch' });
            swatch.style.background = series.colour;
            list.append(make('li', {}, make('label', {}, box, swatch, series.name)));
        });
        return list;
    }

    // The same points as text; the first thousand, because a table of more helps nobody.
    table() {
        const MOST = 1000;
        const { x, y, series } = this.data;
        const all = series.flatMap((s) => s.points.map((p) => [s.name, number(p.x), number(p.y), p.text ?? '']));
        const name = (axis) => (axis.unit ? `${axis.label}, ${axis.unit}` : axis.label);
        const row = (cells, kind) => make('tr', {}, ...cells.map((cell) => make(kind, {}, cell)));
        const summary = all.length > MOST ? `The first ${MOST} of ${all.length} points as a table` : 'The points as a table';
        const details = make('details', {}, make('summary', {}, summary));
        details.addEventListener('toggle', () => {
            if (details.open && details.children.length === 1) {
                const rows = all.slice(0, MOST).map((cells) => row(cells, 'td'));
                details.append(make('div', { class: 'scroll', tabindex: 0 },
                    make('table', {}, make('thead', {}, row(['', name(x), name(y), ''], 'th')), make('tbody', {}, ...rows))));
            }
        });
        return details;
    }
}

const about = readAbout();
for (const { x, y } of about.charts) {
    [x.unit, y.unit] = [written(x.unit), written(y.unit)];
}
const main = document.getElementById('main');
main.append(make('h1', {}, about.title));
if (about.verdict) {
    main.append(make('p', { class: about.verdict.passed ? 'passed' : 'failed' }, about.verdict.text));
}
main.append(...about.notes.map((note) => make('p', {}, note)));
// For scripts and for tests.
window.radiosity = { charts: about.charts.map((chart) => new Chart(main, chart)) };
document.documentElement.dataset.ready = 'yes';
