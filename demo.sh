#!/bin/bash
# The whole path on this machine: builds a release, starts the daemon, makes a dataset, trains a
# scene and renders a turn around it. Stays up until Ctrl-C; with --exit it stops after the renders.
# -D options are those of the build: -Dcuda=disabled leaves the CUDA module out.
# What it makes lies in demo-data/.
set -eu
cd "$(dirname "$0")"

stay=true
options=()
for argument in "$@"; do
    case "$argument" in
    --exit) stay=false ;;
    -D*=*) options+=("$argument") ;;
    *)
        echo "usage: ./demo.sh [--exit] [-Dcuda=disabled]" >&2
        exit 2
        ;;
    esac
done

.ci/deps
echo "building, which takes a minute or two; the CUDA module, where nvcc is found, some more (-Dcuda=disabled)"
if [ ! -f build/build.ninja ]; then
    meson setup build --buildtype=release ${options[@]+"${options[@]}"}
elif [ ${#options[@]} -gt 0 ]; then
    meson configure build "${options[@]}"
fi
ninja -C build build.ninja >/dev/null # as the options are now
# The programs alone, not their tests; the modules where what they need was found.
targets=(ripnerfd ripnerf-runner ripnerf)
for module in ripnerf-cuda ripnerf-film; do
    if grep -q "$module\.so" build/build.ninja; then targets+=("$module"); fi
done
meson compile -C build "${targets[@]}"

# The first port from 7373 on that nobody listens on.
port=7373
while (exec 3<>"/dev/tcp/127.0.0.1/$port") 2>/dev/null; do
    port=$((port + 1))
done

run=$(date +%Y%m%d-%H%M%S)
scene=still-life-$run
frames=$PWD/demo-data/frames/$run
export RIPNERF_HOST=http://127.0.0.1:$port
mkdir -p "$frames"

daemon=
# shellcheck disable=SC2317 # called by the trap
stop() {
    if [ -n "$daemon" ] && kill -TERM "$daemon" 2>/dev/null; then
        wait "$daemon" || true
    fi
}
trap stop EXIT
trap 'exit 130' INT TERM

# In a session of its own, so that Ctrl-C reaches this script alone, which then stops it.
setsid build/server/ripnerfd --data demo-data/daemon --listen "127.0.0.1:$port" \
    2>demo-data/daemon.log &
daemon=$!
for _ in $(seq 100); do
    if build/client/ripnerf info >/dev/null 2>&1; then break; fi
    if ! kill -0 "$daemon" 2>/dev/null; then
        cat demo-data/daemon.log >&2
        exit 1
    fi
    sleep 0.1
done
build/client/ripnerf info

# The dataset is made once; a later run finds it.
if ! build/client/ripnerf --json show still-life >/dev/null 2>&1; then
    rm -rf demo-data/still-life
    build/client/ripnerf synth still-life demo-data/still-life --size 200 --views 32
    build/client/ripnerf import demo-data/still-life --name still-life
fi

build/client/ripnerf train still-life --name "$scene" --preset draft --wait
build/client/ripnerf render "$scene" --view test:0 -o "$frames/test-0.png"

build/client/ripnerf turntable "$scene" --seconds 2 --fps 15 --size 200x200 -o "$frames"

echo
if $stay; then
    echo "page: $RIPNERF_HOST/"
    echo "frames: $frames"
    echo "Ctrl-C stops the daemon."
    wait "$daemon"
else
    stop
    daemon=
    echo "frames: $frames"
fi
