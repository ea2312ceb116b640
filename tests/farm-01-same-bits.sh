# Goal: the pixels do not depend on how many workers and threads there are, nor on how the work is
# cut into leases.
. "$(dirname "$0")/farm-lib.bash"

render one --spp 200 --workers 1 --threads 1 || fail "one worker"
render two --spp 200 --workers 2 --threads 1 || fail "two workers"
render four --spp 200 --workers 4 --threads 1 || fail "four workers"
render threads --spp 200 --workers 1 --threads 2 || fail "two threads"
render tiny --spp 200 --workers 2 --threads 2 --lease-nodes 1,1 || fail "tiny leases"
render huge --spp 200 --workers 2 --threads 2 --lease-nodes 1000000,1000000 || fail "huge leases"
for other in two four threads tiny huge; do
    same_pixels one "$other"
done
cmp -s "$work/one.png" "$work/tiny.png" || fail "the previews differ"

render seed --spp 200 --seed 1 || fail "another seed"
[ "$(pixels seed)" != "$(pixels one)" ] || fail "the seed makes no difference"
