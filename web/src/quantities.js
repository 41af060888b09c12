// What a page can show, besides the picture: numbers in false colours.

import { luminance, percentile } from './scale.js';

// Share of the surface that an automatic scale covers.
const COVERED = 0.995;

export function quantities(model) {
    const { about } = model;
    const { irradiance, radiosity } = about.units;
    const ofPatches = (value) => Float32Array.from({ length: model.patches }, (_, i) => value(i));
    const light = (k, state) => {
        const layers = about.methods[k].layers;
        return (i) => layers.reduce((sum, l) => sum + state.weights[l] * luminance(model.layers[l].patch, 3 * i), 0);
    };
    const error = (state, k = state.method) => {
        const known = model.error(k, state.weights);
        return known && ((i) => luminance(known, 3 * i));
    };
    const change = (state) => {
        const known = model.discretised(state.method, state.weights);
        return known && ((i) => Math.abs(luminance(known, 3 * i)));
    };
    const percent = (part, state) => {
        const whole = light(state.method, state);
        return ofPatches((i) => (whole(i) > 0 ? (100 * part(i)) / whole(i) : NaN));
    };
    const common = { code: 3, factor: model.unit, most: (_, numbers) => percentile(numbers, model.area, COVERED) };
    const ofLight = (reflects) => (now) => {
        if (model.isLightmap) {
            return percentile(model.texelLuminance(), null, COVERED);
        }
        const values = ofPatches((i) => {
            const e = luminance(now.patch, 3 * i);
            return reflects ? luminance(now.emission, 3 * i) + e * luminance(model.reflectance, 3 * i) : e;
        });
        return percentile(values, model.area, COVERED);
    };
    const isOther = (state) => state.method > 0;
    return [
        { name: 'picture', label: 'Picture', code: 0, factor: model.unit, unit: radiosity, isKnown: () => true },
        { name: 'irradiance', label: `Irradiance E, ${irradiance}`, code: 1, factor: model.unit, unit: irradiance,
            most: ofLight(false), isKnown: () => true },
        { name: 'radiosity', label: `Radiosity B, ${radiosity}`, code: 2, factor: model.unit, unit: radiosity,
            most: ofLight(true), isKnown: () => true },
        { ...common, name: 'error', label: `Standard error of E, ${irradiance}`, unit: irradiance,
            isKnown: (state) => Boolean(error(state)), number: (state) => ofPatches(error(state)) },
        { ...common, name: 'relative-error', label: 'Standard error of E, %', unit: '%', factor: 1,
            isKnown: (state) => Boolean(error(state)), number: (state) => percent(error(state), state) },
        { ...common, name: 'discretisation', label: `Discretisation error of E, ${irradiance}`, unit: irradiance,
            isKnown: (state) => Boolean(change(state)), number: (state) => ofPatches(change(state)) },
        { ...common, name: 'relative-discretisation', label: 'Discretisation error of E, %', unit: '%', factor: 1,
            isKnown: (state) => Boolean(change(state)), number: (state) => percent(change(state), state) },
        { ...common, name: 'difference', label: `Difference from ${about.methods[0].name}, ${irradiance}`, unit: irradiance,
            diverges: true, isKnown: isOther,
            number: (state) => {
                const [mine, first] = [light(state.method, state), light(0, state)];
                return ofPatches((i) => mine(i) - first(i));
            },
            most: (_, numbers) => percentile(numbers.map(Math.abs), model.area, COVERED) },
        { ...common, name: 'z', label: `Difference from ${about.methods[0].name}, z-score`, unit: 'standard errors', factor: 1,
            diverges: true,
            isKnown: (state) => isOther(state) && Boolean(error(state)) && Boolean(error(state, 0)),
            number: (state) => {
                const [mine, first] = [light(state.method, state), light(0, state)];
                const [a, b] = [error(state), error(state, 0)];
                return ofPatches((i) => (mine(i) - first(i)) / Math.hypot(a(i), b(i)));
            },
            most: () => 4 },
    ];
}
