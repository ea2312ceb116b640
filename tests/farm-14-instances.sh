# Goal: instances and motion reach the workers like everything else: the same pixels with one and
# two workers and any number of threads, from the cache too, and with the kernel's fallback.
. "$(dirname "$0")/farm-lib.bash"
export PATHFARM_WORKER_ARGS=
scenes=$(cd "$(dirname "$0")/../scenes" && pwd)

look() {
    render "$@" --resolution 80x48 --spp 16 --cache "$work/cache" || fail "$scene: $*"
}

for name in instances motion-blur; do
    scene=$scenes/$name.pbrt
    look "$name" --workers 1 --threads 1
    look "$name-two" --workers 2 --threads 1
    look "$name-threads" --workers 1 --threads 2
    PATHFARM_LANES=base look "$name-base" --workers 1 --threads 2
    for other in two threads base; do
        same_pixels "$name" "$name-$other"
    done
done

# Planted: without the motion the picture is another one
sed '/^ActiveTransform\|^    ActiveTransform/d' "$scenes/motion-blur.pbrt" >"$work/still.pbrt"
scene=$work/still.pbrt
look still --workers 1
[ "$(pixels still)" != "$(pixels motion-blur)" ] || fail "motion makes no difference"
