#!/usr/bin/env bash
# A render of a minute on two threads leaves the memory of master and worker flat: resident size
# after 20 seconds and at the end of rendering within 5 %. Not part of deploy/test, because it takes
# a minute. The end is two seconds before the master's: after that it decodes and writes the finished
# picture, which takes a picture's worth of memory once; that peak is printed.
# Usage: PATHFARM_BIN=build/release/bin tests/memory-flat.sh [SECONDS [WIDTHxHEIGHT [SCENE]]]
. "$(dirname "$0")/farm-lib.bash"
export PATHFARM_WORKER_ARGS=
seconds=${1:-60}
resolution=${2:-512x512}
scene=${3:-$(dirname "$0")/../scenes/cornell-box.pbrt}

resident_kb() { sed -n 's/^VmRSS:[[:space:]]*\([0-9]*\) kB/\1/p' "/proc/$1/status" 2>/dev/null; }

"$bin/pathfarm" render "$scene" -o "$work/flat.exr" --time "$seconds" \
    --resolution "$resolution" --workers 1 --threads 2 --quiet \
    --cache "$work/cache" >"$work/flat.log" 2>&1 &
master=$!
wait_for 10 local_worker || fail "no worker"
worker=$(local_worker)
begin=$SECONDS
early_at=$((seconds / 3))
early_master= early_worker=
looks_master=() looks_worker=()
while kill -0 "$master" 2>/dev/null; do
    now_master=$(resident_kb "$master") now_worker=$(resident_kb "$worker")
    if [ -n "$now_master" ] && [ -n "$now_worker" ]; then
        looks_master+=("$now_master") looks_worker+=("$now_worker")
        if [ -z "$early_master" ] && [ $((SECONDS - begin)) -ge $early_at ]; then
            early_master=$now_master early_worker=$now_worker
        fi
    fi
    sleep 0.5
done
wait "$master" || fail "the render"
[ -n "$early_master" ] || fail "the render ended too early"
late_master=${looks_master[-5]} late_worker=${looks_worker[-5]} # looks are half a second apart
echo "master, writing the picture: ${looks_master[-1]} kB"

flat=true
for who in master worker; do
    early=early_$who late=late_$who
    change=$(awk "BEGIN { printf \"%+.2f\", 100 * (${!late} / ${!early} - 1) }")
    echo "$who: ${!early} kB after $early_at s, ${!late} kB at the end, $change %"
    awk "BEGIN { exit !($change <= 5 && $change >= -5) }" || flat=false
done
$flat || fail "memory is not flat"
