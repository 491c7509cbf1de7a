#!/bin/bash
# Installs what is missing, builds into build-check/ with warnings as errors, runs every test and
# closes with one line: N passed, N failed[, N skipped]. Exit code 0 only when nothing failed.
set -u
cd "$(dirname "$0")" || exit 1

give_up() {
    echo "check.sh: $1"
    echo "0 passed, 1 failed"
    exit 1
}

.ci/deps || give_up "the packages could not be installed"
if [ ! -f build-check/build.ninja ]; then
    meson setup build-check --buildtype=release --werror -Dfuzz=true || give_up "meson setup failed"
fi
meson compile -C build-check || give_up "the build failed"

# Results of an earlier run must not be taken for this one's.
export RIPNERF_BUILD=$PWD/build-check RIPNERF_EXERCISED=$PWD/build-check/exercised
rm -f build-check/meson-logs/testlog.json build-check/{pytest,operations}.xml build-check/exercised
meson test -C build-check --no-rebuild --print-errorlogs
# Most tests of the daemon wait more than they compute; what they called together is looked at in the end.
pytest=(/usr/bin/python3 -m pytest -q -p no:cacheprovider)
"${pytest[@]}" -n 4 --dist loadfile --junitxml=build-check/pytest.xml \
    --ignore=tests/api/test_operations.py tests
"${pytest[@]}" --junitxml=build-check/operations.xml tests/api/test_operations.py
exec /usr/bin/python3 tests/support/tally.py build-check/meson-logs/testlog.json \
    build-check/{pytest,operations}.xml
