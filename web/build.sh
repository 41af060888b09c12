#!/usr/bin/env bash
# Makes dist/ from src/: the scripts and the style that the program embeds into pages. Needs node and npm; `cargo build` needs neither.
# With --check it only compares, and fails when dist/ is not what src/ gives. Status 77: npm cannot install esbuild and three.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")"
out=dist
if [[ "${1:-}" == --check ]]; then
    out="$(mktemp -d)"
    trap 'rm -rf "$out"' EXIT
fi
npm ci --silent --no-audit --no-fund || exit 77
bundle() { # SOURCE NAME
    npx --no-install esbuild "src/$1" --bundle --minify --format=iife --target=es2022,safari16.4,firefox115 --charset=utf8 \
        --legal-comments=inline --log-level=warning --outfile="$out/$2"
}
bundle view.js view.js
bundle chart.js chart.js
bundle style.css style.css
cp src/view.html src/chart.html "$out/"
if [[ "$out" != dist ]]; then
    diff -rq "$out" dist
    echo "web/dist is what web/src gives"
fi
