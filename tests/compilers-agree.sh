#!/bin/bash
# Goal: two builds by different compilers render the same bits (NUMERICS H56: nothing depends on the
# order in which arguments are evaluated; H59: nothing is contracted or reordered).
#
# Usage: compilers-agree.sh BIN OTHER_BIN
PATHFARM_BIN=${1:?the folder of one compiler\'s programs}
PATHFARM_SOURCE=${PATHFARM_SOURCE:-$(cd "$(dirname "$0")/.." && pwd)}
. "$(dirname "$0")/farm-lib.bash"
export PATHFARM_WORKER_ARGS="" # real rendering
other=${2:?the folder of the other\'s}

for name in cornell-spheres coat sphere-disk-lights variant-gaussian-independent; do
    scene=$PATHFARM_SOURCE/scenes/$name.pbrt
    render "$name" --spp 16 --resolution 96x72 || fail "$name by one compiler"
    (bin=$other && render "$name-other" --spp 16 --resolution 96x72) ||
        fail "$name by the other compiler"
    same_pixels "$name" "$name-other"
done
