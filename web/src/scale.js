// Colours and numbers of scales.

export const LUMINANCE = [0.2126, 0.7152, 0.0722];

// Even steps of viridis (Smith and Van der Walt, 2015), as the program's own false colours.
export const SEQUENTIAL = [
    [68, 1, 84], [71, 44, 122], [59, 81, 139], [44, 113, 142], [33, 144, 141], [39, 173, 129], [92, 200, 99], [170, 220, 50],
    [253, 231, 37],
];
// Differences: blue is less, red is more (Brewer's RdBu, turned round).
export const DIVERGING = [
    [33, 102, 172], [67, 147, 195], [146, 197, 222], [209, 229, 240], [247, 247, 247], [253, 219, 199], [244, 165, 130],
    [214, 96, 77], [178, 24, 43],
];

export function luminance(values, at = 0) {
    return LUMINANCE[0] * values[at] + LUMINANCE[1] * values[at + 1] + LUMINANCE[2] * values[at + 2];
}

// A step of 1, 2 or 5 times a power of ten that divides `most` into about `count` parts.
export function step(most, count = 6) {
    const rough = most / count;
    const power = 10 ** Math.floor(Math.log10(rough));
    return power * [1, 2, 5, 10].find((digit) => digit * power >= rough * (1 - 1e-9));
}

// The least whole number of steps that holds `most`.
export function rounded(most) {
    if (!(most > 0)) {
        return 1;
    }
    const by = step(most);
    return Number((Math.ceil(most / by - 1e-9) * by).toPrecision(6));
}

// A number with a few digits.
export function number(x, digits = 4) {
    if (x === null || x === undefined || Number.isNaN(x)) {
        return 'unknown';
    }
    const size = Math.abs(x);
    if (size !== 0 && (size < 1e-3 || size >= 1e6)) {
        return x.toExponential(digits - 1);
    }
    return String(Number(x.toPrecision(digits)));
}

// A unit as people write it.
export function unit(name) {
    return name.replace(/m2/g, 'm²').replace(/([a-zA-Z)])\*/g, '$1·');
}

// The value that a share of the weight does not exceed, within a hundredth; of all positive values, which weigh alike without weights.
export function percentile(values, weights, share) {
    const [bins, octaves] = [4096, 64];
    const most = values.reduce((most, x) => (x > most && x < Infinity ? x : most), 0);
    if (!most) {
        return 0;
    }
    const sums = new Float64Array(bins);
    let total = 0;
    for (let i = 0; i < values.length; i++) {
        if (values[i] > 0 && values[i] < Infinity) {
            const bin = Math.min(bins - 1, Math.floor((Math.log2(most / values[i]) * bins) / octaves));
            const weight = weights ? weights[i] : 1;
            sums[bin] += weight;
            total += weight;
        }
    }
    let above = 0;
    for (let bin = 0; bin < bins; bin++) {
        above += sums[bin];
        if (above > (1 - share) * total) {
            return most * 2 ** ((-bin * octaves) / bins);
        }
    }
    return most;
}

export const css = (colour) => `rgb(${colour.join(' ')})`;
