#!/bin/bash
# The whole path on this machine: builds a release, starts the daemon, makes a dataset, trains a
# scene and renders a camera path. Stays up until Ctrl-C; with --exit it stops after the renders.
# What it makes lies in demo-data/.
set -eu
cd "$(dirname "$0")"

stay=true
case "${1-}" in
"") ;;
--exit) stay=false ;;
*)
    echo "usage: ./demo.sh [--exit]" >&2
    exit 2
    ;;
esac

.ci/deps
if [ ! -f build/build.ninja ]; then
    meson setup build --buildtype=release
fi
# The programs alone, not their tests; the CUDA module where its compiler was found.
targets=(ripnerfd ripnerf-runner ripnerf)
if grep -q 'ripnerf-cuda\.so' build/build.ninja; then targets+=(ripnerf-cuda); fi
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

# An orbit: eight keys on a circle of radius 4, seen from 30 degrees above, z up, two seconds.
awk 'BEGIN {
    pi = atan2(0, -1)
    printf "{\"path\": {\"axes\": \"opengl\", \"fps\": 15, \"interpolation\": \"spline\", "
    printf "\"loop\": true, \"width\": 200, \"height\": 200, \"keys\": ["
    for (i = 0; i < 8; i++) {
        a = 2 * pi * i / 8; e = pi / 6; r = 4
        # columns: right, up, backwards (from the centre to the camera), position
        printf "%s\n  {\"time\": %g, \"fov_y_deg\": 39.6, \"world_from_camera\": [", i ? "," : "", i / 4
        printf "[%.9f, %.9f, %.9f, %.9f], ", -sin(a), -sin(e) * cos(a), cos(e) * cos(a), r * cos(e) * cos(a)
        printf "[%.9f, %.9f, %.9f, %.9f], ", cos(a), -sin(e) * sin(a), cos(e) * sin(a), r * cos(e) * sin(a)
        printf "[0, %.9f, %.9f, %.9f]]}", cos(e), sin(e), r * sin(e)
    }
    print "]}}"
}' >demo-data/orbit.json
build/client/ripnerf path "$scene" demo-data/orbit.json -o "$frames"

echo
echo "page: $RIPNERF_HOST/"
if $stay; then
    echo "frames: $frames"
    echo "Ctrl-C stops the daemon."
    wait "$daemon"
else
    stop
    daemon=
    echo "frames: $frames"
fi
