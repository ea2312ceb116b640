# Goal: --time stops after a whole round, in time, and --spp of what it reports gives the same bits.
. "$(dirname "$0")/farm-lib.bash"
export PATHFARM_SIMULATED_US=2000

begin=$(date +%s%N)
render timed --time 3s --threads 2 || fail "--time"
took=$((($(date +%s%N) - begin) / 1000000))
[ $took -lt 6000 ] || fail "three seconds took $took ms"
spp=$(sed -n 's/.*exr, .*png: \([0-9]*\) samples per pixel.*/\1/p' "$work/timed.log")
[ "$spp" -ge 32 ] || fail "only $spp samples per pixel"
PATHFARM_SIMULATED_US=0 render counted --spp "$spp" || fail "--spp $spp"
grep -q "rounded up" "$work/counted.log" && fail "$spp is not a whole round"
same_pixels timed counted
