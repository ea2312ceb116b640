#!/usr/bin/env bash
# The direction of the layers holds: common <- proto <- master | worker. Includes are written from
# the root, Embree is seen below worker/kernel/ only, OpenEXR and the other picture and report
# libraries in master/ only, sockets not in common/. C file names are unique in the tree.
set -euo pipefail

cd "${1:-$(dirname "${BASH_SOURCE[0]}")/..}"
broken=0

# refuse WHY PATTERN WHERE...: no #include in WHERE may match PATTERN
refuse() {
    local why=$1 pattern=$2 found
    shift 2
    found=$(grep -HrnE --include='*.[ch]' "^ *# *include +[<\"]($pattern)" "$@" || true)
    if [[ -n $found ]]; then
        printf '%s\n  %s\n' "$found" "$why"
        broken=1
    fi
}

refuse "common/ includes nothing but common/" '(proto|master|worker)/' common
refuse "proto/ includes common/ and proto/ only" '(master|worker)/' proto
refuse "master/ does not know worker/" 'worker/' master
refuse "worker/ does not know master/" 'master/' worker
refuse "includes are written from the root" '\.' common proto master worker
refuse "only tests include tests/" 'tests/' common proto master worker

refuse "Embree belongs below worker/kernel/" 'embree3|embree4|xmmintrin_embree' common proto master
refuse "Embree belongs below worker/kernel/" 'embree3|embree4' worker/*.[ch]
refuse "pictures and reports belong in master/" 'openexr|OpenEXR|Imf|png\.h|jansson' common proto worker
refuse "common/ has no sockets, no TLS and no threads" 'uv\.h|openssl/|sys/socket|netinet/|pthread' common
refuse "kernels never touch sockets" 'uv\.h|openssl/|sys/socket' worker/kernel

# "foo/bar.h" in quotes must be one of ours, from the root
while IFS=: read -r file line text; do
    name=${text#*\"}
    name=${name%%\"*}
    if [[ ! -e $name && $name != proto/pathfarm.pb-c.h ]]; then
        printf '%s:%s: "%s" is not a path from the root\n' "$file" "$line" "$name"
        broken=1
    fi
done < <(grep -HrnE --include='*.[ch]' '^ *# *include +"' common proto master worker tests || true)

twice=$(find common proto master worker tests -name '*.c' -printf '%f\n' | sort | uniq -d |
    grep -vx 'main\.c' || true)
if [[ -n $twice ]]; then
    printf 'C file names that occur twice:\n%s\n' "$twice"
    broken=1
fi

exit $broken
