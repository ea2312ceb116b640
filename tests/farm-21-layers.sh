# Goal: the layers go through the farm like radiance: the same bits for any workers, threads and
# lanes; radiance is what it is without them; half and other compressions hold the same picture.
. "$(dirname "$0")/farm-lib.bash"
export PATHFARM_WORKER_ARGS=

channels="A depth.Z position.X position.Y normal.Z geometric_normal.X albedo.R
CryptoObject00.R CryptoObject00.G CryptoMaterial00.R CryptoMaterial00.B"
all=alpha,depth,position,normal,geometric_normal,albedo,motion,object,material

# The digest of one channel of a picture
channel() {
    "$bin/pathfarm" compare --json --channels "$2" "$work/$1.exr" "$work/$1.exr" |
        sed -n 's/.*"pixels_sha256_a": *"\([0-9a-f]*\)".*/\1/p'
}

render plain --spp 64 || fail "no layers"
render one --spp 64 --aov $all --workers 1 --threads 1 || fail "one worker"
render two --spp 64 --aov $all --workers 2 --threads 1 --lease-nodes 1,1 || fail "two workers"
render threads --spp 64 --aov alpha --aov depth,position,normal,geometric_normal \
    --aov albedo,motion,object,material --threads 2 --lanes 1 --kernel everything || fail "one lane"
for other in one two threads; do
    same_pixels plain "$other"
done
for name in $channels; do
    want=$(channel one "$name")
    [ -n "$want" ] || fail "no channel $name"
    for other in two threads; do
        [ "$(channel $other "$name")" = "$want" ] || fail "$name of $other differs"
    done
done
[ "$(channel one A)" != "$(channel one depth.Z)" ] || fail "alpha and depth are the same"

for packing in none rle zips zip piz; do
    render $packing --spp 16 --aov depth --exr-compression $packing || fail "$packing"
    same_pixels none $packing
    [ "$(channel $packing depth.Z)" = "$(channel none depth.Z)" ] || fail "depth in $packing"
done
render half --spp 16 --aov depth,albedo --exr-type half || fail "half"
[ "$(channel half depth.Z)" = "$(channel none depth.Z)" ] || fail "half rounds the depth"
"$bin/pathfarm" compare "$work/half.exr" "$work/none.exr" --max-relmse 1e-6 >/dev/null ||
    fail "half is another picture"

# Named materials keep their names in the manifest
sed -i 's/^Material "diffuse"/MakeNamedMaterial "chalk" "string type" "diffuse"/; s/^Shape/NamedMaterial "chalk"\nShape/' "$scene"
render named --spp 4 --aov material || fail "a named material"
grep -aq '{"chalk":"' "$work/named.exr" || fail "no chalk in the manifest"

refused() { # WORDS OPTIONS...: the render is refused with these words
    local words=$1
    shift
    render refused "$@"
    [ $? -eq 2 ] || fail "$* is taken"
    grep -q -- "$words" "$work/refused.log" || fail "$* does not say \"$words\""
}
refused "the nearest is depth" --aov depht
refused "there are alpha" --aov ""
refused "neither float nor half" --exr-type double
refused "none of zip" --exr-compression dwaa
