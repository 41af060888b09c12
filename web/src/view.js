// The page of a solved scene: joins the model, the picture, the camera and the panel.

import { Raycaster, Vector2 } from 'three';
import { about as readAbout } from './data.js';
import { Model } from './model.js';
import { Moving } from './moving.js';
import { Panel } from './panel.js';
import { Picture } from './picture.js';
import { quantities } from './quantities.js';
import { DIVERGING, SEQUENTIAL, rounded, step, unit } from './scale.js';

// Faces up to which the point under the cursor is read as it moves.
const HOVER = 400_000;

class View {
    constructor() {
        this.about = readAbout();
        this.model = new Model(this.about);
        this.canvas = document.getElementById('canvas');
        this.picture = new Picture(this.canvas, this.model);
        this.state = {
            method: 0,
            show: 'picture',
            exposure: 0,
            smooth: true,
            edges: false,
            isolines: false,
            backs: false,
            logarithmic: false,
            most: null,
            weights: this.about.layers.map(() => 1),
        };
        this.quantities = quantities(this.model);
        this.moving = new Moving(this.picture.camera, this.canvas, this.about.up, () => this.moved());
        this.panel = new Panel(this);
        this.firstView();
        this.fromAddress();
        this.update();
        new ResizeObserver(() => this.resize()).observe(this.canvas.parentElement);
        this.resize();
        this.listen();
        (this.picture.loading ? Promise.all(this.picture.loading) : Promise.resolve()).then(() => {
            this.invalidate();
            document.documentElement.dataset.ready = 'yes';
        });
    }

    listen() {
        const { canvas } = this;
        let pressed = null;
        canvas.addEventListener('pointerdown', (event) => {
            pressed = [event.clientX, event.clientY];
            this.panel.hint(null);
        });
        canvas.addEventListener('pointerup', (event) => {
            if (pressed && Math.hypot(event.clientX - pressed[0], event.clientY - pressed[1]) < 5) {
                this.select(this.at(event));
            }
            pressed = null;
        });
        canvas.addEventListener('dblclick', (event) => {
            const hit = this.hit(this.at(event));
            if (hit && this.moving.mode === 'orbit') {
                this.moving.place(this.picture.camera.position.toArray(), hit.point);
            }
        });
        canvas.addEventListener('pointermove', (event) => {
            if (event.pointerType === 'mouse' && !pressed && this.model.faces.length / 3 <= HOVER) {
                this.hovered = event;
                this.invalidate();
            }
        });
        canvas.addEventListener('pointerleave', () => {
            this.hovered = null;
            this.panel.hint(null);
        });
        canvas.addEventListener('keydown', (event) => this.key(event));
        canvas.addEventListener('webglcontextlost', (event) => {
            event.preventDefault();
            this.panel.say('The browser has stopped the drawing. Reload the page.');
        });
        addEventListener('hashchange', () => {
            if (location.hash !== this.written) {
                this.fromAddress();
                this.update();
            }
        });
    }

    key(event) {
        if (event.ctrlKey || event.metaKey || event.altKey) {
            return;
        }
        const shown = this.shown();
        const digit = Number(event.key);
        if (event.key === 'Enter') {
            this.select([0, 0]);
        } else if (event.key === 'o' || event.key === 'p') {
            this.setMode(event.key === 'o' ? 'orbit' : 'walk');
        } else if (event.key === '[' || event.key === ']') {
            this.set({ exposure: this.state.exposure + (event.key === ']' ? 0.5 : -0.5) });
        } else if (digit >= 1 && digit <= shown.length) {
            this.set({ show: shown[digit - 1].name });
        } else {
            return;
        }
        event.preventDefault();
    }

    // Where an event is in the picture, from -1 to 1.
    at(event) {
        const box = this.canvas.getBoundingClientRect();
        return [
            (2 * (event.clientX - box.left)) / box.width - 1,
            1 - (2 * (event.clientY - box.top)) / box.height,
        ];
    }

    hit([x, y]) {
        const { camera } = this.picture;
        camera.updateMatrixWorld();
        const caster = new Raycaster();
        caster.setFromCamera(new Vector2(x, y), camera);
        return this.model.hit(caster.ray.origin.toArray(), caster.ray.direction.toArray(), this.state.backs);
    }

    select(at) {
        const hit = this.hit(at);
        this.selectedHit = hit;
        this.selected = hit && this.read(hit);
        this.picture.uniforms.selected.value = hit && !this.model.isLightmap ? hit.patch : -1;
        this.panel.reading(this.selected);
        this.invalidate();
    }

