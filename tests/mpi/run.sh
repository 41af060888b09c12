#!/usr/bin/env bash
# Runs `solve` under mpirun: the same bytes for any number of ranks, after kills, and with other numbers of ranks. Installs
# MPI where apt-get can. Exit status 77: it cannot, or MPI does not run here.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/../.."

has_all() {
    command -v mpirun > /dev/null && command -v mpicc > /dev/null && ls /usr/lib/llvm-*/lib/libclang*.so* > /dev/null 2>&1
}
if ! has_all; then
    apt-get update -qq && apt-get install -y -qq openmpi-bin libopenmpi-dev libclang-dev > /dev/null || true
    has_all || exit 77
fi

cargo build --features mpi --bin radiosity
program="${CARGO_TARGET_DIR:-$PWD/target}/debug/radiosity"
scene="$PWD/meshes/cornell-box.obj"
work=$(mktemp -d)
small=
clean_up() {
    if [[ -n "$small" ]]; then umount "$small"; fi
    rm -rf "$work"
}
trap clean_up EXIT
cd "$work"

flags=()
if mpirun --version | grep -q "Open MPI"; then
    flags=(--oversubscribe)
    if [[ $(id -u) == 0 ]]; then flags+=(--allow-run-as-root); fi
fi
if ! mpirun "${flags[@]}" -n 2 true; then
    echo "mpirun starts no processes here" >&2
    exit 77
fi
ranks() { # COUNT ARGUMENTS...
    mpirun "${flags[@]}" -n "$1" "$program" "${@:2}"
}
fail() {
    echo "failed: $*" >&2
    exit 1
}
await() { # FILE SIZE MESSAGES: $job has written more than SIZE bytes.
    until [[ -s "$1" && $(stat -c %s "$1") -gt $2 ]]; do
        kill -0 $job 2> /dev/null || fail "the job ended too early: $(cat "$3")"
        sleep 0.02
    done
}
# The report without what differs between runs.
figures() {
    sed '/"seconds": {/,/}/d; /"ranks": {/,/}/d; /"peak_bytes"/d; /"bytes"/d; /"elapsed"/d' "$1"
}
same() { # WHAT: out.ply and r.json are those of one process.
    cmp out.ply one.ply || fail "$1: another mesh"
    diff <(figures r.json) <(figures one.json) || fail "$1: another report"
    rm out.ply r.json
}

base=(solve "$scene" --patches 5000 --quiet)
solve=("${base[@]}" --rays 64)
outputs=(-o out.ply --report r.json)
for options in "" "--constant-light" "--sun 30,40,100 --sky overcast:100 --ignore red"; do
    read -ra options <<< "$options"
    "$program" "${solve[@]}" "${options[@]}" -o one.ply --report one.json
    for count in 1 2 4; do
        ranks $count "${solve[@]}" "${options[@]}" "${outputs[@]}" --threads $((count % 3))
        same "$count ranks ${options[*]}"
    done
done
"$program" "${solve[@]}" -o one.ply --report one.json
ranks 3 "${solve[@]}" "${outputs[@]}" --threads 3
sent=$(sed -n 's/.*"bytes_sent": \([0-9]*\).*/\1/p' r.json)
((sent > 100000)) || fail "$sent bytes were sent"
same "3 ranks of 3 threads"

# A rank that is killed ends the job without an output. Other numbers of ranks, and one process, go on from its rays.
long=("${base[@]}" --rays 1024)
"$program" "${long[@]}" -o one.ply --report one.json
mpirun "${flags[@]}" -n 4 "$program" "${long[@]}" "${outputs[@]}" --checkpoint rays > killed.txt 2>&1 &
job=$!
await rays.2 1000000 killed.txt
kill -9 "$(pgrep -P $job | tail -1)"
if wait $job; then fail "a killed rank did not end the job"; fi
[[ ! -e out.ply && ! -e r.json ]] || fail "a killed job left an output"
ranks 2 "${long[@]}" "${outputs[@]}" --checkpoint rays
same "2 ranks after a kill of 4"
"$program" "${long[@]}" "${outputs[@]}" --checkpoint 'rays.*'
same "one process after 4 ranks"
rm rays.*

# Signals and a full disk end all ranks.
mpirun "${flags[@]}" -n 2 "$program" "${long[@]}" "${outputs[@]}" --checkpoint rays > stopped.txt 2>&1 &
job=$!
await rays.1 100000 stopped.txt
kill -INT $job
if wait $job; then fail "Ctrl-C did not end the job"; fi
[[ ! -e out.ply ]] || fail "a stopped job left an output"
rm rays.*
if [[ $(id -u) == 0 ]] && mkdir small && mount -t tmpfs -o size=300k tmpfs small 2> /dev/null; then
    small="$work/small"
    : > small/rays
    ln -s small/rays rays.1
    if ranks 2 "${long[@]}" "${outputs[@]}" --checkpoint rays > full.txt 2>&1; then
        fail "a full disk did not end the job"
    fi
    grep -q "^error: rays.1: No space left on device" full.txt || fail "no name of the full disk: $(cat full.txt)"
    [[ ! -e out.ply ]] || fail "a job on a full disk left an output"
fi

# Refusals, once.
status=0
ranks 2 bake "$scene" -o map > refused.txt 2>&1 || status=$?
[[ $status == 2 && $(grep -c "^error: " refused.txt) == 1 ]] || fail "bake: $status, $(cat refused.txt)"
[[ ! -e map ]] || fail "a refused bake left a directory"
echo "MPI: passed"
