# Goal: kill a worker in the middle of a render and let another join; the picture is unchanged.
. "$(dirname "$0")/farm-lib.bash"
export PATHFARM_SIMULATED_US=3000

render calm --spp 512 --workers 2 --threads 1 || fail "the undisturbed render"
render stormy --spp 512 --workers 2 --threads 1 --listen 127.0.0.1:0 --lease-ms 200 \
    --cache "$work/cache" --report "$work/stormy.json" &
job=$!
port=$(port_of stormy)
sleep 1
victim=$(local_worker) || fail "no local worker"
kill -KILL "$victim"
"$bin/pathfarm-worker" "127.0.0.1:$port" --once --threads 1 --renderer simulated \
    >"$work/guest.log" 2>&1 &
wait $job || fail "the render did not survive"
grep -q "died of signal 9" "$work/stormy.log" || fail "the kill came too late to mean anything"
grep -q '"lost": true' "$work/stormy.json" || fail "the report does not know the lost worker"
[ "$(grep -c ' joined, ' "$work/stormy.log")" -ge 4 ] || fail "two, a successor and a guest"
same_pixels calm stormy
