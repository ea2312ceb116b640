# Goal: a worker that has the scene in its cache does not ask for it again, and renders the same.
. "$(dirname "$0")/farm-lib.bash"

render cold --spp 64 --cache "$work/cache" --report "$work/cold.json" || fail "first render"
render warm --spp 64 --cache "$work/cache" --report "$work/warm.json" || fail "second render"
render none --spp 64 --no-cache --report "$work/none.json" || fail "without cache"
same_pixels cold warm
same_pixels cold none
grep -q '"cached": true' "$work/cold.json" && fail "the first render found a cached scene"
grep -q '"cached": true' "$work/warm.json" || fail "the second render found no cached scene"
grep -q '"cached": true' "$work/none.json" && fail "--no-cache found a cached scene"
exit 0
