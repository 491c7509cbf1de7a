#!/bin/bash
# Puts each naive formula back, in a scratch copy of the tree, and runs the case that must fail:
# mutations.sh [SEED [PATTERN]], PATTERN choosing some by name. Closes with `N of N caught`; the exit
# code is 0 only when all were. mutations.sh --applies runs nothing and says in a second whether
# each edit still changes its file.
set -u
cd "$(dirname "$0")/../.." || exit 1
tree=$PWD
. tests/support/mutations.sh
[[ ${1-} == --applies ]] && applies_only && shift
export RN_NUMERICS_SEED=${1:-1}
export RN_NUMERICS_STOP=1 # the first bound that does not hold ends a program
pattern=${2:-}
scratch=$(mktemp -d) || exit 1
trap 'rm -rf "$scratch"' EXIT

give_up() {
    echo "mutations.sh: $1" >&2
    exit 1
}

# run PROGRAM: builds it and runs it; 0 passed, 1 failed, 2 did not build. `doctor` is the runner's;
# `poses` is a test of tests/ops; `commands` and `proofs` look at the compile commands and at the proofs' quotations.
run() {
    local target=tests/numerics/numerics_$1
    case $1 in
    doctor) target=server/ripnerf-runner ;;
    poses) target=tests/ops/pose_test ;;
    commands) target=build.ninja ;;
    proofs)
        /usr/bin/python3 "$source/tests/numerics/proofs.py" "$source" >"$scratch/log" 2>&1 || return 1
        return 0
        ;;
    esac
    ninja -C "$build" "$target" >"$scratch/log" 2>&1 || return 2
    case $1 in
    doctor) set -- "$build/$target" --mode doctor --seed "$RN_NUMERICS_SEED" ;;
    commands) set -- /usr/bin/python3 "$source/tests/numerics/flags.py" "$build" ;;
    *) set -- "$build/$target" ;;
    esac
    "$@" >"$scratch/log" 2>&1 || return 1
}

# mutate PROGRAM FILE WHAT SED_SCRIPT
mutate() {
    edit "$2" "$3" "$4" run "$1"
}

# A scratch copy with one kernel set beside the float64 code, quick to compile: prepare generic|bf16,
# and prepare gpu with the GPU's kernels under the emulator.
prepare() {
    $dry && return
    source=$scratch/$1/source pristine=$scratch/$1/pristine build=$scratch/$1/build
    mkdir -p "$pristine" || give_up "no room in $scratch"
    git ls-files --cached --others --exclude-standard -z | xargs -0 cp --parents -t "$pristine"
    local engine=$pristine/server/engine
    sed -i 's/-O3/-O1/' "$engine/meson.build"
    sed -i 's/optimization=3/optimization=1/' "$pristine/tests/meson.build"
    [ "$1" = gpu ] || sed -i 's/^has_cpp = .*/has_cpp = false/' "$pristine/tests/meson.build"
    if [ "$1" = bf16 ]; then
        sed -i "/'avx2': \[/d;/'avx512': avx512,/d;/'amx': /d" "$engine/meson.build"
        sed -i 's/found\[n++\] = &rn_kernels_\(avx2\|avx512\|amx\);/(void)n;/' "$engine/cpu/dispatch.c"
    else
        sed -i "s/host_machine.cpu_family() == 'x86_64'/false/" "$engine/meson.build" \
            "$engine/bench/meson.build"
        sed -i 's/defined(__x86_64__)/0/' "$engine/cpu/dispatch.c" "$engine/bench/machine.c"
    fi
    cp -r "$pristine" "$source"
    meson setup "$build" "$source" --buildtype=release -Dcuda=disabled >"$scratch/log" 2>&1 ||
        { cat "$scratch/log"; give_up "meson setup failed"; }
}

# Programs that must pass before anything is broken.
sound() {
    $dry && return
    for program; do
        [[ -n $pattern ]] && ! grep -q "^ *mutate $program .*$pattern" "$tree/tests/numerics/mutations.sh" && continue
        run "$program" || give_up "$program fails before any mutation: $(tail -3 "$scratch/log")"
    done
}

prepare generic
sound rays training growth poses

field=server/engine/field
cpu=server/engine/cpu
train=server/engine/train
ends='rn_real a = mid - width \/ 2, b = mid + width \/ 2'
cubes='rn_real a3 = a * a * a, b3 = b * b * b'
mutate rays $cpu/packet.h "vector harmonics: the first vector of rows alone" \
    's/in += RN_VL \* RN_HEAD_INPUTS/in += 0/'
