# Goal: with techniques switched off the picture is the same but for its noise, and as any other job
# it has the same bits for any number of workers and lanes; the report says what was switched off.
. "$(dirname "$0")/farm-lib.bash"
export PATHFARM_WORKER_ARGS=
scene=$(cd "$(dirname "$0")/../scenes" && pwd)/cornell-box.pbrt

# look NAME SPP OPTIONS...
look() {
    local name=$1 spp=$2
    shift 2
    render "$name" --resolution 24x24 --spp "$spp" --max-depth 8 --cache "$work/cache" \
        --report "$work/$name.json" "$@" || fail "$name"
}

look full 1024 --seed 1
for without in "--no-light-sampling" "--no-mis" "--no-roulette" \
    "--no-light-sampling --no-mis --no-roulette"; do
    name=${without//[ -]/}
    spp=1024
    [ "$without" = --no-mis ] || [ "$without" = --no-roulette ] || spp=4096
    look "$name" "$spp" $without
    "$bin/pathfarm" compare "$work/$name.exr" "$work/full.exr" --max-relmse 0.01 \
        >"$work/compare.log" 2>&1 || fail "$without: $(cat "$work/compare.log")"
    grep -q "\"${without##*--no-}\"" "$work/$name.json" || fail "$without is not in the report"

    look few 8 $without
    look two 8 $without --workers 2 --lanes 3
    same_pixels few two
    PATHFARM_LANES=base look base 8 $without
    same_pixels few base
done
look few 8
look "everything" 8 --kernel everything
same_pixels few everything
look without 8 --no-mis
[ "$(pixels few)" != "$(pixels without)" ] || fail "--no-mis changes nothing"
