#!/bin/bash
# Builds with a sanitizer and runs tests of threads, memory and the whole way through daemon and runner:
#   tests/support/sanitize.sh thread|address [TEST...]
# in build-thread or build-address. Without tests named: those of the parts and some through the daemon.
# Anything that the sanitizer reports fails.
set -eu
cd "$(dirname "$0")/../.."
kind=${1-}
case $kind in
thread) sanitizer=thread ;;
address) sanitizer=address,undefined ;;
*)
    sed -n '2,5s/^# \?//p' "$0"
    exit 2
    ;;
esac
shift
build=$PWD/build-$kind
[ -f "$build/build.ninja" ] ||
    meson setup "$build" --buildtype=debugoptimized "-Db_sanitize=$sanitizer" -Db_lundef=false \
        -Dcuda=disabled
rm -f "$build"/report.*
# A second SIGTERM ends the daemon at once, and waits for no thread.
export TSAN_OPTIONS=halt_on_error=1:allocator_may_return_null=1:second_deadlock_stack=1:report_thread_leaks=0:log_path=$build/report
export UBSAN_OPTIONS=halt_on_error=1:print_stacktrace=1:log_path=$build/report
# Memory that ends is part of some tests, and what a test may take is counted; libx265 keeps a block.
export ASAN_OPTIONS=allocator_may_return_null=1:quarantine_size_mb=4:log_path=$build/report
printf 'leak:libx265\n' >"$build/leaks"
export LSAN_OPTIONS=suppressions=$build/leaks
# Also what a runner says at its end, which nobody waits for.
tell() {
    mapfile -t found < <(grep -lE 'ERROR|WARNING: ThreadSanitizer|runtime error' "$build"/report.* 2>/dev/null)
    [ ${#found[@]} -gt 0 ] || return 0
    echo "the sanitizer has reported:"
    cat "${found[@]}"
    exit 1
}
trap tell EXIT
if [ $# -gt 0 ]; then
    meson test -C "$build" --print-errorlogs "$@"
    exit
fi
meson test -C "$build" --print-errorlogs --suite unit
# Requests, trainings, pictures, events, uploads and backups through the daemon, but for what counts on how
# much a runner takes; then the whole way. In the sandbox leaks cannot be looked for, and no report be written.
export RIPNERFD_SANDBOX=0
ninja -C "$build" >"$build/log" || { cat "$build/log"; exit 1; }
RIPNERF_BUILD=$build /usr/bin/python3 -m pytest -q -p no:cacheprovider tests/api/test_tokens.py \
    tests/api/test_uploads.py tests/api/test_traces.py tests/api/test_daemon_resources.py -k "not test_memory_limit"
RIPNERF_BUILD=$build /usr/bin/python3 -m pytest -q -p no:cacheprovider tests/api/test_life.py -k backup_and
[ "$kind" = thread ] ||
    RIPNERF_BUILD=$build /usr/bin/python3 -m pytest -q -p no:cacheprovider tests/api/test_end_to_end.py -k test_render