mutate rays server/engine/kernels/ray.h "rays: distance from the centre by |o|^2 - (o.d)^2" \
    's/across += foot \* foot;/across += (foot, o[i] * o[i]);/;0,/^    out.radius = (float)ray->radius;/s//    across -= along * along; out.radius = (float)ray->radius;/'
mutate rays server/engine/kernels/ray.h "rays: start left where the camera is" \
    's/double near = enter + jitter/double near = jitter/'
mutate rays $cpu/rays.h "vector rays: distance from the centre by |o|^2 - (o.d)^2" \
    's/across += foot \* foot;/across += o[i] * o[i] + 0 * foot;/;s/^    enter_cube(o, d,/    across -= along * along; &/'
mutate rays $cpu/rays.h "vector rays: start left where the camera is" \
    's/vd near = enter + jitter/vd near = jitter/'
mutate rays $cpu/march.h "march: a brick skipped too far" \
    's/vi next = index_at(s + leave, inverse_step)/vi next = index_at(s + leave, inverse_step) + 1/'
mutate rays $cpu/march.h "march: in rounds, what earlier ones found is lost" \
    's/candidate_count\[r\] += write_chunk(/candidate_count[r] = write_chunk(/'
mutate rays $cpu/march.h "march: cells by truncation towards the centre" \
    's/p \* half + half, 0.0f, top/p * half + half - 0.01f, 0.0f, top/'
mutate training server/engine/train/step.c "training: parameters not looked at after a step" \
    's/if (!rn_trainer_guard_step(t, t->step.accepted)) return;//'
mutate training server/engine/train/trainer.c "training: saved without a look" \
    's|while (!rn_trainer_guard_save(t))|while (0)|'
mutate training $train/guard.c "training: rolled back with spoilt moments" \
    's/memset(t->optimiser.[mv], 0, bytes);//'
mutate training $train/optimiser.c "sparse updates: planes decay" \
    's/if (config->sparse) o->update.planes.decay = 0;.*//'
mutate voxels $cpu/voxels.h "voxels: the far slice weighs as the row below" \
    's/near + at.z\[j\] \*/near + at.y[j] */'
mutate voxels $cpu/voxels.h "voxels: the next band's first is added to" \
    's/voxel >= band->end) return/voxel > band->end) return/'
mutate voxels $cpu/voxels.h "voxels: a neighbour's tile is not marked" \
    's/\(touched\[row.*\] = \)1;/\1voxel % 2 == 0;/'
mutate voxels $cpu/voxels.h "voxels smoothed: a share of 1/4" 's/+= share \* (around/+= 1.5f * share * (around/'
mutate rays server/engine/kernels/ray.h "rays: slabs divided by a zero component" \
    's/double direction = fabs(d\[i\]) < 1e-300.*/double direction = d[i];/;s/enter = first > enter ? first : enter;/enter = enter > first ? enter : first;/'
grow=$train/grow.c
blocks=server/engine/checkpoint/blocks.c
mutate growth $grow "growth: moments as they were" \
    's/\({t->optimiser.m, m, .*\), share}/\1, 1}/'
mutate growth $grow "growth: corners aligned to the edges" \
    's/double u = .*/double u = x * (e->old - 1.0) \/ (e->side - 1);/'
mutate growth $grow "growth: nearest texels" 's/float fx = .*/float fx = 0;/'
mutate growth $grow "growth: voxels' moments as texels'" 's/, 3 \* (float)i)/, 2 * (float)i)/'
mutate growth $grow "growth: a border's texel as its neighbour and the difference" \
    's/int column = (int)u, right = .*/int column = (int)fmin(u, e->old - 2), right = e->channels;/'
mutate growth $grow "growth: spoilt parameters become the good ones" \
    's/ || t->optimiser.rejected > 0 || !rn_trainer_all_finite(t)//'

mutate poses server/engine/scene/pose.c "poses: differences over one step in place of two" \
    's|(float)(2 \* step)|(float)step|'
mutate poses server/engine/train/poses.c "poses: what all cameras turn by together stays" \
    's|move.turn\[i\] -= mean.turn\[i\];||'
mutate poses server/engine/train/trainer.c "poses: moves of a checkpoint are not followed" \
    's|^.*// those that were moved$||'

prepare gpu
cuda=server/engine/cuda

if $dry || grep -q avx512_bf16 /proc/cpuinfo; then
    prepare bf16
    :
else
    echo "skipped: this processor has no bf16 products, for five mutations more"
fi

conclude
