# Goal: pathfarm accuracy renders every way of rendering it has, with a row for each rung, a plot and
# a page that stand alone; nothing is left behind; no way is biased, and one that is, is seen to be.
. "$(dirname "$0")/farm-lib.bash"
export PATHFARM_WORKER_ARGS= TMPDIR=$work/tmp
mkdir "$TMPDIR"
scenes=$(cd "$(dirname "$0")/../scenes" && pwd)
scene=$scenes/cornell-box.pbrt

# accuracy NAME SCENE OPTIONS...: the folder NAME, and NAME.log
accuracy() {
    local name=$1
    shift
    timeout 600 "$bin/pathfarm" accuracy "$@" -o "$work/$name" >"$work/$name.log" 2>&1
}

# of NAME CONFIGURATION COLUMN: a column of the last row of a configuration
of() {
    awk -F, -v name="$2" -v column="$3" '
        NR == 1 { for (i = 1; i <= NF; i++) if ($i == column) at = i }
        $1 == name { value = $at }
        END { print value }' "$work/$1/accuracy.csv"
}

# holds EXPRESSION: arithmetic with decimals
holds() {
    awk "BEGIN { exit !($1) }"
}

# --- All of them, quickly
accuracy all "$scene" --quick --peer "Other=0.5,0.02" || fail "all"
[ -z "$(ls -A "$TMPDIR")" ] || fail "left behind: $(ls "$TMPDIR")"
for name in default independent stratified halton hammersley no-light-sampling no-mis no-roulette \
    plain replicates-1 replicates-2 replicates-8 everything; do
    rows=$(grep -c "^$name," "$work/all/accuracy.csv")
    [ "$rows" -ge 3 ] || fail "$name has $rows rows"
    grep -q ">$name<" "$work/all/accuracy.html" || fail "$name is not on the page"
    grep -q ">$name" "$work/all/accuracy.svg" || fail "$name is not in the plot"
    # 4.5 standard errors: no bias
    holds "$(of all $name bias2) < 4.5 * $(of all $name bias2_stderr)" ||
        fail "$name is biased: $(of all $name bias2) +- $(of all $name bias2_stderr)"
    holds "$(of all $name nonfinite_samples) == 0" || fail "$name has samples that are not finite"
done
grep -q '^Other,peer,' "$work/all/accuracy.csv" || fail "the peer is not in the table"
grep -q 'data:image/png' "$work/all/accuracy.html" || fail "no crops"
! grep -q '<script\|href="http\|src="http' "$work/all/accuracy.html" || fail "the page is not alone"
holds "$(of all no-light-sampling relmse) > 4 * $(of all default relmse)" ||
    fail "light sampling is worth nothing"

# --- Planted: without roulette and with few events, energy is cut, and seen to be missing; against
# a reference with seeds of its own that lacks nothing
render full --resolution 24x24 --spp 2048 --cache "$work/cache" || fail "the reference"
accuracy biased "$scene" --quick --resolution 24x24 --max-depth 2 --configs no-roulette \
    --reference "$work/full.exr" || fail "biased"
holds "$(of biased no-roulette bias2) > 6 * $(of biased no-roulette bias2_stderr)" ||
    fail "a bias of $(of biased no-roulette bias2) +- $(of biased no-roulette bias2_stderr) is not seen"
holds "$(of biased no-roulette truncated_energy) > 0.01" || fail "what was cut is not told"

# --- What cannot be: lights that no path finds; a reference that shares a seed; names and numbers
accuracy delta "$scenes/delta-lights.pbrt" --quick --configs no-light-sampling,no-mis ||
    fail "delta"
grep -q 'no-light-sampling.*left out' "$work/delta.log" || fail "nothing was left out"
! grep -q '^no-light-sampling,' "$work/delta/accuracy.csv" || fail "it was not left out"
render same --resolution 24x24 --spp 64 --seed 1001 --cache "$work/cache" || fail "the same seed"
refused() {
    local text=$1
    shift
    accuracy refused "$@"
    [ $? = 2 ] || fail "not status 2: $*"
    grep -q -- "$text" "$work/refused.log" || fail "\"$text\" was not said: $*"
}
refused 'another --seed' "$scene" --quick --resolution 24x24 --reference "$work/same.exr"
refused 'a reference of 24x24' "$scene" --quick --reference "$work/full.exr"
refused 'nearest is halton' "$scene" --configs halten
refused 'one scene' --quick
refused 'NAME=core_seconds,relmse' "$scene" --peer Other
refused 'from 2 to' "$scene" --seeds 1
refused 'nothing.pbrt' "$work/nothing.pbrt"
[ -z "$(ls -A "$TMPDIR")" ] || fail "left behind: $(ls "$TMPDIR")"

# --- Interrupted: the render ends, the folder goes, and no picture is left
timeout 60 "$bin/pathfarm" accuracy "$scene" --core-seconds 1000 -o "$work/stopped" \
    >"$work/stopped.log" 2>&1 &
started() { ls "$TMPDIR"/pathfarm-*/said; }
wait_for 20 started || fail "nothing starts"
kill -TERM $!
wait $! && fail "stopped, and status 0"
[ -z "$(ls -A "$TMPDIR")" ] || fail "left behind: $(ls "$TMPDIR")"
[ ! -e "$work/stopped/accuracy.html" ] || fail "a page of half the renders"
