#!/usr/bin/env bash
# Builds the package, installs it into a clean environment, and runs everything that checks it: tests, types, notebooks.
# Arguments go to pytest. PYTHON names the interpreter. PROFILE=release builds with optimisation across crates, as `pip install`
# does. Otherwise the profile of `cargo test` is used, and cargo takes the dependencies that it has already built for it.
# The exit status is 75 where there is no Python, or where packages cannot be fetched.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")"

python=${PYTHON:-python3}
profile=${PROFILE:-dev}
unavailable=75
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT

"$python" -c 'import ensurepip, sys, venv; sys.exit(sys.version_info < (3, 11))' || exit $unavailable
"$python" -m venv "$work/env"
pip=("$work/env/bin/python" -m pip --quiet --disable-pip-version-check)
"${pip[@]}" install "maturin>=1.9,<2" || exit $unavailable
if ! cargo fetch --quiet --locked 2> "$work/fetched"; then
    cat "$work/fetched" >&2
    # A lock file that is not up to date is an error, unlike an index that does not answer.
    if grep -q "cannot update the lock file" "$work/fetched"; then exit 1; fi
    exit $unavailable
fi

cargo fmt --check
"$work/env/bin/maturin" build --quiet --locked --profile "$profile" --interpreter "$work/env/bin/python" --out "$work/wheels"
"${pip[@]}" uninstall --yes maturin
"${pip[@]}" install "$(echo "$work"/wheels/*.whl)[test]"

# From elsewhere, so that the package is the installed one.
root=$PWD
export PATH="$work/env/bin:$PATH" MPLBACKEND=agg
cd "$work"
python -m mypy --config-file "$root/pyproject.toml" --cache-dir "$work/mypy"
python -m pytest --config-file "$root/pyproject.toml" -p no:cacheprovider --quiet --durations 10 "$root/tests" "$@"
for notebook in "$root"/notebooks/*.py; do
    echo "$(basename "$notebook")"
    NOTEBOOK_OUTPUT="$work" python "$notebook"
done
