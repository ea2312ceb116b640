# Goal: the reference scenes look like the pictures that Cycles and pbrt-v4 made of them. Few
# samples find gross errors only; tests/compare-references.py alone is the thorough comparison.
. "$(dirname "$0")/farm-lib.bash"
export PATHFARM_WORKER_ARGS=
export PATHFARM_SHARED=${PATHFARM_SHARED:-$(dirname "$0")/../../shared}
if ! [ -d "$PATHFARM_SHARED/references" ] || ! command -v python3 >/dev/null; then
    echo "skipped: needs python3, and references in PATHFARM_SHARED"
    exit 0
fi
python3 "$(dirname "$0")/compare-references.py" --spp 32 >"$work/compare.log" 2>&1 ||
    fail "a picture differs from its reference"
cat "$work/compare.log"
