#!/bin/bash
# Half an hour on a machine with a GPU, spent by one command; gpu.py says which stages there are.
#
#   gpu.sh DATA OUT [--work DIR] [--seconds 570] [--trial] [--again STAGE] [--known FILE] [--more DIR]
#
# It lies beside programs.tar.xz, as gpu_pack.py laid both there, and needs nothing but the driver,
# Python 3 and, for the stages of sanitizer and profiler, CUDA's tools.
set -eu
here=$(cd "$(dirname "$0")" && pwd)
export PATH=$PATH:/usr/local/cuda/bin
export LD_LIBRARY_PATH=$here/lib${LD_LIBRARY_PATH:+:$LD_LIBRARY_PATH}
export RIPNERF_CUDA_MODULE=${RIPNERF_CUDA_MODULE:-$here/bin/ripnerf-cuda.so}
if ! command -v python3 >/dev/null; then
    echo "gpu.sh: python3 is missing" >&2
    exit 1
fi
[ -d "$here/bin" ] || python3 -m tarfile -e "$here/programs.tar.xz" "$here"
exec python3 "$here/gpu.py" "$@"
