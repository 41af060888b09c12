// Draws a model with WebGL 2.

import {
    BufferAttribute,
    BufferGeometry,
    ClampToEdgeWrapping,
    DataTexture,
    DoubleSide,
    FloatType,
    FrontSide,
    GLSL3,
    LinearFilter,
    LinearMipmapLinearFilter,
    LinearSRGBColorSpace,
    Matrix4,
    Mesh,
    NearestFilter,
    PerspectiveCamera,
    RGBAFormat,
    RGBFormat,
    RawShaderMaterial,
    RepeatWrapping,
    SRGBColorSpace,
    Scene,
    Texture,
    UnsignedInt5999Type,
    Vector2,
    Vector3,
    WebGLRenderer,
} from 'three';
import { array } from './data.js';
import { OTHER_SIDE_SHOWN, texelLight } from './model.js';
import { FRAGMENT, SKY_FRAGMENT, SKY_VERTEX, VERTEX } from './shaders.js';

// Width of the textures that hold a texel for each patch; the shader knows it.
const WIDTH = 2048;

export class Picture {
    constructor(canvas, model) {
        this.model = model;
        this.renderer = new WebGLRenderer({ canvas, antialias: true, powerPreference: 'high-performance' });
        this.renderer.outputColorSpace = LinearSRGBColorSpace;
        this.renderer.autoClear = false;
        this.camera = new PerspectiveCamera(40, 1, 1e-3, 100);
        this.scene = new Scene();
        this.sky = new Scene();
        this.values = patchTexture(model.patches);
        this.reflectance = patchTexture(model.patches);
        this.emission = patchTexture(model.patches);
        for (let i = 0; i < model.patches; i++) {
            this.reflectance.image.data.set(model.reflectance.subarray(3 * i, 3 * i + 3), 4 * i);
            this.reflectance.image.data[4 * i + 3] = model.flags[i] & OTHER_SIDE_SHOWN ? 1 : 0;
        }
        this.uniforms = {
            patchLight: { value: this.values },
            patchReflectance: { value: this.reflectance },
            patchEmission: { value: this.emission },
            exposure: { value: 1 },
            show: { value: 0 },
            smoothed: { value: true },
            logarithmic: { value: false },
            isolines: { value: false },
            edges: { value: false },
            range: { value: new Vector2(0, 1) },
            colours: { value: Array.from({ length: 9 }, () => new Vector3()) },
            isostep: { value: 1 },
            selected: { value: -1 },
        };
        this.materials = [];
        this.build();
        this.buildSky();
    }

    // One list of triangles, without shared vertices, so that each knows its patch; first those without textures.
    build() {
        const { model } = this;
        const faces = model.faces.length / 3;
        const maps = array('page_of');
        const isMapped = model.about.materials.map((m) => Boolean(m.reflectance_map || m.emission_map));
        const kinds = isMapped.length + 1;
        const groupOf = (f) => {
            const material = model.material[model.patchOf[f]];
            return (maps ? maps[f] : 0) * kinds + (isMapped[material] ? material + 1 : 0);
        };
        const groups = new Map();
        for (let f = 0; f < faces; f++) {
            const key = groupOf(f);
            groups.get(key)?.push(f) ?? groups.set(key, [f]);
        }
        this.order = new Uint32Array(faces);
        const geometry = new BufferGeometry();
        const meshMaterials = [];
        let at = 0;
        for (const [key, members] of groups) {
            geometry.addGroup(3 * at, 3 * members.length, meshMaterials.length);
            meshMaterials.push(this.shading(Math.floor(key / kinds), (key % kinds) - 1));
            this.order.set(members, at);
            at += members.length;
        }
        const position = new Float32Array(9 * faces);
        const face = new Float32Array(6 * faces);
        this.light = new BufferAttribute(new Float32Array(9 * faces), 3);
        const hidden = hiddenSides(model);
        this.order.forEach((f, g) => {
            for (let k = 0; k < 3; k++) {
                const v = 3 * model.faces[3 * f + k];
                position.set(model.positions.subarray(v, v + 3), 9 * g + 3 * k);
                face[6 * g + 2 * k] = model.patchOf[f];
                face[6 * g + 2 * k + 1] = k + 4 * hidden[f];
            }
        });
        geometry.setAttribute('position', new BufferAttribute(position, 3));
        geometry.setAttribute('face', new BufferAttribute(face, 2));
        geometry.setAttribute('light', this.light);
        const ofMapped = (values) => values && this.ofAll(values, (f) => isMapped[model.material[model.patchOf[f]]]);
        this.coordinates(geometry, 'reflectanceUv', ofMapped(array('reflectance_uv')));
        this.coordinates(geometry, 'emissionUv', ofMapped(array('emission_uv')));
        this.mapUv = array('map_uv');
        this.pageOf = maps;
        this.coordinates(geometry, 'mapUv', this.mapUv);
        const mesh = new Mesh(geometry, meshMaterials);
        mesh.frustumCulled = false;
        this.scene.add(mesh);
    }

