#!/usr/bin/env bash
# Opens pages of the program in a headless Chromium and reads back what they show. Needs npm, and Chromium: the variable CHROMIUM names
# it. The argument is the program, target/debug/radiosity where there is none. With PICTURES=DIR it leaves pictures there. Status 77: npm
# cannot install what is needed.
set -euo pipefail
here="$(cd "$(dirname "${BASH_SOURCE[0]}")" && pwd)"
program="$(realpath "${1:-$here/../../target/debug/radiosity}")"
CHROMIUM="$(command -v "${CHROMIUM:-chromium}")"
export CHROMIUM
work="$(mktemp -d)"
trap 'rm -rf "$work"' EXIT
cp "$here"/*.mjs "$here"/package.json "$work"
cp "$here"/scene.* "$here"/../../meshes/* "$work"
cd "$work"
npm install --silent --no-audit --no-fund || exit 77
node view.mjs "$program"
node charts.mjs "$program"
