#!/usr/bin/env bash
# Fuzz what reads bytes from outside, for as long as asked (60 s for each target):
#
#     tests/fuzz.sh [SECONDS [TARGET...]]
#
# TARGET: pbrt gltf ply png jpeg tga hdr pfm exr frame node_wire; all of them by default
#
# Not part of deploy/test; needs clang. Builds in build/fuzz with the address and undefined
# sanitizers. What was learned stays in build/fuzz/corpus-TARGET, and the next run starts from it;
# an input that breaks something is left in build/fuzz/TARGET-crash-* and ends the run with status 1.
set -eu
cd "$(dirname "$0")/.."
seconds=${1:-60}
[ $# -eq 0 ] || shift
[ $# -gt 0 ] || set -- pbrt gltf ply png jpeg tga hdr pfm exr frame node_wire
shared=${PATHFARM_SHARED:-../shared}

out=build/fuzz
checks=address,undefined
log=$out/build.log
mkdir -p "$out"
if ! { cmake -S . -B "$out" -G Ninja -DCMAKE_C_COMPILER=clang -DCMAKE_BUILD_TYPE=Debug \
        -DCMAKE_C_FLAGS="-O1 -g -fsanitize=fuzzer-no-link,$checks" &&
    ninja -C "$out" pathfarm_common pathfarm_proto pathfarm_master; } >"$log" 2>&1; then
    tail -30 "$log" >&2
    exit 1
fi

for target in "$@"; do
    corpus=$out/corpus-$target
    seeds=$out/seeds-$target
    mkdir -p "$corpus" "$seeds"
    source=tests/fuzz_$target.c
    format=
    case $target in
    png | jpeg | tga | hdr | pfm | exr)
        source=tests/fuzz_picture.c
        format=-DFUZZ_FORMAT=$target
        ;;
    esac
    # What is small enough to change and still to be read in no time
    find scenes "$shared/scenes" -size -64k \( -name "*.$target" -o -name "*.${target/jpeg/jpg}" \) \
        -exec cp {} "$seeds" \; 2>/dev/null || true
    # shellcheck disable=SC2046 # words of pkg-config
    clang -std=c17 -D_GNU_SOURCE -O1 -g -Wno-psabi -fsanitize=fuzzer,$checks $format -I. \
        -I"$out/generated" $(pkg-config --cflags libprotobuf-c libuv openssl OpenEXR libpng) \
        "$source" -o "$out/fuzz_$target" \
        "$out/libpathfarm_master.a" "$out/libpathfarm_proto.a" "$out/libpathfarm_common.a" \
        $(pkg-config --libs libprotobuf-c libuv openssl zlib OpenEXR libpng libjpeg jansson) -lm
    # Readers may take 64 MiB, and 64 bytes for each byte of input
    "$out/fuzz_$target" -max_total_time="$seconds" -max_len=65536 -timeout=5 -malloc_limit_mb=68 \
        -artifact_prefix="$out/$target-" -print_final_stats=1 "$corpus" "$seeds" $(
            case $target in
            pbrt) echo -dict=tests/fuzz_pbrt.dict ;;
            esac
        ) 2>"$out/$target.log" || {
        tail -40 "$out/$target.log" >&2
        echo "fuzz.sh: $target is broken; the input is $out/$target-*" >&2
        exit 1
    }
    awk -v target="$target" '/number_of_executed_units/ { print target ": " $2 " inputs, no fault" }' \
        "$out/$target.log"
done