    // The numbers of a point, in the units of the file.
    read(hit) {
        const { model, state, about } = this;
        const i = hit.patch;
        const rgb = (values, factor = model.unit) => values && [0, 1, 2].map((c) => values[3 * i + c] * factor);
        const reading = {
            patch: i,
            triangle: model.triangle[i],
            side: model.flags[i] & 1 ? 'back' : 'front',
            material: about.materials[model.material[i]].name,
            position: model.toFile(hit.point),
            methods: [],
        };
        if (model.isLightmap) {
            const texel = this.picture.texel(hit);
            const irradiance = hit.front ? texel.light.map((x) => x * model.unit) : [0, 0, 0];
            const emitted = rgb(this.light.emission);
            reading.texel = { page: texel.page, x: texel.x, y: texel.y };
            reading.irradiance = irradiance;
            reading.radiosity = irradiance.map((e, c) => (hit.front ? emitted[c] + e * model.reflectance[3 * i + c] : 0));
            return reading;
        }
        if (!hit.front) {
            return { ...reading, unlit: true };
        }
        reading.irradiance = rgb(this.light.patch);
        const emitted = rgb(this.light.emission);
        reading.radiosity = reading.irradiance.map((e, c) => emitted[c] + e * model.reflectance[3 * i + c]);
        reading.error = rgb(model.error(state.method, state.weights));
        reading.discretisation = rgb(model.discretised(state.method, state.weights));
        reading.centre = model.toFile([...model.centre.subarray(3 * i, 3 * i + 3)]);
        reading.area = model.area[i] * about.radius ** 2;
        reading.methods = about.methods.map((method, m) => {
            const sum = (values) => values.length && [0, 1, 2].map((c) => values.reduce((s, x) => s + x[c], 0));
            const irradiance = sum(method.layers.map((k) => rgb(model.layers[k].patch, model.unit * state.weights[k])));
            return { name: method.name, irradiance, error: rgb(model.error(m, state.weights)) };
        });
        return reading;
    }

    // Changes settings: a part of `state`.
    set(changes) {
        if ('show' in changes && changes.show !== this.state.show) {
            this.state.most = null;
        }
        Object.assign(this.state, changes);
        this.state.exposure = Math.max(-20, Math.min(20, Math.round(this.state.exposure * 100) / 100));
        this.update();
    }

    // What can be shown now.
    shown() {
        return this.quantities.filter((q) => q.isKnown(this.state));
    }

    // Brings the picture and the panel up to date with the settings.
    update() {
        const { state, model, picture } = this;
        if (!this.shown().some((q) => q.name === state.show)) {
            state.show = 'picture';
        }
        const quantity = this.quantities.find((q) => q.name === state.show);
        const mixed = [state.method, state.show, ...state.weights].join();
        if (mixed !== this.mixed) {
            this.mixed = mixed;
            this.light = model.light(state.method, state.weights);
            this.number = quantity.number?.(state) ?? null;
            picture.setLight(this.light, this.number);
            const scaled = quantity.code === 0 ? this.quantities.find((q) => q.name === 'irradiance') : quantity;
            this.most = rounded(scaled.most(this.light, this.number) * scaled.factor);
        }
        picture.setBacks(state.backs);
        const u = picture.uniforms;
        u.show.value = quantity.code;
        u.exposure.value = (model.unit / this.about.white) * 2 ** state.exposure;
        u.smoothed.value = state.smooth;
        u.edges.value = state.edges;
        u.isolines.value = state.isolines;
        u.logarithmic.value = state.logarithmic && !quantity.diverges;
        this.scale = this.scaleOf(quantity);
        u.range.value.set(this.scale.low / quantity.factor, this.scale.most / quantity.factor);
        u.isostep.value = this.scale.step / quantity.factor;
        const colours = quantity.diverges ? DIVERGING : SEQUENTIAL;
        colours.forEach((colour, k) => u.colours.value[k].set(...colour.map((x) => x / 255)));
        if (this.selected) {
            this.selected = this.read(this.selectedHit);
            this.panel.reading(this.selected);
        }
        this.panel.update(quantity, colours);
        this.moved();
    }

    // The ends and the step of the scale of a quantity, in its unit.
    scaleOf(quantity) {
        const most = (quantity.code === 0 ? null : this.state.most) ?? this.most;
        const low = quantity.diverges ? -most : this.state.logarithmic ? most / 1000 : 0;
        const name = quantity.code === 0 ? this.about.units.irradiance : quantity.unit;
        return { low, most, step: step(quantity.diverges ? 2 * most : most), unit: unit(name) };
    }

    setMode(mode) {
        this.moving.lookAt();
        this.moving.setMode(mode);
        this.panel.mode(mode);
        this.invalidate();
    }

    firstView() {
        const { eye, look_at } = this.about.camera;
        this.fov = null;
        this.moving.place(this.model.fromFile(eye), this.model.fromFile(look_at));
        this.invalidate();
    }

    // The vertical angle of view. That of the first view holds as much of the scene in a narrow window as in a wide one.
    angle() {
        const { fov, width, height } = this.about.camera;
        if (this.fov !== null) {
            return this.fov;
        }
        const aspect = this.picture.camera.aspect;
        const half = Math.tan((fov * Math.PI) / 360) * Math.max(1, width / height / aspect);
        return (Math.atan(half) * 360) / Math.PI;
    }

    camera() {
        const round = (x) => Number(x.toPrecision(7));
        const size = this.about.radius * 1e-6;
        const place = (p) => this.model.toFile(p).map((x) => (Math.abs(x) < size ? 0 : round(x)));
        return {
            eye: place(this.picture.camera.position.toArray()),
            lookAt: place(this.moving.lookAt()),
            up: this.about.up,
            fov: round(this.angle()),
        };
    }

