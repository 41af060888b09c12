// What the pages of all viewers share: the job, and the comparison of a canvas with a picture of ours, pixel by pixel.
//
// A pixel of ours is the mean radiance over its square. So a viewer draws FINE times as many pixels in each direction, and their
// means in linear light are compared.

export const FINE = 4;
export const job = await (await fetch('/job')).json();

const linear = Float64Array.from({ length: 256 }, (_, k) => {
    const x = k / 255;
    return x <= 0.04045 ? x / 12.92 : ((x + 0.055) / 1.055) ** 2.4;
});
const encoded = (x) => 255 * (x <= 0.0031308 ? 12.92 * x : 1.055 * x ** (1 / 2.4) - 0.055);

function pixels(source, width, height) {
    const context = new OffscreenCanvas(width, height).getContext('2d', { willReadFrequently: true });
    context.drawImage(source, 0, 0);
    return context.getImageData(0, 0, width, height).data;
}

// Sends the mean difference of 255, and what the viewer shows.
export async function report(canvas) {
    const { width, height } = job;
    const wanted = pixels(await createImageBitmap(await (await fetch('/ours.png')).blob()), width, height);
    const fine = pixels(canvas, FINE * width, FINE * height);
    const shown = new ImageData(width, height);
    let sum = 0;
    for (let y = 0; y < height; y++) {
        for (let x = 0; x < width; x++) {
            const at = 4 * (y * width + x);
            for (let c = 0; c < 3; c++) {
                let light = 0;
                for (let k = 0; k < FINE * FINE; k++) {
                    const row = FINE * y + Math.floor(k / FINE);
                    light += linear[fine[4 * (row * FINE * width + FINE * x + (k % FINE)) + c]];
                }
                shown.data[at + c] = Math.round(encoded(light / FINE ** 2));
                sum += Math.abs(shown.data[at + c] - wanted[at + c]);
            }
            shown.data[at + 3] = 255;
        }
    }
    const picture = new OffscreenCanvas(width, height);
    picture.getContext('2d').putImageData(shown, 0, 0);
    const bytes = new Uint8Array(await (await picture.convertToBlob({ type: 'image/png' })).arrayBuffer());
    const text = btoa(bytes.reduce((text, byte) => text + String.fromCharCode(byte), ''));
    const difference = sum / (3 * width * height);
    await fetch('/done', { method: 'POST', body: JSON.stringify({ difference, picture: text }) });
}
