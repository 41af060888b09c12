#!/usr/bin/env bash
# Shows lit glTF files to Khronos' validator, and to three.js and Babylon.js in a headless Chromium. Installs what it needs from npm:
# status 77 if npm cannot. The argument is the program, by default target/debug/radiosity. Without Chromium only the validator runs. If
# PICTURES names a folder, it receives what the viewers show.
set -euo pipefail
here="$(cd "$(dirname "${BASH_SOURCE[0]}")" && pwd)"
program="$(realpath "${1:-$here/../../target/debug/radiosity}")"
meshes="$here/../../meshes"
work="$(mktemp -d)"
trap 'rm -rf "$work" || { sleep 2; rm -rf "$work"; } || true' EXIT
cp "$here"/*.mjs "$here"/*.js "$here"/*.html "$here"/package.json "$work"
cd "$work"
npm install --silent --no-audit --no-fund || exit 77

lit=()
for scene in cornell-box textured door-ajar; do
    for encoding in emissive moz uv; do
        "$program" bake "$meshes/$scene.obj" -o "$scene-$encoding.glb" --gltf-lightmap "$encoding" --resolution 256 \
            --quality draft --final-gather 4 --quiet
        lit+=("$scene-$encoding.glb")
    done
    # In again, and out again.
    "$program" bake "$scene-uv.glb" -o "$scene-again.glb" --resolution 256 --quality draft --final-gather 4 --quiet
    "$program" solve "$meshes/$scene.obj" -o "$scene-vertices.glb" --quality draft --quiet
    lit+=("$scene-again.glb" "$scene-vertices.glb")
done
node validate.mjs "${lit[@]}"

if ! command -v "${CHROMIUM:-chromium}" > /dev/null; then
    echo "no Chromium: pictures of viewers are not compared"
    exit 0
fi
compare() { # SCENE EYE LOOK-AT UP FOV
    "$program" bake "$meshes/$1.obj" -o "$1.glb" --resolution 1024 --final-gather 16 --quiet
    white="$(node -e "
        const bytes = require('node:fs').readFileSync('$1.glb');
        console.log(JSON.parse(bytes.subarray(20, 20 + bytes.readUInt32LE(12))).extras.radiosity.white)")"
    "$program" render "$meshes/$1.obj" -o "$1.png" --method radiosity --final-gather 32 --spp 16 --width 256 --height 256 \
        --eye "$2" --look-at "$3" --up "$4" --fov "$5" --white "$white" --quiet
    for viewer in three babylon; do
        node compare.mjs "$viewer" "$1.glb" "$1.png" "$2" "$3" "$4" "$5" ${PICTURES:+"$PICTURES/$1-$viewer.png"}
    done
}
compare cornell-box 278,273,-800 278,273,0 0,1,0 39
compare textured 0.3,1.8,2.8 2.5,0.6,0.8 0,1,0 70
compare door-ajar 5.6,1.9,3.7 3.2,1.0,1.2 0,1,0 70
