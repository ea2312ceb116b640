# Goal: SIGINT and SIGTERM leave a picture of the finished rounds and no processes; a master that is
# killed takes its local workers with it.
. "$(dirname "$0")/farm-lib.bash"
export PATHFARM_SIMULATED_US=3000

for signal in INT TERM; do
    "$bin/pathfarm" render "$scene" -o "$work/$signal.exr" --spp 100000 --workers 2 --threads 1 \
        --cache "$work/cache" >"$work/$signal.log" 2>&1 &
    job=$!
    sleep 2
    kill -$signal $job
    wait $job
    [ $? = 1 ] || fail "$signal: not status 1"
    [ -s "$work/$signal.exr" ] || fail "$signal: no picture"
    grep -q "stopped by signal" "$work/$signal.log" || fail "$signal: not said"
    grep -q "samples per pixel that were finished" "$work/$signal.log" || fail "$signal: how much?"
    local_worker && fail "$signal: workers are left"
    # What is there is what a render of as many samples gives
    spp=$(sed -n 's/.* holds the \([0-9]*\) samples per pixel.*/\1/p' "$work/$signal.log")
    PATHFARM_SIMULATED_US=0 render "again-$signal" --spp "$spp" || fail "the same again"
    same_pixels "$signal" "again-$signal"
done

"$bin/pathfarm" render "$scene" -o "$work/killed.exr" --spp 100000 --workers 2 --threads 1 \
    --cache "$work/cache" >"$work/killed.log" 2>&1 &
job=$!
wait_for 10 local_worker || fail "no workers"
kill -KILL $job
gone() { ! local_worker; }
wait_for 10 gone || fail "the workers survive their master"
[ ! -e "$work/killed.exr" ] || fail "a killed master leaves a picture"
[ -z "$(find "$work" -name '*killed.exr*')" ] || fail "a killed master leaves half a picture"