    // As options of the program, for the same picture.
    options() {
        const { eye, lookAt, up, fov } = this.camera();
        const { width, height } = this.canvas;
        const white = this.about.white / Math.PI / 2 ** this.state.exposure;
        return `--eye ${eye} --look-at ${lookAt} --up ${up} --fov ${fov} --width ${width} --height ${height} `
            + `--white ${Number(white.toPrecision(6))}`;
    }

    toAddress() {
        const { eye, lookAt, fov } = this.camera();
        const { state, about } = this;
        const parts = [`eye=${eye}`, `look-at=${lookAt}`, `fov=${fov}`];
        const say = (name, value, usual) => value !== usual && parts.push(`${name}=${encodeURIComponent(value)}`);
        say('mode', this.moving.mode, 'orbit');
        say('method', about.methods[state.method].name, about.methods[0].name);
        say('show', state.show, 'picture');
        say('exposure', state.exposure, 0);
        say('most', state.most, null);
        ['edges', 'isolines', 'backs', 'logarithmic'].forEach((name) => say(name, state[name], false));
        say('smooth', state.smooth, true);
        if (state.weights.some((weight) => weight !== 1)) {
            parts.push(`lamps=${state.weights}`);
        }
        return `#${parts.join('&')}`;
    }

    fromAddress() {
        const given = new URLSearchParams(location.hash.slice(1));
        const numbers = (name, count) => {
            const found = (given.get(name) ?? '').split(',').map(Number);
            return found.length === count && found.every(Number.isFinite) && given.get(name) ? found : null;
        };
        const { state } = this;
        const [eye, lookAt, fov] = [numbers('eye', 3), numbers('look-at', 3), numbers('fov', 1)];
        if (fov && fov[0] > 0 && fov[0] < 180) {
            this.fov = fov[0];
        }
        const mode = given.get('mode') === 'walk' ? 'walk' : 'orbit';
        if (eye && lookAt) {
            this.moving.place(this.model.fromFile(eye), this.model.fromFile(lookAt), mode);
        }
        this.panel.mode(mode);
        const method = this.about.methods.findIndex((m) => m.name === given.get('method'));
        state.method = Math.max(0, method);
        state.show = given.get('show') ?? state.show;
        state.exposure = numbers('exposure', 1)?.[0] ?? state.exposure;
        state.most = numbers('most', 1)?.find((x) => x > 0) ?? state.most;
        ['edges', 'isolines', 'backs', 'logarithmic', 'smooth'].forEach((name) => {
            if (given.has(name)) {
                state[name] = given.get(name) === 'true';
            }
        });
        state.weights = numbers('lamps', state.weights.length)?.map((x) => Math.max(0, x)) ?? state.weights;
    }

    moved() {
        this.invalidate();
        clearTimeout(this.writing);
        this.writing = setTimeout(() => {
            this.written = this.toAddress();
            try {
                history.replaceState(null, '', this.written);
            } catch {
                // A browser that forbids it shows the same page without the camera in its address.
            }
            this.panel.options(this.options());
        }, 250);
    }

    resize() {
        const { clientWidth, clientHeight } = this.canvas.parentElement;
        if (clientWidth && clientHeight) {
            this.picture.resize(clientWidth, clientHeight, Math.min(devicePixelRatio, 2));
            this.moved();
        }
    }

    invalidate() {
        if (!this.waiting) {
            this.waiting = requestAnimationFrame((now) => {
                this.waiting = null;
                const seconds = Math.min(0.1, (now - (this.last ?? now)) / 1000);
                this.last = this.moving.advance(seconds) ? now : null;
                if (this.last !== null) {
                    this.moved();
                }
                this.draw();
                if (this.hovered) {
                    this.hover(this.hovered);
                    this.hovered = null;
                }
            });
        }
    }

    hover(event) {
        const hit = this.hit(this.at(event));
        this.panel.hint(hit && this.panel.short(this.read(hit), this.number), event);
    }

    draw() {
        this.picture.camera.fov = this.angle();
        this.picture.draw();
    }

    // The picture as a PNG, of the size of the window or another.
    still(width, height) {
        const { clientWidth, clientHeight } = this.canvas.parentElement;
        if (width) {
            this.picture.resize(width, height, 1);
        }
        this.draw();
        const url = this.canvas.toDataURL('image/png');
        if (width) {
            this.picture.resize(clientWidth, clientHeight, Math.min(devicePixelRatio, 2));
            this.draw();
        }
        return url;
    }
}

try {
    // For scripts and for tests: `radiosity.set({exposure: 1})`, `radiosity.select([0, 0])`, `radiosity.still()`.
    window.radiosity = new View();
} catch (error) {
    const message = document.getElementById('message');
    const canDraw = document.createElement('canvas').getContext('webgl2');
    message.textContent = canDraw ? `The page cannot be shown: ${error.message}`
        : 'This page needs WebGL 2, which this browser does not offer or has turned off.';
    message.hidden = false;
    throw error;
}
