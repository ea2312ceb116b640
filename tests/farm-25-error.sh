# Goal: --error ends at the first round that meets it, with the same bits on any farm, and --spp of
# what it reports gives them again; of several limits the first one ends the job, and it is said
# which; the ledger has a line a round, the same figures in the file, the report and the picture.
. "$(dirname "$0")/farm-lib.bash"
unset PATHFARM_WORKER_ARGS # rays, not hashes: these have an error

# said NAME: what the job says at its end; spp_of NAME: its samples per pixel
said() {
    grep "^$work/$1.exr, " "$work/$1.log" || fail "$1 does not say how it ended"
}
spp_of() {
    said "$1" | sed -n 's/.*png: \([0-9]*\) samples per pixel.*/\1/p'
}
ended_by() {
    said "$1" | grep -q "stopped by --$2" || fail "$1 was not stopped by --$2: $(said "$1")"
}
# field NAME KEY...: of the report
field() {
    python3 -c 'import json, sys
value = json.load(open(sys.argv[1]))
for key in sys.argv[2:]:
    value = value[int(key) if isinstance(value, list) else key]
print(value)' "$work/$1.json" "${@:2}"
}

error=3e-06
render one --error $error --workers 1 --threads 1 --report "$work/one.json" \
    --ledger "$work/one.csv" --heat "$work/heat.png" || fail "one worker"
render two --error $error --workers 2 --threads 2 --lease-nodes 1,1 || fail "two workers"
render ahead --error $error --workers 1 --lease-ms 20000 --leases-in-flight 9 || fail "far ahead"
ended_by one error
for other in two ahead; do
    [ "$(spp_of $other)" = "$(spp_of one)" ] || fail "$other has $(spp_of $other) samples"
    same_pixels one $other
done
render counted --spp "$(spp_of one)" || fail "--spp"
grep -q "rounded up" "$work/counted.log" && fail "not a whole round"
same_pixels one counted

# The first round that meets it: the last row does, and no row before
[ "$(field one stopped_by)" = error ] || fail "the report does not say so"
[ "$(field one limits error)" = $error ] || fail "nor what was asked for"
python3 - "$work/one.json" "$work/one.csv" $error <<'PYTHON' || fail "the rows are not as they should be"
import csv, json, sys
report, target = json.load(open(sys.argv[1])), float(sys.argv[3])
rows, ledger = list(csv.DictReader(open(sys.argv[2]))), report["ledger"]
assert len(rows) == len(ledger) > 4
for row, told in zip(rows, ledger):
    assert int(row["spp"]) == told["spp"]
    assert abs(float(row["core_seconds"]) - told["core_seconds"]) < 1e-6
    error = told["error"]["relmse"]
    assert row["relmse"] == "" if error is None else abs(float(row["relmse"]) / error - 1) < 1e-6
    assert (error is not None and error <= target) == (told is ledger[-1])
assert len(report["predictions"]) >= 1
for p in report["predictions"]:
    assert p["at_spp"] >= 4 * ledger[0]["spp"]
    for band in p["spp"], p["core_seconds"], p["wall_seconds"]:
        assert band[0] <= band[1] <= band[2]
PYTHON
[ -s "$work/heat.png" ] || fail "no heat map"
for fact in stoppedBy relMSE ledger coreSeconds unknownShare; do
    grep -aq "pathfarm.$fact" "$work/one.exr" || fail "no $fact in the picture"
done

# Limits together: the first that is met, and a target that is out of reach is no failure
render few --error $error --spp 32 --report "$work/few.json" || fail "--error and --spp"
ended_by few spp
said few | grep -q "the target was not reached" || fail "few seems to have reached it"
[ "$(field few spp)" = 32 ] && [ "$(field few limits spp)" = 32 ] || fail "few has other samples"
render many --error $error --spp 100000 || fail "--spp out of reach"
ended_by many error
same_pixels one many
render late --error 1e-9 --time 1s || fail "--error and --time"
ended_by late time
render poor --error 1e-9 --budget-core-hours 0.0001 --report "$work/poor.json" || fail "a budget"
ended_by poor budget-core-hours
python3 -c "import sys; sys.exit(not 0.02 < $(field poor core_seconds) < 0.5)" ||
    fail "0.36 core-seconds became $(field poor core_seconds)"

# A target that nobody reaches: the ledger is there while the job runs, and after it was interrupted
"$bin/pathfarm" render "$scene" -o "$work/endless.exr" --error 1e-12 --write-every 0.2s \
    --ledger "$work/endless.csv" --report "$work/endless.json" >"$work/endless.log" 2>&1 &
job=$!
wait_for 60 test -s "$work/endless.csv" || fail "no ledger while it runs"
kill -INT $job
wait $job && fail "an interrupted job is done"
[ "$(field endless stopped_by)" = None ] || fail "something stopped endless"
[ "$(tail -n 1 "$work/endless.csv" | cut -d, -f2)" = "$(field endless spp)" ] ||
    fail "the ledger does not end where the picture does"

refused() {
    local text=$1
    shift
    render refused "$@"
    [ $? = 2 ] || fail "not status 2: $*"
    grep -q -- "$text" "$work/refused.log" || fail "\"$text\" was not said: $*"
}
refused 'number above 0' --error 0
refused 'number above 0' --budget-core-hours -1
refused 'beforehand' --error 0.1 --sampler stratified
refused 'beforehand' --budget-core-hours 1 --sampler hammersley
refused 'only one of them' --error 0.1 --replicates 1
