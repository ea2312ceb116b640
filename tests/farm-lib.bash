# What the farm scenarios share: sourced by tests/farm-*.sh. Rendering is simulated (hashes instead
# of rays) unless a scenario says otherwise; $PATHFARM_BIN is where the programs are.
set -u
bin=${PATHFARM_BIN:?the folder of the programs}
work=$(mktemp -d)
export PATHFARM_WORKER_ARGS="--renderer simulated"
unset PATHFARM_SIMULATED_US PATHFARM_SIMULATED_FAIL
trap 'kill $(jobs -p) 2>/dev/null; wait 2>/dev/null; rm -rf "$work"' EXIT

fail() {
    echo "FAILED: $*" >&2
    for log in "$work"/*.log; do
        [ -s "$log" ] && { echo "--- $(basename "$log")" >&2; tail -n 25 "$log" >&2; }
    done
    exit 1
}

# A small scene: 96x80 pixels are 9 tiles, some of them cut
scene=$work/scene.pbrt
cat >"$scene" <<'SCENE'
LookAt 0 0 4  0 0 0  0 1 0
Camera "perspective" "float fov" [ 45 ]
Film "rgb" "integer xresolution" [ 96 ] "integer yresolution" [ 80 ]
WorldBegin
LightSource "infinite" "rgb L" [ 1 1 1 ]
Material "diffuse" "rgb reflectance" [ 0.5 0.5 0.5 ]
Shape "sphere"
SCENE

# render NAME OPTIONS...: NAME.exr, NAME.log; the exit status is the program's
render() {
    local name=$1
    shift
    timeout 120 "$bin/pathfarm" render "$scene" -o "$work/$name.exr" "$@" >"$work/$name.log" 2>&1
}

# The digest of a picture's pixels
pixels() {
    "$bin/pathfarm" compare --json "$work/$1.exr" "$work/$1.exr" |
        sed -n 's/.*"pixels_sha256_a": *"\([0-9a-f]*\)".*/\1/p'
}

same_pixels() {
    local a b
    a=$(pixels "$1") b=$(pixels "$2")
    [ -n "$a" ] || fail "$1.exr cannot be read"
    [ "$a" = "$b" ] || fail "the pixels of $1 and $2 differ"
}

# A local worker process of a render with --cache "$work/cache": its number, or false
local_worker() {
    pgrep -f -n -- "pathfarm-worker 127.0.0.1:[0-9]+ --once.*--cache $work/cache"
}

# wait_for SECONDS COMMAND...: until the command succeeds
wait_for() {
    local tenths=$(($1 * 10))
    shift
    until "$@" >/dev/null 2>&1; do
        ((tenths-- > 0)) || return 1
        sleep 0.1
    done
}

# The port that a render with --listen says it listens on
port_of() {
    wait_for 20 grep -q '^listening on' "$work/$1.log" || fail "$1 does not listen"
    sed -n 's/^listening on .*:\([0-9]*\).*/\1/p' "$work/$1.log"
}
