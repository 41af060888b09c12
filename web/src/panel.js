// The controls beside the picture, and what they say.

import { LUMINANCE, css, luminance, number, unit } from './scale.js';

const $ = (id) => document.getElementById(id);

// An element with attributes and children.
function make(name, attributes = {}, ...children) {
    const element = document.createElement(name);
    for (const [key, value] of Object.entries(attributes)) {
        element.setAttribute(key, value);
    }
    element.append(...children);
    return element;
}

export class Panel {
    constructor(view) {
        this.view = view;
        const { about } = view;
        $('name').textContent = about.title;
        this.names = { irradiance: unit(about.units.irradiance), radiosity: unit(about.units.radiosity) };
        about.methods.forEach((method, m) => $('method').append(make('option', { value: m }, method.name)));
        $('method-row').hidden = about.methods.length < 2;
        if (view.model.isLightmap) {
            $('smooth-name').textContent = 'Smooth texels';
            $('edges-name').textContent = 'Texels';
        }
        this.lamps();
        $('about-text').append(...about.notes.map((note) => make('p', {}, note)));
        this.listen();
        if (matchMedia('(max-width: 700px)').matches) {
            this.fold(true);
        }
    }

    listen() {
        const { view } = this;
        const on = (id, event, action) => $(id).addEventListener(event, (e) => action(e.target, e));
        on('method', 'change', (select) => view.set({ method: Number(select.value) }));
        on('show', 'change', (select) => view.set({ show: select.value }));
        on('exposure', 'input', (range) => view.set({ exposure: Number(range.value) }));
        on('smooth', 'change', (box) => view.set({ smooth: box.checked }));
        on('edges', 'change', (box) => view.set({ edges: box.checked }));
        on('isolines', 'change', (box) => view.set({ isolines: box.checked }));
        on('backs', 'change', (box) => view.set({ backs: box.checked }));
        on('log', 'change', (box) => view.set({ logarithmic: box.checked }));
        on('most', 'change', (input) => view.set({ most: Number(input.value) > 0 ? Number(input.value) : null }));
        on('orbit', 'change', () => view.setMode('orbit'));
        on('walk', 'change', () => view.setMode('walk'));
        on('reset', 'click', () => view.firstView());
        on('still', 'click', () => this.save());
        on('copy-link', 'click', () => this.copy(location.href.split('#')[0] + view.toAddress(), 'The link is in the clipboard.'));
        on('copy-options', 'click', () => this.copy(view.options(), 'The options are in the clipboard.'));
        on('options', 'focus', (area) => area.select());
        on('toggle', 'click', () => this.fold(!$('panel').classList.contains('closed')));
        for (const button of $('pad').children) {
            const action = button.dataset.hold;
            button.addEventListener('pointerdown', () => view.moving.hold(action));
            ['pointerup', 'pointercancel', 'pointerleave', 'blur'].forEach((name) =>
                button.addEventListener(name, () => view.moving.release(action)));
            button.addEventListener('keydown', (event) => {
                if (event.key === ' ' || event.key === 'Enter') {
                    event.preventDefault();
                    view.moving.hold(action);
                }
            });
            button.addEventListener('keyup', () => view.moving.release(action));
        }
    }

    fold(closed) {
        $('panel').classList.toggle('closed', closed);
        $('toggle').setAttribute('aria-expanded', String(!closed));
    }

    // A slider and a switch for each lamp, where light is known by lamp.
    lamps() {
        const { view } = this;
        const { layers } = view.about;
        const dimmable = view.about.methods[0].layers;
        $('lamps').hidden = dimmable.length < 2;
        this.sliders = dimmable.length < 2 ? [] : dimmable.map((k) => {
            const id = `lamp-${k}`;
            const box = make('input', { type: 'checkbox', id: `${id}-on`, checked: '' });
            const range = make('input', { type: 'range', id, min: 0, max: 200, step: 1, value: 100, 'aria-label': `${layers[k].name}, percent` });
            const output = make('output', { for: id });
            let before = 1;
            const weigh = (weight) => view.set({ weights: view.state.weights.map((w, l) => (l === k ? weight : w)) });
            range.addEventListener('input', () => weigh(range.value / 100));
            box.addEventListener('change', () => {
                before = view.state.weights[k] || before;
                weigh(box.checked ? before : 0);
            });
            $('lamp-list').append(
                make('div', { class: 'lamp' }, make('label', {}, box, ' ', layers[k].name), make('div', {}, range, output)));
            return { k, box, range, output };
        });
    }

