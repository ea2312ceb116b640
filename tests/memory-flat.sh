#!/usr/bin/env bash
# A render of a minute on two threads leaves the memory of master and worker flat: resident size
# after 20 seconds and at the end within 5 %. Not part of deploy/test, because it takes a minute.
# The film of a pair of tile and replicate grows until it has held four sums, at 15 leaves, which is
# 240 samples per pixel; a slow machine needs a smaller picture to get there in 20 seconds.
# Usage: PATHFARM_BIN=build/release/bin tests/memory-flat.sh [SECONDS [WIDTHxHEIGHT [SCENE]]]
. "$(dirname "$0")/farm-lib.bash"
export PATHFARM_WORKER_ARGS=
seconds=${1:-60}
resolution=${2:-256x256}
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
early_master= early_worker= late_master= late_worker=
# The last look before the processes end is the one that counts as the end
while kill -0 "$master" 2>/dev/null; do
    now_master=$(resident_kb "$master") now_worker=$(resident_kb "$worker")
    if [ -n "$now_master" ] && [ -n "$now_worker" ]; then
        late_master=$now_master late_worker=$now_worker late_at=$((SECONDS - begin))
        if [ -z "$early_master" ] && [ $late_at -ge $early_at ]; then
            early_master=$now_master early_worker=$now_worker
        fi
    fi
    sleep 0.5
done
wait "$master" || fail "the render"
[ -n "$early_master" ] || fail "the render ended too early"

flat=true
for who in master worker; do
    early=early_$who late=late_$who
    change=$(awk "BEGIN { printf \"%+.2f\", 100 * (${!late} / ${!early} - 1) }")
    echo "$who: ${!early} kB after $early_at s, ${!late} kB after $late_at s, $change %"
    awk "BEGIN { exit !($change <= 5 && $change >= -5) }" || flat=false
done
$flat || fail "memory is not flat"
