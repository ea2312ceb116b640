# Goal: whatever is wrong with a scene, its author reads which file and line, and what; the status
# is 2, nothing is rendered or left behind, and neither time nor memory goes to what a bad file
# claims to hold.
. "$(dirname "$0")/farm-lib.bash"
mkdir "$work/in" "$work/out"
cd "$work/in" || exit 1

# A render that goes wrong has a GiB of address space and ten seconds, which no sanitizer's shadow
# memory fits into
limit=$((1 << 20))
nm "$bin/pathfarm" 2>/dev/null | grep -q __asan_init && limit=unlimited

# refused POSITION TEXT [FILE]: FILE (bad.pbrt) is refused in one line, at that position
refused() {
    local position=$1 text=$2 file=${3:-bad.pbrt} status
    (ulimit -v $limit && timeout 10 "$bin/pathfarm" render "$file" -o "$work/out/bad.exr" \
        --report "$work/out/bad.json" --spp 1 >"$work/bad.log" 2>&1)
    status=$?
    [ $status = 2 ] || fail "status $status: $text"
    grep -qF -- "$position: " "$work/bad.log" || fail "the position is not $position: $text"
    grep -q -- "$text" "$work/bad.log" || fail "\"$text\" was not said"
    [ "$(wc -l <"$work/bad.log")" = 1 ] || fail "not one line: $text"
    [ -z "$(ls -A "$work/out")" ] || fail "something was left behind: $text"
}

# bad TEXT: what comes after WorldBegin, which is in line 4
bad() {
    printf '%s\n' 'LookAt 0 0 4  0 0 0  0 1 0' 'Camera "perspective"' \
        'Film "rgb" "integer xresolution" 8 "integer yresolution" 8' WorldBegin "$@" >bad.pbrt
}
triangle='"point3 P" [ 0 0 0  1 0 0  0 1 0 ] "integer indices"'

# --- Words
bad 'Sphere "sphere"'
refused bad.pbrt:5:1 'Sphere'
bad 'Shape "spere"'
refused bad.pbrt:5:7 'nearest is "sphere"'
bad 'Material "hair"'
refused bad.pbrt:5:10 'not supported yet'
bad 'Shape "sphere" "float raduis" 1'
refused bad.pbrt:5:16 'raduis'
bad 'Shape "sphere" "float radius" "one"'
refused bad.pbrt:5:31 'radius'
bad 'Shape "sphere" "float radius" [ 1'
refused bad.pbrt:5:16 'no closing bracket'
bad 'Shape "sphere'
refused bad.pbrt:5:7 'quote'
bad 'Translate 1 2'
refused bad.pbrt:6:1 'number'
bad 'Translate 1 2 nan'
refused bad.pbrt:5:15 'nan'
bad 'Translate 1 2 1e999'
refused bad.pbrt:5:15 '1e999'
bad 'AttributeBegin'
refused bad.pbrt:5:1 'not closed at the end of the file'
bad 'AttributeEnd'
refused bad.pbrt:5:1 'AttributeEnd'
bad 'Scale 1 0 1' 'Shape "sphere"'
refused bad.pbrt:5:1 'cannot be inverted'
printf '\177ELF\002\001\001\0\0\0' >bad.pbrt
refused bad.pbrt:1:1 'ELF'
: >bad.pbrt
refused bad.pbrt:1:1 'no WorldBegin'

# --- Names
bad 'MakeNamedMaterial "walls" "string type" "diffuse"' 'NamedMaterial "wals"'
refused bad.pbrt:6:15 'no material "wals"; the nearest is "walls"'
bad 'NamedMaterial "walls"'
refused bad.pbrt:5:15 'no material "walls"'
bad 'Material "difuse"'
refused bad.pbrt:5:10 'nearest is "diffuse"'
bad 'Material "glass"'
refused bad.pbrt:5:10 'dielectric'
bad 'MakeNamedMaterial "a" "string type" "mix" "string materials" [ "a" "a" ]' \
    'NamedMaterial "a"' 'Shape "sphere"'
refused bad.pbrt:5:37 'contains itself'
bad 'Material "diffuse" "rgb reflectance" [ -0.1 0 0 ]'
refused bad.pbrt:5:20 '-0.1'
bad 'ObjectInstance "ghost"'
refused bad.pbrt:5:16 'no object "ghost"'
bad 'LightSource "infinite" "string filename" "sky.exr"'
refused bad.pbrt:5:42 'sky.exr'

# --- Files
bad 'Include "bad.pbrt"'
refused bad.pbrt:5:9 'includes itself'
bad 'Include "one.pbrt"'
echo 'Include "two.pbrt"' >one.pbrt
echo 'Include "one.pbrt"' >two.pbrt
refused two.pbrt:1:9 'includes itself'
bad 'Include "missing.pbrt"'
refused bad.pbrt:5:9 'missing.pbrt'
bad 'Include "."'
refused bad.pbrt:5:9 'regular file'
echo 'Shape "spere"' >inner.pbrt
bad 'Include "inner.pbrt"'
refused inner.pbrt:1:7 'nearest is "sphere"'
refused nothing.pbrt 'No such file' nothing.pbrt
refused . 'regular file' .

