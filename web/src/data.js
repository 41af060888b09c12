// The numbers of a page: base64 of little-endian arrays in script elements that the browser does not run.

// Every half float as a number.
const HALF = new Float32Array(1 << 16);
for (let bits = 0; bits < HALF.length; bits++) {
    const [sign, exponent, fraction] = [bits >> 15 ? -1 : 1, (bits >> 10) & 31, bits & 1023];
    HALF[bits] =
        exponent === 31 ? (fraction ? NaN : sign * Infinity)
        : exponent === 0 ? sign * fraction * 2 ** -24
        : sign * (1 + fraction / 1024) * 2 ** (exponent - 15);
}

const TYPES = { u8: Uint8Array, u16: Uint16Array, u32: Uint32Array, f32: Float32Array };

function bytes(base64) {
    if (Uint8Array.fromBase64) {
        return Uint8Array.fromBase64(base64);
    }
    const text = atob(base64);
    const out = new Uint8Array(text.length);
    for (let i = 0; i < text.length; i++) {
        out[i] = text.charCodeAt(i);
    }
    return out;
}

// What the page says about its numbers.
export function about() {
    return JSON.parse(document.getElementById('about').textContent);
}

// The array of a name, or null. Half floats become numbers. The text is dropped, because the page needs it once.
export function array(name) {
    const element = document.getElementById(`data-${name}`);
    if (!element) {
        return null;
    }
    const raw = bytes(element.textContent.trim());
    const type = element.dataset.type;
    element.remove();
    if (type === 'f16') {
        const halves = new Uint16Array(raw.buffer, raw.byteOffset, raw.byteLength / 2);
        const out = new Float32Array(halves.length);
        for (let i = 0; i < out.length; i++) {
            out[i] = HALF[halves[i]];
        }
        return out;
    }
    return new TYPES[type](raw.buffer, raw.byteOffset, raw.byteLength / TYPES[type].BYTES_PER_ELEMENT);
}

// Values of one or three channels as three.
export function rgb(values, channels) {
    if (!values || channels === 3) {
        return values;
    }
    const out = new Float32Array(3 * values.length);
    for (let i = 0; i < out.length; i++) {
        out[i] = values[(i / 3) | 0];
    }
    return out;
}
