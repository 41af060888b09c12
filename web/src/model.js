// The solved scene: its mesh, the light of each lamp on it, and what is known of the errors.
//
// Positions are in a space of unit radius around the origin, and light is over one unit of irradiance, so that any unit of length
// and any brightness fits into single precision. `toFile`, `fromFile` and `unit` lead back to the numbers of the file.

import { array, rgb } from './data.js';
import { luminance } from './scale.js';

export const BACK = 1;
export const OTHER_SIDE_SHOWN = 2;

export class Model {
    constructor(about) {
        this.about = about;
        this.unit = about.unit;
        this.positions = array('positions');
        this.faces = array('faces');
        this.isLightmap = about.kind === 'lightmap';
        const count = this.faces.length / 3;
        // One for each patch; for each face where there are no patches.
        this.patchOf = array('patch_of') ?? Uint32Array.from({ length: count }, (_, f) => f);
        this.material = array('material');
        this.triangle = array('triangle');
        this.flags = array('flags');
        this.patches = this.material.length;
        const channels = about.channels;
        this.layers = about.layers.map((layer, k) => ({
            ...layer,
            vertex: rgb(array(`vertex_light_${k}`), channels),
            patch: rgb(array(`patch_light_${k}`), channels),
        }));
        this.errors = about.methods.map((_, m) => rgb(array(`error_${m}`), channels));
        this.discretisation = rgb(array('discretisation'), channels);
        this.reflectance = rgb(array('reflectance'), channels) ?? this.ofMaterials((m) => m.reflectance.map((x, c) => x + m.reflectance_offset[c]));
        this.emission = rgb(array('emission'), channels) ?? this.ofMaterials((m) => m.emission, true);
        this.pages = Array.from({ length: about.pages ?? 0 }, (_, p) => array(`page_${p}`));
        this.measure();
    }

    // The values of their materials for all patches. Backs do not emit.
    ofMaterials(value, frontsOnly = false) {
        const out = new Float32Array(3 * this.patches);
        for (let i = 0; i < this.patches; i++) {
            if (!frontsOnly || !(this.flags[i] & BACK)) {
                out.set(value(this.about.materials[this.material[i]]), 3 * i);
            }
        }
        return out;
    }

