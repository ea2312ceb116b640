#!/usr/bin/env bash
# A render of a minute on two threads leaves the memory of master and worker flat: the largest
# resident size from 20 seconds on, the writing of the picture included, is within 5 % of that after
# 20 seconds. Not part of deploy/test, because it takes a minute.
# Usage: PATHFARM_BIN=build/release/bin tests/memory-flat.sh [SECONDS [WIDTHxHEIGHT [SCENE
#        [OPTION...]]]], options of render such as --write-every 1s
. "$(dirname "$0")/farm-lib.bash"
export PATHFARM_WORKER_ARGS=
seconds=${1:-60}
resolution=${2:-512x512}
scene=${3:-$(dirname "$0")/../scenes/cornell-box.pbrt}

resident_kb() { sed -n 's/^VmRSS:[[:space:]]*\([0-9]*\) kB/\1/p' "/proc/$1/status" 2>/dev/null; }

"$bin/pathfarm" render "$scene" -o "$work/flat.exr" --time "$seconds" \
    --resolution "$resolution" --workers 1 --threads 2 --quiet \
    --cache "$work/cache" "${@:4}" >"$work/flat.log" 2>&1 &
master=$!
wait_for 10 local_worker || fail "no worker"
worker=$(local_worker)
begin=$SECONDS
early_at=$((seconds / 3))
early_master= early_worker= late_master=0 late_worker=0
while kill -0 "$master" 2>/dev/null; do
    sleep 0.1
    [ $((SECONDS - begin)) -ge $early_at ] || continue
    for who in master worker; do
        now=$(resident_kb "${!who}")
        [ -n "$now" ] || continue # it has ended
        early=early_$who late=late_$who
        [ -n "${!early}" ] || printf -v "$early" %d "$now"
        [ "$now" -le "${!late}" ] || printf -v "$late" %d "$now"
    done
done
wait "$master" || fail "the render"
[ -n "$early_master" ] && [ -n "$early_worker" ] || fail "the render ended too early"

flat=true
for who in master worker; do
    early=early_$who late=late_$who
    change=$(awk "BEGIN { printf \"%+.2f\", 100 * (${!late} / ${!early} - 1) }")
    echo "$who: ${!early} kB after $early_at s, at most ${!late} kB from then to the end, $change %"
    awk "BEGIN { exit !($change <= 5) }" || flat=false
done
$flat || fail "memory is not flat"
