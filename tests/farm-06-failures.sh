# Goal: what cannot work ends with a reason and status 1, and never hangs.
. "$(dirname "$0")/farm-lib.bash"

PATHFARM_SIMULATED_FAIL=4 render tile --spp 64 --workers 3 --threads 1
[ $? = 1 ] || fail "a tile that no worker can render"
grep -q "simulated failure of tile 4" "$work/tile.log" || fail "the reason was not said"
[ ! -e "$work/tile.exr" ] || fail "a picture without a finished round"

printf '#!/bin/sh\nkill -SEGV $$\n' >"$work/crash"
printf '#!/bin/sh\nexit 3\n' >"$work/leave"
chmod +x "$work/crash" "$work/leave"
for how in crash leave; do
    PATHFARM_WORKER=$work/$how render "$how" --spp 64 --workers 2
    [ $? = 1 ] || fail "workers that $how"
    grep -q "the local workers keep ending" "$work/$how.log" || fail "no reason for $how"
done

PATHFARM_WORKER=$work/nothing render missing --spp 64
[ $? = 1 ] || fail "a worker program that is not there"

# Nodes that bring down every worker that has them
export PATHFARM_SIMULATED_US=200000
render crashes --spp 64 --workers 1 --threads 1 --cache "$work/cache" &
job=$!
joined() { [ "$(grep -c ' joined, ' "$work/crashes.log")" -ge "$1" ]; }
for i in 1 2 3; do
    wait_for 10 joined $i || fail "worker $i does not come"
    sleep 0.7
    kill -ABRT "$(local_worker)"
done
wait $job
[ $? = 1 ] || fail "three crashes on the same nodes"
grep -q "3 different workers failed" "$work/crashes.log" || fail "the reason was not said"
exit 0
