# Goal: garbage, half messages and silence on the master's socket end in a logged disconnect; the
# render goes on and gives the same pixels.
. "$(dirname "$0")/farm-lib.bash"
export PATHFARM_SIMULATED_US=8000

render calm --spp 256 --threads 1 || fail "the undisturbed render"
render noisy --spp 256 --threads 1 --listen 127.0.0.1:0 &
job=$!
port=$(port_of noisy)

# say FORMAT: connect, send the bytes, hold the line for a moment
say() {
    (exec 3<>"/dev/tcp/127.0.0.1/$port" && printf "$1" >&3 && sleep 0.3) 2>/dev/null
}
for i in 1 2 3; do
    (exec 3<>"/dev/tcp/127.0.0.1/$port" && head -c 20000 /dev/urandom >&3) 2>/dev/null
done
say 'GET / HTTP/1.1\r\nHost: farm\r\n\r\n'
say '\377\377\377\377\377\377\377\377\001\0\0\0'   # a HELLO of 4 GiB
say '\020\0\0\0\0\0\0\0\001\0\0\0half'             # a HELLO that stops
say '\004\0\0\0\0\0\0\0\011\0\0\0abcd'             # a RESULT before any HELLO
say '\002\0\0\0\0\0\0\0\001\0\0\0\010\001'         # a HELLO with next to nothing in it
say '\004\0\0\0\0\0\0\0\001\0\0\0\377\377\377\377' # a HELLO that is no message
(exec 3<>"/dev/tcp/127.0.0.1/$port" && sleep 2) & # silence

wait $job || fail "the render did not survive"
same_pixels calm noisy
[ "$(grep -c ': disconnected: ' "$work/noisy.log")" -ge 6 ] || fail "the visitors were not logged"
[ "$(grep -c ' joined, ' "$work/noisy.log")" = 1 ] || fail "a visitor was taken for a worker"
