# Goal: with --adaptive the pixels, and the plan, depend neither on how many workers there are, nor
# on how work is cut into leases, nor on a worker that dies; the plan is told and pays for itself;
# what a pilot cannot do is refused.
. "$(dirname "$0")/farm-lib.bash"

# Tiles as unlike as can be: a little light behind the sphere, nothing elsewhere
cat >"$scene" <<'SCENE'
LookAt 0 0 4  0 0 0  0 1 0
Camera "perspective" "float fov" [ 60 ]
Film "rgb" "integer xresolution" [ 96 ] "integer yresolution" [ 96 ]
WorldBegin
LightSource "infinite" "rgb L" [ 0.3 0.3 0.3 ]
AttributeBegin
    AreaLightSource "diffuse" "rgb L" [ 500 400 300 ]
    Translate -0.9 0.9 0.9
    Shape "sphere" "float radius" [ 0.02 ]
AttributeEnd
Material "diffuse" "rgb reflectance" [ 0.5 0.5 0.5 ]
Shape "sphere"
SCENE

plan_of() {
    sed -n '/"adaptive": {/,/^  }/p' "$work/$1.json"
}

export PATHFARM_WORKER_ARGS=
render one --spp 256 --adaptive --workers 1 --threads 1 --report "$work/one.json" || fail "one"
render many --spp 256 --adaptive --workers 2 --threads 2 --lease-nodes 1,1 \
    --report "$work/many.json" || fail "tiny leases"
same_pixels one many
grep -q '^adaptive: [1-9][0-9]* of 9 tiles get twice' "$work/one.log" || fail "the plan is not told"
[ -n "$(plan_of one)" ] && [ "$(plan_of one)" = "$(plan_of many)" ] || fail "the plans differ"
grep -q '"predicted_gain": [1-9]' "$work/one.json" || fail "no gain is predicted"
render plain --spp 256 || fail "without --adaptive"
[ "$(pixels plain)" != "$(pixels one)" ] || fail "--adaptive makes no difference"
"$bin/pathfarm" compare --max-relmse 0.05 "$work/plain.exr" "$work/one.exr" >/dev/null ||
    fail "another picture"

export PATHFARM_WORKER_ARGS="--renderer simulated" PATHFARM_SIMULATED_US=1500
render calm --spp 512 --adaptive --workers 2 --threads 1 || fail "the undisturbed render"
render stormy --spp 512 --adaptive --workers 2 --threads 1 --lease-ms 200 \
    --cache "$work/cache" --verbose &
job=$!
wait_for 20 grep -q "^adaptive: " "$work/stormy.log" || fail "no plan"
victim=$(local_worker) || fail "no local worker"
kill -KILL "$victim"
wait $job || fail "the render did not survive"
grep -q "died of signal 9" "$work/stormy.log" || fail "the kill came too late to mean anything"
same_pixels calm stormy

render timed --adaptive --time 3s --threads 2 --report "$work/timed.json" || fail "--time"
grep -q '"pilot_weight": 0.0' "$work/timed.json" || fail "by time, the pilot is not shown"
[ "$(grep -c '"round":' "$work/timed.json")" -ge 2 ] || fail "too few rounds"

# refused TEXT OPTIONS...
refused() {
    local text=$1
    shift
    render refused --adaptive "$@"
    [ $? = 2 ] || fail "not status 2: $*"
    grep -q -- "$text" "$work/refused.log" || fail "\"$text\" was not said: $*"
    [ ! -e "$work/refused.exr" ] || fail "$*: something was written"
}
refused "from 256 samples per pixel on" --spp 255
refused "two replicates" --spp 1024 --replicates 1
refused "beforehand" --spp 1024 --sampler stratified

# By its error: the same stop, and the same bits, on any farm
unset PATHFARM_SIMULATED_US
render error1 --adaptive --error 1e-4 --workers 1 --threads 1 || fail "--error"
render error2 --adaptive --error 1e-4 --workers 2 --threads 2 --lease-nodes 1,1 || fail "--error"
grep -q 'stopped by --error' "$work/error1.log" || fail "not stopped by its error"
same_pixels error1 error2