# --- Meshes
bad "Shape \"trianglemesh\" $triangle [ 0 1 3 ]"
refused bad.pbrt:5:57 'index 3 .* out of range: there are 3 vertices'
bad "Shape \"trianglemesh\" $triangle [ 0 1 -1 ]"
refused bad.pbrt:5:57 'index -1 .* out of range'
bad "Shape \"trianglemesh\" $triangle [ 0 1 2 0 ]"
refused bad.pbrt:5:57 'multiple of three'
bad 'Shape "trianglemesh" "point3 P" [ 0 0 0  1 0 nan  0 1 0 ]'
refused bad.pbrt:5:46 'nan'
bad 'Shape "trianglemesh" "point3 P" [ 0 0 0  1 0 1e39  0 1 0 ]'
refused bad.pbrt:5:7 'float32'
bad 'Shape "sphere" "float radius" 0'
refused bad.pbrt:5:7 'no area'
bad 'Shape "sphere" "float radius" -1'
refused bad.pbrt:5:7 'no area'

# --- Lights
bad 'AreaLightSource "diffuse"' 'Shape "trianglemesh" "point3 P" [ 0 0 0  1 1 1  2 2 2 ]'
refused bad.pbrt:5:17 'this light has no area'
bad 'AreaLightSource "diffuse"' 'Shape "disk" "float radius" 0'
refused bad.pbrt:6:7 'no area'
bad 'LightSource "spot" "point3 from" [ 1 1 1 ] "point3 to" [ 1 1 1 ]'
refused bad.pbrt:5:13 'same point'
bad 'LightSource "point" "rgb I" [ 1 1 nan ]'
refused bad.pbrt:5:35 'nan'
bad 'AreaLightSource "diffuse" "rgb L" [ -1 1 1 ]' 'Shape "sphere"'
refused bad.pbrt:5:27 'colour of -1'

# --- PLY files
header() {
    printf '%s\n' ply "format ${3:-ascii} 1.0" "element vertex $1" 'property float x' \
        'property float y' 'property float z' "element face $2" \
        'property list uchar int vertex_indices' end_header
}
ply='Shape "plymesh" "string filename" "mesh.ply"'
bad "$ply"
refused 'bad.pbrt:5:35: mesh.ply' 'cannot be opened'
echo 'not ply' >mesh.ply
refused 'bad.pbrt:5:35: mesh.ply:1' 'not a PLY file'
: >mesh.ply
refused 'bad.pbrt:5:35: mesh.ply:1' 'ends inside the PLY header'
header 3 1 | head -n 6 >mesh.ply
refused 'bad.pbrt:5:35: mesh.ply:7' 'ends inside the PLY header'
(header 3 1 && printf '0 0 0\n1 0 0\n') >mesh.ply
refused 'bad.pbrt:5:35: mesh.ply' 'ends early, in vertex 2'
(header 3 1 && printf '0 0 0\n1 0 0\n0 1 0\n') >mesh.ply
refused 'bad.pbrt:5:35: mesh.ply' 'ends early, in face 0'
(header 3 1 && printf '0 0 0\n1 0 0\n0 1 0\n3 0 1 3\n') >mesh.ply
refused 'bad.pbrt:5:35: mesh.ply' 'face 0: vertex index 3 is out of range (3 vertices)'
(header 3 1 && printf '0 0 0\n1 0 0\n0 1 0\n3 0 1 -1\n') >mesh.ply
refused 'bad.pbrt:5:35: mesh.ply' 'face 0: vertex index -1 is out of range'
(header 3 1 && printf '0 0 0\n1 nan 0\n0 1 0\n3 0 1 2\n') >mesh.ply
refused 'bad.pbrt:5:35: mesh.ply' 'vertex 1: its position is not finite'
(header 3 1 && printf '0 0 0\n1 x 0\n0 1 0\n3 0 1 2\n') >mesh.ply
refused 'bad.pbrt:5:35: mesh.ply:11' '"x" is not a number'
(header 3 1 && printf '0 0 0\n1 0 0\n0 1 0\n255 0 1 2\n') >mesh.ply
refused 'bad.pbrt:5:35: mesh.ply' 'ends early, in face 0'
(header 1000000000 1 && printf '0 0 0\n') >mesh.ply
refused 'bad.pbrt:5:35: mesh.ply' '1000000000'
(header 1000000000 1 binary_little_endian && printf '0000') >mesh.ply
refused 'bad.pbrt:5:35: mesh.ply' '1000000000'
gzip -c mesh.ply >mesh.ply.gz && mv mesh.ply.gz mesh.ply
refused 'bad.pbrt:5:35: mesh.ply' 'ends early'
(header 3 99999999999999999999) >mesh.ply
refused 'bad.pbrt:5:35: mesh.ply:7' '99999999999999999999'
(header 3 1 binary_big_endian && printf '%036d' 0 && printf '\377\377') >mesh.ply
refused 'bad.pbrt:5:35: mesh.ply' 'ends early, in face 0'
(header 3 1 binary_middle_endian) >mesh.ply
refused 'bad.pbrt:5:35: mesh.ply:2' 'binary_middle_endian'
(header 3 1 && printf '0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n') | gzip -c | head -c 60 >mesh.ply
refused 'bad.pbrt:5:35: mesh.ply:3' 'ends inside the PLY header'

# --- The same input is no trouble to a render that runs: the picture comes out
(header 3 1 && printf '0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n') >mesh.ply
timeout 60 "$bin/pathfarm" render bad.pbrt -o "$work/out/good.exr" --spp 4 >"$work/good.log" 2>&1 ||
    fail "a good mesh is refused"

# --- Output that cannot be written: told, and nothing left
"$bin/pathfarm" render bad.pbrt -o "$work/nowhere/out.exr" --spp 4 >"$work/nowhere.log" 2>&1
status=$?
[ $status = 1 ] || [ $status = 2 ] || fail "an output folder that is missing: status $status"
grep -q 'nowhere/out.exr' "$work/nowhere.log" || fail "the missing folder was not named"
