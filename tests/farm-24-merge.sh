# Goal: renders with different seeds are joined into one that is nearer to the truth than each, and
# what does not belong together is refused with a reason and status 2.
. "$(dirname "$0")/farm-lib.bash"
unset PATHFARM_WORKER_ARGS # rays: pictures with a truth

relmse() {
    "$bin/pathfarm" compare --json "$1" "$work/truth.exr" | sed -n 's/.*"relmse": *\([0-9.e-]*\).*/\1/p'
}
below() {
    python3 -c "import sys; sys.exit(not $1 < $2)"
}

render truth --spp 1024 --seed 99 || fail "the truth"
for seed in 1 2 3; do
    render $seed --spp 32 --seed $seed --aov alpha,depth,object || fail "seed $seed"
done
"$bin/pathfarm" merge "$work/1.exr" "$work/2.exr" "$work/3.exr" -o "$work/all.exr" \
    --heat "$work/heat.png" >"$work/merge.log" 2>&1 || fail "merge"
grep -q "96 samples per pixel of 3 pictures" "$work/merge.log" || fail "the samples are not added"
[ -s "$work/all.png" ] && [ -s "$work/heat.png" ] || fail "no PNG"
all=$(relmse "$work/all.exr")
for seed in 1 2 3; do
    below "$all" "0.6 * $(relmse "$work/$seed.exr")" || fail "$all is not much below seed $seed"
done

refused() {
    local text=$1
    shift
    "$bin/pathfarm" merge "$@" >"$work/refused.log" 2>&1
    [ $? = 2 ] || fail "not status 2: $*"
    grep -q -- "$text" "$work/refused.log" || fail "\"$text\" was not said: $*"
}
render size --spp 32 --seed 4 --resolution 64x64 --aov alpha,depth,object || fail "another size"
refused "another scene" "$work/1.exr" "$work/size.exr" -o "$work/no.exr"
refused "no channel A" "$work/1.exr" "$work/truth.exr" -o "$work/no.exr"
refused "seed 2 was merged already" "$work/1.exr" "$work/2.exr" "$work/2.exr" -o "$work/no.exr"
refused "seed 2 was merged already" "$work/all.exr" "$work/2.exr" -o "$work/no.exr"
refused "at least two" "$work/1.exr" -o "$work/no.exr"
refused "o OUT.exr is missing" "$work/1.exr" "$work/2.exr"
[ ! -e "$work/no.exr" ] || fail "something was written"
