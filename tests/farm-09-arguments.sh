# Goal: wrong arguments and scenes are told in a sentence, with status 2, before anything starts.
. "$(dirname "$0")/farm-lib.bash"

# refused TEXT ARGUMENTS...
refused() {
    local text=$1
    shift
    "$bin/pathfarm" "$@" >"$work/refused.log" 2>&1
    [ $? = 2 ] || fail "not status 2: $*"
    grep -q -- "$text" "$work/refused.log" || fail "\"$text\" was not said: $*"
    rm -f "$work/refused.log"
}
out=$work/out.exr
refused 'nearest is "render"' rendr
refused 'no option --sppp; the nearest is --spp' render "$scene" -o "$out" --sppp 3
refused '"0" is not a whole number' render "$scene" -o "$out" --spp 0
refused '"1e3" is not a whole number' render "$scene" -o "$out" --spp 1e3
refused 'wants N' render "$scene" -o "$out" --spp
refused 'WIDTHxHEIGHT' render "$scene" -o "$out" --resolution 100
refused 'empty crop' render "$scene" -o "$out" --crop 0.5,0.5,0,1
refused 'has 96x80 pixels' render "$scene" -o "$out" --crop 0,97,0,80
refused 'nearest is sobol' render "$scene" -o "$out" --sampler sobl
refused 'beforehand' render "$scene" -o "$out" --sampler stratified --time 3
refused 'one of them' render "$scene" -o "$out" --spp 3 --time 3
refused 'not supported yet' render "$scene" -o "$out" --error 0.01
refused 'not supported yet' render "$scene" -o "$out" --paths 'LDE'
refused 'need another end' render "$scene" -o "$out" --no-roulette
refused 'nobody would render' render "$scene" -o "$out" --workers 0
refused 'o OUT.exr is missing' render "$scene"
refused 'which scene' render -o "$out"
refused 'two scenes' render "$scene" "$scene" -o "$out"
refused "$work/nothing.pbrt" render "$work/nothing.pbrt" -o "$out"
sed 's/"infinite" "rgb L"/"point" "rgb I"/' "$scene" >"$work/point.pbrt"
refused 'no path finds' render "$work/point.pbrt" -o "$out" --no-light-sampling
[ ! -e "$out" ] || fail "something was rendered"

"$bin/pathfarm" --version | grep -q '^pathfarm ' || fail "--version"
"$bin/pathfarm" render --help | grep -q -- '--spp N' || fail "render --help"
"$bin/pathfarm" plan "$scene" | grep -q '9 tiles' || fail "plan"