    // Areas of faces and patches, and the middle of each patch.
    measure() {
        this.area = new Float32Array(this.patches);
        this.centre = new Float32Array(3 * this.patches);
        const { positions: p, faces } = this;
        for (let f = 0; f < faces.length / 3; f++) {
            const [a, b, c] = [3 * faces[3 * f], 3 * faces[3 * f + 1], 3 * faces[3 * f + 2]];
            const u = [p[b] - p[a], p[b + 1] - p[a + 1], p[b + 2] - p[a + 2]];
            const v = [p[c] - p[a], p[c + 1] - p[a + 1], p[c + 2] - p[a + 2]];
            const n = [u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]];
            const area = 0.5 * Math.hypot(...n);
            const patch = this.patchOf[f];
            this.area[patch] += area;
            for (let k = 0; k < 3; k++) {
                this.centre[3 * patch + k] += (area * (p[a + k] + p[b + k] + p[c + k])) / 3;
            }
        }
        for (let i = 0; i < this.patches; i++) {
            for (let k = 0; k < 3; k++) {
                this.centre[3 * i + k] /= this.area[i] || 1;
            }
        }
    }

    toFile(point) {
        return point.map((x, k) => this.about.origin[k] + this.about.radius * x);
    }

    fromFile(point) {
        return point.map((x, k) => (x - this.about.origin[k]) / this.about.radius);
    }

    // The light of a method, each of its layers with a weight: irradiance at vertices and of patches, radiosity emitted.
    light(method, weights) {
        const layers = this.about.methods[method].layers;
        const sum = (of) => {
            if (!layers.length) {
                return new Float32Array(of === 'patch' ? 3 * this.patches : this.positions.length);
            }
            const out = new Float32Array(this.layers[layers[0]][of].length);
            for (const k of layers) {
                const values = this.layers[k][of];
                const weight = weights[k];
                for (let i = 0; i < out.length; i++) {
                    out[i] += weight * values[i];
                }
            }
            return out;
        };
        const emission = this.emission.slice();
        const dims = this.dims(layers, weights);
        for (let i = 0; i < this.patches; i++) {
            for (let c = 0; c < 3; c++) {
                emission[3 * i + c] *= dims[this.material[i]];
            }
        }
        return { vertex: sum('vertex'), patch: sum('patch'), emission, dims };
    }

    // By how much each material emits more than in the file.
    dims(layers, weights) {
        const dims = new Float32Array(this.about.materials.length).fill(1);
        for (const k of layers) {
            for (const m of this.layers[k].emitters) {
                dims[m] = weights[k];
            }
        }
        return dims;
    }

    // The standard error of each patch; null where it is not known. With lamps dimmed differently it is not.
    error(method, weights) {
        const known = this.errors[method];
        const [first, ...others] = this.about.methods[method].layers.map((k) => weights[k]);
        if (!known || others.some((weight) => weight !== first)) {
            return null;
        }
        return first === 1 ? known : known.map((x) => first * x);
    }

    // What changes if patches are twice as large: the same holds.
    discretised(method, weights) {
        const [first, ...others] = this.about.methods[method].layers.map((k) => weights[k]);
        if (!this.discretisation || method !== 0 || others.some((weight) => weight !== first)) {
            return null;
        }
        return first === 1 ? this.discretisation : this.discretisation.map((x) => first * x);
    }

    // Of all texels of the map that have light.
    texelLuminance() {
        return Float32Array.from(this.pages.flatMap((page) => Array.from(page, (bits) => luminance(texelLight(bits)))));
    }

    // The nearest face that a ray hits from the side that it shows.
    hit(origin, direction, backs) {
        const { positions: p, faces } = this;
        let best = null;
        let nearest = Infinity;
        const [ox, oy, oz] = origin;
        const [dx, dy, dz] = direction;
        for (let f = 0; f < faces.length; f += 3) {
            const [a, b, c] = [3 * faces[f], 3 * faces[f + 1], 3 * faces[f + 2]];
            const [ux, uy, uz] = [p[b] - p[a], p[b + 1] - p[a + 1], p[b + 2] - p[a + 2]];
            const [vx, vy, vz] = [p[c] - p[a], p[c + 1] - p[a + 1], p[c + 2] - p[a + 2]];
            const [nx, ny, nz] = [uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx];
            const facing = -(dx * nx + dy * ny + dz * nz);
            if (facing === 0 || (facing < 0 && !backs)) {
                continue;
            }
            const [wx, wy, wz] = [ox - p[a], oy - p[a + 1], oz - p[a + 2]];
            const t = (wx * nx + wy * ny + wz * nz) / facing;
            if (!(t > 0 && t < nearest)) {
                continue;
            }
            const [qx, qy, qz] = [wy * dz - wz * dy, wz * dx - wx * dz, wx * dy - wy * dx];
            // Barycentric coordinates by Cramer's rule (Möller and Trumbore, 1997).
            const second = (vx * qx + vy * qy + vz * qz) / facing;
            const third = -(ux * qx + uy * qy + uz * qz) / facing;
            if (second < 0 || third < 0 || second + third > 1) {
                continue;
            }
            nearest = t;
            best = { face: f / 3, t, barycentric: [1 - second - third, second, third], front: facing > 0 };
        }
        if (!best) {
            return null;
        }
        const point = origin.map((x, k) => x + nearest * direction[k]);
        return { ...best, point, patch: this.patchOf[best.face] };
    }
}

// The three channels of nine bits with a common exponent (OpenGL 3.0, EXT_texture_shared_exponent).
export function texelLight(bits) {
    const scale = 2 ** ((bits >>> 27) - 24);
    return [0, 9, 18].map((shift) => ((bits >>> shift) & 511) * scale);
}
