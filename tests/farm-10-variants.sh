# Goal: every example scene has the same bits whichever kernel variant renders it, with one active
# lane or eight, and on a processor without AVX2.
. "$(dirname "$0")/farm-lib.bash"
export PATHFARM_WORKER_ARGS=
scenes=$(cd "$(dirname "$0")/../scenes" && pwd)

# look NAME OPTIONS...: a small picture of $scene; 36x20 has a cut tile, 8 samples fill the lanes
look() {
    render "$@" --resolution 36x20 --spp 8 --workers 1 --threads 2 --cache "$work/cache" ||
        fail "$scene: $*"
}

for scene in "$scenes"/*.pbrt "$scenes"/*.gltf; do
    name=$(basename "${scene%.*}")
    look "$name"
    look "$name-everything" --kernel everything
    look "$name-one-lane" --lanes 1
    PATHFARM_LANES=base look "$name-base"
    for other in everything one-lane base; do
        same_pixels "$name" "$name-$other"
    done
done
