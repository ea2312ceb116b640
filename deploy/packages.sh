# Sourced by the scripts beside it: what Debian 12 needs to build pathfarm, and how to get it.
# shellcheck shell=bash

# shellcheck disable=SC2034 # used by the scripts
build_packages=(
    gcc libc6-dev cmake ninja-build pkg-config
    libembree-dev libopenexr-dev libuv1-dev libssl-dev
    protobuf-c-compiler libprotobuf-c-dev
    zlib1g-dev libpng-dev libjpeg-dev libjansson-dev
)
# shellcheck disable=SC2034
test_packages=(libcmocka-dev openssl python3 procps)

step() {
    printf '\n== %s\n' "$*"
}

# Install those of the given packages that are missing; no network and no root when none is.
need_packages() {
    local missing=() package
    for package in "$@"; do
        if [[ $(dpkg-query -W -f '${Status}' "$package" 2>/dev/null) != 'install ok installed' ]]; then
            missing+=("$package")
        fi
    done
    if [[ ${#missing[@]} -eq 0 ]]; then
        echo "all packages are there"
        return
    fi
    local as_root=()
    if [[ $(id -u) -ne 0 ]]; then
        if ! command -v sudo >/dev/null; then
            echo "missing: ${missing[*]} (install them as root, or install sudo)" >&2
            return 1
        fi
        as_root=(sudo)
    fi
    echo "installing: ${missing[*]}"
    "${as_root[@]}" env DEBIAN_FRONTEND=noninteractive apt-get update -qq
    "${as_root[@]}" env DEBIAN_FRONTEND=noninteractive apt-get install -y -qq \
        --no-install-recommends "${missing[@]}" >/dev/null
}
