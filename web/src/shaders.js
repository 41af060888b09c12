// What a pixel shows: the light that leaves a point, B = Be + rho E, exposed and encoded as sRGB; or a number in false colours.

export const VERTEX = `
uniform mat4 projectionMatrix, modelViewMatrix;
in vec3 position;
in vec3 light;
in vec2 face;
#ifdef MAPPED
in vec2 reflectanceUv, emissionUv;
out vec2 vReflectanceUv, vEmissionUv;
#endif
#ifdef LIGHTMAP
in vec2 mapUv;
out vec2 vMapUv;
#endif
out vec3 vLight;
out vec3 vCorner;
flat out int vPatch;

void main() {
    gl_Position = projectionMatrix * modelViewMatrix * vec4(position, 1.0);
    vLight = light;
    vPatch = int(face.x);
    // Distances from the sides of the triangle. A side inside of a patch is kept far away, so that it is not drawn.
    int corner = int(face.y) & 3, hidden = int(face.y) >> 2;
    vec3 b = vec3(corner == 0, corner == 1, corner == 2);
    vCorner = mix(b, vec3(1.0), vec3(hidden & 1, (hidden >> 1) & 1, (hidden >> 2) & 1));
#ifdef MAPPED
    vReflectanceUv = reflectanceUv;
    vEmissionUv = emissionUv;
#endif
#ifdef LIGHTMAP
    vMapUv = mapUv;
#endif
}`;

// sRGB (IEC 61966-2-1).
const ENCODE = `
vec3 encode(vec3 x) {
    x = clamp(x, 0.0, 1.0);
    return mix(12.92 * x, 1.055 * pow(x, vec3(1.0 / 2.4)) - 0.055, step(0.0031308, x));
}`;

export const FRAGMENT = `
precision highp float;
precision highp int;
precision highp sampler2D;
uniform sampler2D patchLight;       // irradiance of each patch; a: the number in false colours
uniform sampler2D patchReflectance; // a: whether the other side has a patch of its own
uniform sampler2D patchEmission;    // radiosity emitted
uniform float exposure;             // brightness of the screen over radiosity
uniform int show;                   // 0 picture, 1 irradiance, 2 radiosity, 3 the number of the patch
uniform bool smoothed, logarithmic, isolines, edges;
uniform vec2 range;
uniform vec3 colours[9];
uniform float isostep;
uniform int selected;
#ifdef MAPPED
uniform bool hasReflectanceMap, hasEmissionMap;
uniform sampler2D reflectanceMap, emissionMap;
uniform vec3 reflectanceFactor, reflectanceOffset, emissionFactor;
in vec2 vReflectanceUv, vEmissionUv;
#endif
#ifdef LIGHTMAP
uniform sampler2D map;
uniform vec2 mapSize;
in vec2 vMapUv;
#endif
in vec3 vLight;
in vec3 vCorner;
flat in int vPatch;
out vec4 pixel;
const vec3 LUMINANCE = vec3(0.2126, 0.7152, 0.0722);
${ENCODE}
vec3 coloured(float share) {
    float at = clamp(share, 0.0, 1.0) * 8.0;
    int k = min(int(at), 7);
    return mix(colours[k], colours[k + 1], at - float(k));
}

float share(float value) {
    return logarithmic
        ? log(max(value, 1e-30) / range.x) / log(range.y / range.x)
        : (value - range.x) / (range.y - range.x);
}

void main() {
    ivec2 at = ivec2(vPatch & 2047, vPatch >> 11);
    vec4 ofPatch = texelFetch(patchLight, at, 0);
    vec4 reflects = texelFetch(patchReflectance, at, 0);
    vec3 rho = reflects.rgb, emitted = texelFetch(patchEmission, at, 0).rgb;
#ifdef MAPPED
    if (hasReflectanceMap) rho = reflectanceFactor * texture(reflectanceMap, vReflectanceUv).rgb + reflectanceOffset;
    if (hasEmissionMap && dot(emitted, vec3(1.0)) > 0.0) emitted = emissionFactor * texture(emissionMap, vEmissionUv).rgb;
#endif
#ifdef LIGHTMAP
    vec3 E = smoothed ? texture(map, vMapUv).rgb : texelFetch(map, ivec2(vMapUv * mapSize), 0).rgb;
#else
    vec3 E = smoothed ? vLight : ofPatch.rgb;
#endif
    if (!gl_FrontFacing) {
        // The side that no light was computed for is black.
        if (reflects.a > 0.5) discard;
        E = vec3(0.0);
        emitted = vec3(0.0);
    }
    vec3 B = emitted + rho * E;
    float value = show == 3 ? ofPatch.a : dot(show == 2 ? B : E, LUMINANCE);
    // No light is negative, and no number that low.
    bool unknown = E.r < -1e20 || value < -1e20;
    vec3 colour = unknown ? vec3(0.35) : show == 0 ? encode(B * exposure) : coloured(share(value));
    if (isolines && show != 3 && !unknown) {
        float q = (show == 0 ? dot(E, LUMINANCE) : value) / isostep, width = fwidth(q);
        float near = abs(fract(q - 0.5) - 0.5) / max(width, 1e-9);
        // Lines closer than three pixels would fill the surface.
        float line = q > 0.5 && width < 0.33 ? 1.0 - smoothstep(0.4, 1.2, near) : 0.0;
        colour = mix(colour, dot(colour, LUMINANCE) > 0.45 ? vec3(0.0) : vec3(1.0), line);
    }
#ifdef LIGHTMAP
    vec2 texel = vMapUv * mapSize, size = fwidth(texel);
    vec2 toBorder = abs(fract(texel - 0.5) - 0.5) / max(size, vec2(1e-9));
    float border = max(size.x, size.y) < 0.33 ? min(toBorder.x, toBorder.y) : 9.0;
#else
    vec3 toSide = vCorner / max(fwidth(vCorner), vec3(1e-9));
    float border = min(toSide.x, min(toSide.y, toSide.z));
    if (vPatch == selected) {
        colour = mix(vec3(1.0, 0.55, 0.0), colour, smoothstep(1.5, 2.5, border));
    }
#endif
    if (edges) {
        float line = 0.45 * (1.0 - smoothstep(0.4, 1.2, border));
        colour = mix(colour, dot(colour, LUMINANCE) > 0.45 ? vec3(0.0) : vec3(1.0), line);
    }
    pixel = vec4(colour, 1.0);
}`;

export const SKY_VERTEX = `
in vec3 position;
out vec2 at;
void main() {
    at = position.xy;
    gl_Position = vec4(position.xy, 1.0, 1.0);
}`;

export const SKY_FRAGMENT = `
precision highp float;
precision highp sampler2D;
uniform mat4 toWorld;  // from the screen to directions
uniform sampler2D sky; // by azimuth around y and by height, from the top
uniform float exposure;
uniform bool hasSky;
uniform vec3 background;
in vec2 at;
out vec4 pixel;
const float PI = 3.141592653589793;
${ENCODE}
void main() {
    vec4 far = toWorld * vec4(at, 1.0, 1.0);
    vec3 d = normalize(far.xyz / far.w);
    vec2 uv = vec2(atan(d.z, d.x) / (2.0 * PI) + 0.5, acos(clamp(d.y, -1.0, 1.0)) / PI);
    pixel = vec4(hasSky ? encode(PI * exposure * textureLod(sky, uv, 0.0).rgb) : background, 1.0);
}`;