    update(quantity, colours) {
        const { view } = this;
        const { state } = view;
        const shown = view.shown();
        const names = shown.map((q) => q.name).join();
        if (names !== this.listed) {
            this.listed = names;
            $('show').replaceChildren(...shown.map((q) => make('option', { value: q.name }, unit(q.label))));
        }
        $('show').value = state.show;
        $('method').value = state.method;
        $('exposure').value = state.exposure;
        $('exposure-value').textContent = `${state.exposure > 0 ? '+' : ''}${number(state.exposure)} stops`;
        for (const [id, name] of [['smooth', 'smooth'], ['edges', 'edges'], ['isolines', 'isolines'], ['backs', 'backs'], ['log', 'logarithmic']]) {
            $(id).checked = state[name];
        }
        for (const { k, box, range, output } of this.sliders) {
            box.checked = state.weights[k] > 0;
            range.value = 100 * state.weights[k];
            output.textContent = `${number(100 * state.weights[k])} %`;
        }
        const inColours = quantity.code !== 0;
        $('scale-row').hidden = !inColours;
        $('log').disabled = Boolean(quantity.diverges);
        $('isolines').disabled = quantity.code === 3;
        $('smooth').disabled = quantity.code === 3;
        $('exposure').disabled = inColours;
        if (document.activeElement !== $('most')) {
            $('most').value = number(view.scale.most, 6);
        }
        $('scale-unit').textContent = view.scale.unit;
        this.legend(quantity, colours, inColours);
    }

    // The scale of false colours, or the distance of isolines.
    legend(quantity, colours, inColours) {
        const { low, most, step, unit: name } = this.view.scale;
        const { isolines, logarithmic } = this.view.state;
        const legend = $('legend');
        legend.hidden = !inColours && !isolines;
        if (!inColours) {
            legend.textContent = `Isolines of irradiance every ${number(step)} ${name}`;
            return;
        }
        const isLog = logarithmic && !quantity.diverges;
        const bar = make('div', { class: 'bar' });
        bar.style.background = `linear-gradient(90deg, ${colours.map(css).join(', ')})`;
        const ticks = make('div', { class: 'ticks' });
        const values = isLog
            ? Array.from({ length: Math.round(Math.log10(most / low)) + 1 }, (_, k) => low * 10 ** k)
            : Array.from({ length: Math.floor((most - low) / step + 1e-6) + 1 }, (_, k) => low + k * step);
        for (const value of values) {
            const share = isLog ? Math.log(value / low) / Math.log(most / low) : (value - low) / (most - low);
            const tick = make('span', {}, number(Math.abs(value) < 1e-9 * most ? 0 : value, 3));
            tick.style.left = `${100 * share}%`;
            ticks.append(tick);
        }
        const lines = isolines && quantity.code !== 3 ? `; isolines every ${number(step)} ${name}` : '';
        legend.replaceChildren(make('div', {}, `${unit(quantity.label)}${lines}`), bar, ticks);
    }

    mode(mode) {
        $(mode).checked = true;
        $('pad').classList.toggle('shown', mode === 'walk');
    }

    options(text) {
        $('options').value = text;
    }

    // A number with its error bar, a line for each channel where they differ.
    measured(values, errors, name) {
        const channels = this.view.about.channels === 1 ? [luminance(values)] : [...values];
        const plus = (error) => (error === undefined || error === null ? '' : ` ± ${number(error, 2)}`);
        const errorOf = (c) => errors && (channels.length === 1 ? errors[0] : errors[c]);
        if (channels.some(Number.isNaN)) {
            return ['not computed here'];
        }
        const lines = channels.length === 1
            ? [`${number(channels[0])}${plus(errorOf(0))} ${name}`]
            : [`${number(luminance(channels))} ${name}`, ...channels.map((x, c) => `${'RGB'[c]} ${number(x)}${plus(errorOf(c))}`)];
        return lines.flatMap((line, k) => (k ? [make('br'), line] : [line]));
    }