    // Coordinates that only some faces have, with zeros for the others.
    ofAll(values, has) {
        const out = new Float32Array(6 * this.order.length);
        let at = 0;
        for (let f = 0; f < this.order.length; f++) {
            if (has(f)) {
                out.set(values.subarray(at, at + 6), 6 * f);
                at += 6;
            }
        }
        return out;
    }

    // Two numbers for each corner of each face, in the order of the picture.
    coordinates(geometry, name, values) {
        if (values) {
            const out = new Float32Array(6 * this.order.length);
            this.order.forEach((f, g) => out.set(values.subarray(6 * f, 6 * f + 6), 6 * g));
            geometry.setAttribute(name, new BufferAttribute(out, 2));
        }
    }

    shading(page, material) {
        const { about } = this.model;
        const uniforms = { ...this.uniforms };
        const defines = {};
        if (this.model.isLightmap) {
            this.textures ??= this.model.pages.map((texels) => mapTexture(texels, about.width, about.height));
            defines.LIGHTMAP = 1;
            uniforms.map = { value: this.textures[page] };
            uniforms.mapSize = { value: new Vector2(about.width, about.height) };
        }
        if (material >= 0) {
            const m = about.materials[material];
            defines.MAPPED = 1;
            uniforms.hasReflectanceMap = { value: Boolean(m.reflectance_map) };
            uniforms.hasEmissionMap = { value: Boolean(m.emission_map) };
            uniforms.reflectanceMap = { value: this.image(m.reflectance_map) };
            uniforms.emissionMap = { value: this.image(m.emission_map) };
            uniforms.reflectanceFactor = { value: new Vector3(...m.reflectance) };
            uniforms.reflectanceOffset = { value: new Vector3(...m.reflectance_offset) };
            uniforms.emissionFactor = { value: new Vector3(...m.emission) };
        }
        const shading = new RawShaderMaterial({
            glslVersion: GLSL3,
            vertexShader: VERTEX,
            fragmentShader: FRAGMENT,
            uniforms,
            defines,
            side: FrontSide,
        });
        shading.userData = { material };
        this.materials.push(shading);
        return shading;
    }

    // An image of a material. Texels are squares of one colour, as in the solution.
    image(map) {
        if (!map) {
            return null;
        }
        const texture = new Texture();
        texture.colorSpace = SRGBColorSpace;
        texture.wrapS = texture.wrapT = map.clamp ? ClampToEdgeWrapping : RepeatWrapping;
        texture.magFilter = NearestFilter;
        texture.minFilter = LinearMipmapLinearFilter;
        texture.anisotropy = 8;
        const image = new Image();
        this.loading ??= [];
        this.loading.push(
            new Promise((resolve) => {
                image.onload = () => {
                    texture.image = image;
                    texture.needsUpdate = true;
                    resolve();
                };
                image.onerror = resolve;
                image.src = this.model.about.textures[map.texture];
            }),
        );
        return texture;
    }

    buildSky() {
        const { sky } = this.model.about;
        const texels = array('sky');
        this.skyUniforms = {
            toWorld: { value: new Matrix4() },
            sky: { value: sky ? mapTexture(texels, sky.width, sky.height) : null },
            exposure: this.uniforms.exposure,
            hasSky: { value: Boolean(sky) },
            background: { value: new Vector3() },
        };
        if (sky) {
            this.skyUniforms.sky.value.wrapS = RepeatWrapping;
        }
        const geometry = new BufferGeometry();
        geometry.setAttribute('position', new BufferAttribute(new Float32Array([-1, -1, 0, 3, -1, 0, -1, 3, 0]), 3));
        const material = new RawShaderMaterial({
            glslVersion: GLSL3,
            vertexShader: SKY_VERTEX,
            fragmentShader: SKY_FRAGMENT,
            uniforms: this.skyUniforms,
            depthTest: false,
            depthWrite: false,
        });
        const mesh = new Mesh(geometry, material);
        mesh.frustumCulled = false;
        this.sky.add(mesh);
    }

