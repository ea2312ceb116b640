# Goal: over TLS the pixels are the same; who has no key, or the wrong one, stays outside; and
# plaintext is refused off loopback.
. "$(dirname "$0")/farm-lib.bash"
export PATHFARM_SIMULATED_US=2000

"$bin/pathfarm" keygen "$work/keys" >/dev/null || fail "keygen"
"$bin/pathfarm" keygen "$work/other" >/dev/null || fail "keygen"
render plain --spp 128 || fail "plain"
render tls --spp 128 --workers 0 --listen 127.0.0.1:0 --keys "$work/keys" &
job=$!
port=$(port_of tls)
timeout 20 "$bin/pathfarm-worker" "127.0.0.1:$port" --once --keys "$work/other" \
    --renderer simulated >"$work/stranger.log" 2>&1 && fail "a stranger was let in"
timeout 20 "$bin/pathfarm-worker" "127.0.0.1:$port" --once --renderer simulated \
    >"$work/naked.log" 2>&1 && fail "a worker without TLS was let in"
"$bin/pathfarm-worker" "127.0.0.1:$port" --once --keys "$work/keys" --renderer simulated \
    >"$work/guest.log" 2>&1 &
wait $job || fail "the render over TLS"
same_pixels plain tls
[ "$(grep -c ' joined, ' "$work/tls.log")" = 1 ] || fail "somebody else joined"
grep -q ", TLS" "$work/tls.log" || fail "that was not TLS"

render open --spp 16 --listen 0.0.0.0:0
[ $? = 2 ] || fail "plaintext on all interfaces was not refused"