    reading(reading) {
        if (!reading) {
            $('reading').replaceChildren(make('p', { class: 'quiet' }, 'No surface there.'));
            return;
        }
        const { irradiance, radiosity } = this.names;
        const table = make('table');
        const row = (name, ...value) =>
            table.append(make('tr', {}, make('th', { scope: 'row' }, name), make('td', {}, ...value)));
        if (reading.texel) {
            const { page, x, y } = reading.texel;
            row('Texel', `${x}, ${y}${this.view.about.pages > 1 ? ` of page ${page + 1}` : ''}`);
        } else {
            row('Patch', `${reading.patch}, ${reading.side} of triangle ${reading.triangle}`);
        }
        row('Material', reading.material);
        row('Position', reading.position.map((x) => number(x, 5)).join(', '));
        if (reading.unlit) {
            row('Light', 'This is a back that no ray has met.');
        } else if (reading.methods.length > 1) {
            reading.methods.forEach((m) => row(`E, ${m.name}`, ...this.measured(m.irradiance, m.error, irradiance)));
        } else {
            row('Irradiance E', ...this.measured(reading.irradiance, reading.error, irradiance));
        }
        if (!reading.unlit) {
            row('Radiosity B', ...this.measured(reading.radiosity, null, radiosity));
        }
        if (reading.discretisation) {
            const size = reading.discretisation.map(Math.abs);
            row('Discretisation', `${number(luminance(size), 2)} ${irradiance}`);
        }
        if (reading.area) {
            row('Area of patch', number(reading.area));
        }
        const { patch } = reading;
        table.dataset.patch = patch;
        const parts = [table];
        if (!reading.texel && !reading.unlit) {
            parts.push(make('p', { class: 'quiet' }, reading.error
                ? '± is one standard error, of sampling alone.'
                : this.view.about.methods[0].layers.length > 1
                    ? 'Standard errors are known while all lamps have one level.'
                    : 'The standard error is not known.'));
        }
        $('reading').replaceChildren(...parts);
    }

    // One line for the point under the cursor.
    short(reading, numbers) {
        if (reading.unlit) {
            return 'no light computed';
        }
        const e = luminance(reading.irradiance);
        const error = reading.error && reading.error.reduce((sum, x, c) => sum + LUMINANCE[c] * x, 0);
        const main = `E ${number(e)}${error ? ` ± ${number(error, 2)}` : ''} ${this.names.irradiance}`;
        const { scale, state } = this.view;
        const quantity = this.view.quantities.find((q) => q.name === state.show);
        const extra = numbers ? `; shown ${number(numbers[reading.patch] * quantity.factor, 3)} ${scale.unit}` : '';
        return `${main}${extra}; ${reading.material}`;
    }

    hint(text, event) {
        const hint = $('hint');
        hint.hidden = !text;
        if (text) {
            hint.textContent = text;
            const box = hint.parentElement.getBoundingClientRect();
            const x = Math.max(0, Math.min(event.clientX - box.left + 14, box.width - hint.offsetWidth - 4));
            const y = Math.max(0, Math.min(event.clientY - box.top + 16, box.height - hint.offsetHeight - 4));
            hint.style.left = `${x}px`;
            hint.style.top = `${y}px`;
        }
    }

    async copy(text, done) {
        try {
            await navigator.clipboard.writeText(text);
            $('copied').textContent = done;
        } catch {
            // Browsers allow it only where they trust the page; the text can be copied by hand.
            $('options').value = text;
            $('options').focus();
            $('options').select();
            $('copied').textContent = 'Copy the selected text.';
        }
    }

    save() {
        const name = `${this.view.about.title.replace(/[^\w.-]+/g, '-') || 'scene'}.png`;
        make('a', { href: this.view.still(), download: name }).click();
    }

    say(text) {
        $('message').textContent = text;
        $('message').hidden = false;
    }
}