    // Shows the light of a method; `number` has a number for each patch in false colours, or is null.
    setLight(light, number) {
        const { model, values, emission } = this;
        for (let i = 0; i < model.patches; i++) {
            values.image.data.set(light.patch.subarray(3 * i, 3 * i + 3), 4 * i);
            values.image.data[4 * i + 3] = number ? number[i] : 0;
            for (let c = 0; c < 4; c++) {
                known(values.image.data, 4 * i + c);
            }
            emission.image.data.set(light.emission.subarray(3 * i, 3 * i + 3), 4 * i);
        }
        values.needsUpdate = emission.needsUpdate = this.reflectance.needsUpdate = true;
        this.order.forEach((f, g) => {
            for (let k = 0; k < 3; k++) {
                const v = 3 * model.faces[3 * f + k];
                this.light.array.set(light.vertex.subarray(v, v + 3), 9 * g + 3 * k);
            }
        });
        for (let k = 0; k < this.light.array.length; k++) {
            known(this.light.array, k);
        }
        this.light.needsUpdate = true;
        for (const shading of this.materials) {
            const { material } = shading.userData;
            if (material >= 0) {
                const factor = model.about.materials[material].emission;
                shading.uniforms.emissionFactor.value.set(...factor.map((x) => x * light.dims[material]));
            }
        }
    }

    setBacks(shown) {
        this.materials.forEach((material) => (material.side = shown ? DoubleSide : FrontSide));
    }

    resize(width, height, ratio) {
        this.renderer.setPixelRatio(ratio);
        this.renderer.setSize(width, height, false);
        this.camera.aspect = width / height;
    }

    draw() {
        const { camera } = this;
        camera.updateProjectionMatrix();
        camera.updateMatrixWorld();
        const turn = camera.matrixWorld.clone().setPosition(0, 0, 0);
        this.skyUniforms.toWorld.value.multiplyMatrices(turn, camera.projectionMatrixInverse);
        this.renderer.clear();
        this.renderer.render(this.sky, camera);
        this.renderer.render(this.scene, camera);
    }

    // Irradiance of the lightmap at a hit: of its texel.
    texel(hit) {
        const { width, height } = this.model.about;
        const at = [0, 1].map((axis) =>
            [0, 1, 2].reduce((sum, k) => sum + hit.barycentric[k] * this.mapUv[6 * hit.face + 2 * k + axis], 0));
        const [x, y] = [Math.min(width - 1, Math.floor(at[0] * width)), Math.min(height - 1, Math.floor(at[1] * height))];
        const page = this.pageOf[hit.face];
        return { page, x, y, light: texelLight(this.model.pages[page][y * width + x]) };
    }
}

// What is not known, which graphics processors need not be able to tell as NaN.
const UNKNOWN = -1e30;

function known(values, at) {
    if (Number.isNaN(values[at])) {
        values[at] = UNKNOWN;
    }
}

function patchTexture(patches) {
    const height = Math.max(1, Math.ceil(patches / WIDTH));
    const texture = new DataTexture(new Float32Array(4 * WIDTH * height), WIDTH, height, RGBAFormat, FloatType);
    texture.needsUpdate = true;
    return texture;
}

// Texels of nine bits for each channel and a common exponent, which WebGL 2 filters.
function mapTexture(texels, width, height) {
    const texture = new DataTexture(texels, width, height, RGBFormat, UnsignedInt5999Type);
    texture.magFilter = texture.minFilter = LinearFilter;
    texture.needsUpdate = true;
    return texture;
}

// For each face, which of its sides lie inside of a patch: bit k is the side opposite of corner k.
function hiddenSides(model) {
    const faces = model.faces.length / 3;
    const hidden = new Uint8Array(faces);
    const count = new Uint8Array(model.patches);
    model.patchOf.forEach((patch) => (count[patch] = Math.min(2, count[patch] + 1)));
    const sides = new Map();
    for (let f = 0; f < faces; f++) {
        const patch = model.patchOf[f];
        if (count[patch] < 2) {
            continue;
        }
        for (let k = 0; k < 3; k++) {
            const [a, b] = [model.faces[3 * f + ((k + 1) % 3)], model.faces[3 * f + ((k + 2) % 3)]];
            const key = `${patch} ${Math.min(a, b)} ${Math.max(a, b)}`;
            const other = sides.get(key);
            if (other) {
                hidden[f] |= 1 << k;
                hidden[other[0]] |= 1 << other[1];
            } else {
                sides.set(key, [f, k]);
            }
        }
    }
    return hidden;
}
