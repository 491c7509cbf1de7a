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
# `reference` and `sheets` are tests of tests/unit, `poses`, `outliers`, `withheld` and `places` of tests/ops; `commands` and `proofs` look at the compile commands and at the proofs' quotations.
run() {
    local target=tests/numerics/numerics_$1
    case $1 in
    doctor) target=server/ripnerf-runner ;;
    reference | sheets) target=tests/unit/engine/test_$1 ;;
    poses) target=tests/ops/pose_test ;;
    outliers) target=tests/ops/outlier_test ;;
    withheld) target=tests/ops/withheld_test ;;
    places) target=tests/ops/forward_test ;;
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
sound frustum footprint ripmap solid volume camera lens optimiser kernels rays disparity space training \
    incidents reproducible roulette overflow growth networks blocks metrics_images flags_fma doctor commands \
    proofs reference poses voxels outliers withheld places

field=server/engine/field
cpu=server/engine/cpu
train=server/engine/train
ends='rn_real a = mid - width \/ 2, b = mid + width \/ 2'
cubes='rn_real a3 = a * a * a, b3 = b * b * b'
mutate frustum $field/frustum.h "moments: mean by powers of the end points" \
    "s/struct rn_moments out = .*/$ends; $cubes; struct rn_moments out = {(rn_real)0.75 * (b3 * b - a3 * a) \/ (b3 - a3), (rn_real)axial, (rn_real)radial};/"
mutate frustum $field/frustum.h "moments: axial variance by powers of the end points" \
    "s/return out;/$ends; $cubes; out.axial = (rn_real)0.6 * (b3 * b * b - a3 * a * a) \/ (b3 - a3) - out.mean * out.mean; return out;/"
mutate frustum $field/frustum.h "moments: axial variance by mip-NeRF's subtraction" \
    's/return out;/out.axial = (rn_real)(h * h \/ 3 - 4 * h * h * h * h * (12 * m * m - h * h) \/ (15 * (3 * m * m + h * h) * (3 * m * m + h * h))); return out;/'
mutate frustum $field/frustum.h "moments: half width recovered from the end points" \
    's/h = (rn_wide)width \* (rn_wide)0.5,/h = ((mid + width \/ 2) - (mid - width \/ 2)) \/ 2,/'
mutate footprint $field/footprint.h "footprint: plain dot product" \
    's/rn_real dot = .*/rn_real dot = x[0] * d[0] + x[1] * d[1] + x[2] * d[2];/'
mutate footprint $field/footprint.h "footprint: 1 - (x.d)^2 for the part across" \
    's/return axial \* (dot.*/return axial * (dot * dot) + radial * (1 - dot * dot);/'
mutate footprint $field/real.h "footprint: plain differences of products" \
    's/return fma(a, b, -cd) + error;/(void)error; return a * b - cd;/'
mutate footprint $field/footprint.h "level: variance not clamped" \
    's/LOG2(CLAMP(variance \* (unit \* unit), (NUMBER)1, top))/LOG2(variance * (unit * unit) + 0 * top)/'
mutate footprint $field/footprint.h "level: the paper's equation, without the size" \
    's/(NUMBER)RN_FOOTPRINT_SCALE \* (NUMBER)size/(NUMBER)RN_FOOTPRINT_SCALE + 0 * (NUMBER)size/'
mutate space $field/space.h "contraction: lengths across as along" \
    's/LENGTHS c = {across, across, half \* inverse}; /LENGTHS c = {across, half * inverse, half * inverse};/'
mutate space $field/space.h "contraction: to the whole ball, not its half" \
    's/LENGTHS c = {across, across, half \* inverse}; /LENGTHS c = {across, across, inverse * inverse};/'
mutate space $field/space.h "Jacobian: the part along the direction left out" \
    's/ret\[i\] = c->across \* axis\[i\] + along \* towards\[i\];/ret[i] = c->across * axis[i] + 0 * along;/'
mutate space $field/space.h "places: distance not stretched beyond 1" \
    's/return size <= 1 ? s : COPYSIGN(2 - 1 \/ size, s); /return size <= 1 ? s : COPYSIGN(2 - 1 \/ (size * size), s);/'
mutate space $field/space.h "bent rays: come half as far across the radius" \
    's/return 1 + 4 \* squares;/return 1 + squares;/'
mutate space $field/space.h "bent rays: as far from the centre as near it" \
    's/return 1 + 4 \* squares;/return 1;/'
mutate space $cpu/space.h "bent rays: steps half as long" \
    's/(k + 0.5f) \* (2 \* step)/(k + 0.5f) * step/'
mutate space $cpu/space.h "bent rays: the first step looked at twice" \
    's/(k + 0.5f) \* (2 \* step)/(vf_max(k - 1.0f, vf_set(0)) + 0.5f) * (2 * step)/'
mutate space $cpu/march.h "bent rays: cells looked up where the ray is straight" \
    's/scale = contraction_at(distance_from_centre(ray, s)).scale;/scale = vf_set(0.5f);/'
mutate space $cpu/crisp.h "what cells showed: told to the cell where the ray is straight" \
    's/scale \*= contraction_at(distance_from_centre(ray, s)).scale;/scale *= vf_set(0.5f);/'
mutate space $field/occupancy.h "end of space: half the ball" \
    's/#define RN_END 0.96875/#define RN_END 0.5/'
mutate ripmap $field/ripmap.h "pooling: odd sizes drop their last texel" \
    's/if (size % 2 == 0) {/if (size > 1) {/'
mutate ripmap $field/ripmap.h "query: position not clamped above" \
    's/texels - CONSTANT(1)); /CONSTANT(2) * texels);/'
mutate ripmap $field/ripmap.h "query: corners aligned to the edges" \
    's/x = p \* half + (half - CONSTANT(0.5)); /x = (p + CONSTANT(1)) * (half - CONSTANT(0.5));/'
mutate ripmap server/engine/reference/pyramid.c "pyramid: adjoint without the weights" \
    's/+= weight\[t\] \* coarse/+= 0.5 * coarse/'
mutate solid $field/solid.c "planes: computed in float64" \
    's/typedef long double vec3/typedef double vec3/;s/sqrtl(/sqrt(/;s/long double norm/double norm/'
mutate solid $field/solid.c "planes: golden ratio to ten digits" \
    's/#define PHI .*/#define PHI 1.618033988L/'
mutate volume $field/volume.h "density: not clamped" \
    's/exp(rn_clamp(\(logit - RN_DENSITY_SHIFT\), .*/exp(\1);/'
mutate volume $field/volume.h "opacity: 1 - exp(-x)" 's/return -expm1(-x);/return 1 - exp(-x);/'
mutate volume $field/volume.h "compositing: product of 1 - opacity" \
    's/before = after\[i\] = exp(-sum);/before = after[i] = before * (1 - rn_alpha(x[i]));/'
mutate volume $field/volume.h "compositing: plain sum of optical depths" \
    's/carry = (t - sum) - y;/carry = 0;/'
mutate volume $field/volume.h "backward: total minus prefix" \
    's/rn_real suffix = 0;/rn_real suffix = 0; for (int i = 0; i < n; i++) suffix += weights[i] * g[i]; for (int i = 0; i < n; i++) { rn_real gi = g[i]; suffix -= weights[i] * gi; grad[i] = after[i] * gi - suffix; } return;/'
mutate volume $field/volume.h "backward: divided by 1 - opacity" \
    's/grad\[i\] = after\[i\] \* gi - suffix;/grad[i] = after[i] * gi - suffix \/ (1 - weights[i]) * (1 - weights[i]);/'
mutate reference $field/loss.h "loss: squares where it should be straight" 's/size < 1 ?/size < 4 ?/'
mutate reference $field/loss.h "loss: over the mean of random backgrounds alone" \
    's/3 \* (NUMBER)colouring/0 * (NUMBER)colouring/'
mutate optimiser server/engine/reference/reference.c "AdamW: 1 - 0.999^t by pow" \
    's/c2 = -expm1(.*/c2 = 1 - pow(0.999, (double)step);/'
mutate optimiser server/engine/reference/reference.c "AdamW: fp32 second moment" \
    's/v\[i\] = 0.999 \* v\[i\].*/v[i] = (float)(0.999 * v[i] + 0.001 * grad[i] * grad[i]);/'
mutate camera common/math/camera.h "cameras: direction in fp32" \
    's/TYPE inverse_norm = 1.0 \/ ROOT/TYPE inverse_norm = (1 + 0x1p-26) \/ ROOT/'
mutate lens common/math/lens.h "lenses: tangential parameters swapped" \
    's/t.p1 = k\[2\], t.p2 = k\[3\];/t.p1 = k[3], t.p2 = k[2];/'
mutate lens common/math/lens.h "lenses: nerfstudio's k4 for OpenCV's" \
    's/t.below\[0\] = k\[5\]/t.above[3] = k[5]/'
mutate lens common/math/lens.h "lenses: ten steps of Newton's method, unchecked" \
    's/part > 1e-12; part \*= 0.5/part == 1; part *= 0.5/;s/i < 100 /i < 10 /;s/return error <= 0x1p-80.*/return true;/'
mutate lens common/math/lens.h "lenses: stopped at 2^-15" 's/0x1p-60/0x1p-30 * 1e6/'
mutate lens common/math/lens.h "lenses: the fold not looked at" \
    's/!(nu \* nu + nv \* nv < fold \* fold) || //'
mutate lens common/math/lens.h "lenses: angle by asin" \
    's/atan2(t->omega \* t->c \* r, p\[2\])/asin(t->omega * t->c * r \/ sqrt(t->omega * t->c * r * t->omega * t->c * r + p[2] * p[2]))/'
mutate lens common/math/lens.h "lenses: a cone's area without the derivative of the angle" \
    's/return t->c \* sinc \//return t->c \//'
mutate lens common/math/camera.h "lenses: a cone's area without the bending's" \
    's/ \/ (bent.xx \* bent.yy - bent.xy \* bent.yx);/;/'
mutate lens common/math/lens.c "lenses: the fold a step too late" \
    's/inside < outside; i++/inside < outside \&\& !(inside = outside); i++/'
mutate kernels $cpu/simd.h "vector exp: one-part reduction" \
    's/vf r = x - n \* 0.693145751953125f;.*/vf r = x - n * 0.693147180559945f;/;s/r = r - n \* 1.42860677e-6f;//'
mutate kernels $cpu/simd.h "vector 1 - exp(-x): without the series" \
    's/return vf_select(x < 0.5f, small, /return vf_select(x < 0.0f, small, /'
mutate kernels $cpu/simd.h "vector log2: a series of two terms" \
    's/p = p \* t2 + 0.4121986f;/p = vf_set(0.0f);/'
mutate kernels $field/frustum.h "vector moments: half width recovered from the end points" \
    's/hs = half \* s,/hs = ((t + half) - (t - half)) * (NUMBER)0.5 * s,/'
mutate volume $cpu/packet.h "vector compositing: optical depth summed in fp32" \
    's/double depth = w->ray_depth\[r\];/float depth = (float)w->ray_depth[r];/;s/depth += sums\[RN_VD - 1\];/depth += (float)sums[RN_VD - 1];/'
mutate volume $cpu/packet.h "vector compositing: 1 - exp(-x)" \
    's/t \* vf_one_minus_exp(x)/t * (1.0f - vf_exp(-x))/'
mutate volume $cpu/backward.h "vector compositing: a segment's own sample counts as behind it" \
    's/VD_DOWN(sums, 1) + behind/sums + behind/'
mutate volume $cpu/backward.h "vector compositing: neighbours of a short segment are summed" \
    's/vd_suffix_sums((vd)((vl)share & mine))/vd_suffix_sums(share)/'
mutate rays $cpu/packet.h "vector harmonics: the first vector of rows alone" \
    's/in += RN_VL \* RN_HEAD_INPUTS/in += 0/'
mutate kernels $cpu/update.h "vector AdamW: squares that overflow" \
    's/vf g = vf_min(.*/vf g = vf_load(grad) * o->scale;/'
mutate kernels $cpu/update.h "vector AdamW: decay as 1 - rate * decay" \
    's/change = p \* fade + rate/change = rate/;s/p = p - change;/p = p * (1 - fade) - change;/'
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
mutate training server/engine/train/saving.c "training: saved without a look" \
    's|while (!rn_trainer_guard_save(t))|while (0)|'
mutate training $train/guard.c "training: rolled back with spoilt moments" \
    's/memset(t->optimiser.[mv], 0, bytes);//'
mutate incidents $train/schedule.c "training: the rate stays after a rollback" \
    's/-(int)progress->rollbacks/0 * (int)progress->rollbacks/'
mutate incidents $train/occupancy.c "occupancy: a cell that is no number stays so" \
    's/if (!isfinite(old)) old = 0;//'
mutate incidents server/engine/checkpoint/checkpoint.c "checkpoint: read without a look" \
    's/!all_finite(t->data, t->bytes \/ 4)/(all_finite(t->data, 0), false)/'
mutate incidents server/engine/render/fill.c "render: numbers not looked at" \
    's/return isfinite(value) ? value : other;/return value + 0 * other;/'
mutate incidents server/engine/render/fill.c "render: replaced rays not counted" \
    's/nonfinite += !is_finite(&row\[x\]);/(void)row[x];/'
mutate incidents $train/incident.c "incident: the offending rays are not looked for" \
    's/if (incident->ray_count == 0) search(t, incident);/(void)search;/'
mutate incidents $cpu/loss.h "training: a ray that is not finite is backpropagated" \
    's/if (!isfinite(loss)) return false;/if (isinf(loss)) return false;/'
mutate reproducible $train/trainer.c "view dependence: measured as the step before marched" \
    's/march = rn_schedule_march(.*);/march = t->step.march;/'
mutate reproducible $train/sampler.c "rays: drawn by the thread's own count" \
    's/rn_rng_draw(t->step.march.seed, STREAM_RAYS | (uint32_t)r, t->step.march.counter)/rn_rng_draw(t->step.march.seed + (uint64_t)rn_pool_threads(t->engine->pool), STREAM_RAYS | (uint32_t)r, t->step.march.counter)/'
mutate roulette $cpu/backward.h "roulette: survivors count once" \
    's/row \* ((float)CERTAIN .*/row;/'
mutate roulette $cpu/backward.h "roulette: what is likelier than not is backpropagated" \
    's/n += next \/ CERTAIN != sum \/ CERTAIN;/n += w->chance[i] > CERTAIN \/ 2;/'
mutate overflow $cpu/backward.h "roulette: what is not finite is left out" \
    's/(size != 0.0f)/(size > 0.0f)/'
mutate training $train/optimiser.c "sparse updates: planes decay" \
    's/if (config->sparse) o->update.planes.decay = 0;.*//'
mutate kernels $cpu/smooth.h "smoothing: one colour twice" \
    's/y - 1, y % 2, share/y - 1, 1 - y % 2, share/'
mutate kernels $cpu/smooth.h "smoothing: a share of 1/2" \
    's/texel\[c\] += share \*/texel[c] += 2 * share */'
mutate voxels $cpu/voxels.h "voxels: the far slice weighs as the row below" \
    's/near + at.z\[j\] \*/near + at.y[j] */'
mutate voxels $cpu/voxels.h "voxels: the next band's first is added to" \
    's/voxel >= band->end) return/voxel > band->end) return/'
mutate voxels $cpu/voxels.h "voxels: a neighbour's tile is not marked" \
    's/\(touched\[row.*\] = \)1;/\1voxel % 2 == 0;/'
mutate voxels $cpu/voxels.h "voxels smoothed: a share of 1/4" 's/+= share \* (around/+= 1.5f * share * (around/'
mutate optimiser $cpu/update.h "vector AdamW: moments not corrected" \
    's/rate = o->rate \/ o->correction1/rate = o->rate/'
mutate ripmap $cpu/fetch.h "vector query: nearest level" \
    's/ret->upper = level - vf_from_int(whole);/ret->upper = vf_set(0);/'
mutate ripmap $cpu/fetch.h "vector query: weights that do not sum to 1" \
    's/vf_store(ret->weight\[3\], below \* right);/vf_store(ret->weight[3], weight * right * right);/'
mutate rays server/engine/kernels/ray.h "rays: slabs divided by a zero component" \
    's/double direction = fabs(d\[i\]) < 1e-300.*/double direction = d[i];/;s/enter = first > enter ? first : enter;/enter = enter > first ? enter : first;/'
mutate disparity server/engine/kernels/ray.h "disparity: rays go on behind their camera" \
    's/if (o\[2\] > 0 && 1 \/ o\[2\] < high) high = 1 \/ o\[2\];/;/'
mutate disparity $cpu/forward.h "disparity: vectors cut to the cube, not the box" \
    's/space->half\[i\]/1.0/g'
mutate disparity $cpu/crisp.h "distortion: a sample's own length left out" \
    's/ + weight \* width \* (2.0 \/ 3)//'
mutate disparity $cpu/crisp.h "distortion: pairs counted once" \
    's/factor \* (2 \* apart/factor * (apart/'
mutate metrics_images common/image/metrics.c "SSIM: pictures squared in fp32" \
    's/double va = (double)a\[x \* channels\], vb = (double)b\[x \* channels\];/float va = a[x * channels], vb = b[x * channels];/'
mutate metrics_images common/image/metrics.c "PSNR: squares summed in fp32" \
    's/double sum = 0;/float sum = 0;/;s/sum += difference/sum += (float)difference/'
mutate metrics_images common/image/scale.c "downscale: truncated" \
    's/(2 \* n + d) \/ (2 \* d)/n \/ d/'
mutate metrics_images common/image/scale.c "downscale: straight colours averaged" \
    's/? weight \* pixel\[3\] : weight/? weight : weight/'
mutate metrics_images common/image/scale.c "published pyramid: rounded" \
    's/(uint8_t)(values\[i\] \* 255.0f)/(uint8_t)(values[i] * 255.0f + 0.5f)/'
mutate metrics_images common/image/image.c "pictures to bytes: truncated" \
    's/ \* 255.0f + 0.5f);/ * 255.0f);/'
mutate doctor $cpu/simd.h "doctor: vector exp with a one-part reduction" \
    's/vf r = x - n \* 0.693145751953125f;.*/vf r = x - n * 0.693147180559945f;/;s/r = r - n \* 1.42860677e-6f;//'
mutate doctor $field/volume.h "doctor: compositing by a product of 1 - opacity" \
    's/before = after\[i\] = exp(-sum);/before = after[i] = before * (1 - rn_alpha(x[i]));/'
grow=$train/grow.c
blocks=server/engine/checkpoint/blocks.c
mutate blocks $blocks "few bits: the low end rounded to the nearest half" 's/rn_half_below(least)/rn_half_nearest(least)/'
mutate blocks $blocks "few bits: the step rounded to the nearest half" \
    's/rn_half_above(nextafterf((float)reach, INFINITY))/rn_half_nearest((float)reach)/'
mutate blocks $blocks "few bits: codes truncated" 's/ \/ step + 0.5/ \/ step/'
mutate blocks $blocks "few bits: the border's block one texel short" 's/(c->base + RN_BLOCK_SIDE - 1) \/ RN_BLOCK_SIDE/c->base \/ RN_BLOCK_SIDE/'
mutate blocks common/math/half.h "halves: truncated" 's/(half + (rest > 0x1000 || (rest == 0x1000 \&\& (half \& 1))))/half/'
mutate blocks common/math/half.h "halves: ties away from zero" 's/(rest == 0x1000 \&\& (half \& 1))/rest == 0x1000/'
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
mutate overflow $grow "growth: overflowing parameters become the good ones" \
    's/ || t->optimiser.rejected > 0//'
mutate overflow $train/optimiser.c "overflow: the step is taken all the same" \
    's/return check == 0 && isfinite(loss);/return check == 0 || isfinite(loss);/'
mutate overflow $train/guard.c "overflow: steps are rejected for ever" \
    's/if (guard->found || t->optimiser.rejected >= MOST_REJECTED)/if (guard->found)/'
mutate reproducible server/engine/checkpoint/state.c "growth: a resumed run no longer grows" \
    's/return decode_all(members/members[4] = members[3]; return decode_all(members/'
mutate proofs $cpu/simd.h "proofs: a coefficient that is not the proved one" \
    's/4.16666667e-2f/4.1666666e-2f/'
mutate proofs $field/frustum.h "proofs: another order of the proved products" \
    's/((NUMBER)3 \/ 5 \* hs) \* hs \*/(NUMBER)3 \/ 5 * (hs * hs) */'
mutate flags_fma meson.build "flags: contraction allowed" \
    's/-ffp-contract=off/-ffp-contract=fast/'
mutate commands server/engine/meson.build "flags: the kernel sets' contraction changed" \
    's/-ffp-contract=fast/-ffp-contract=off/'
mutate commands server/engine/meson.build "flags: fast mathematics in the kernel sets" \
    "s/'-Wno-psabi'/'-Wno-psabi', '-ffast-math'/"

mutate poses server/engine/scene/pose.c "poses: differences over one step in place of two" \
    's|(float)(2 \* step)|(float)step|'
mutate poses server/engine/train/poses.c "poses: what all cameras turn by together stays" \
    's|own.turn\[i\] -= mean->turn\[i\];||'
mutate poses server/engine/train/lifetime.c "poses: moves of a checkpoint are not followed" \
    's|^.*// those that were moved$||'

mutate outliers server/engine/train/outliers.c "outliers: a photograph's own light is not taken off" \
    's| - less\[c\]||'
mutate outliers server/engine/train/outliers.c "outliers: blocks that are not known count" \
    's|if (!known\[j \* across + i\]) continue;||'
mutate outliers server/engine/train/outliers.c "outliers: what is not learned yet counts" \
    's|define STANDS 64|define STANDS 0|'
mutate outliers server/engine/train/outliers.c "outliers: what any other photograph shows is left in" \
    's|2 \* others.alike > others.seen|others.alike > 0|; s|others.alike >= WITNESSES|others.seen > 0|'
mutate outliers server/engine/train/saving.c "outliers: turns of a checkpoint are not counted" \
    's|t->outliers.turns = from->outlier_turns;||'

mutate sheets $train/sheets.c "sheets: a plane's depth is that of its points' mean" \
    's/double here = mean\[2\] - .*/double here = mean[2];/'
mutate sheets $train/sheets.c "sheets: edges part nothing" \
    's/if (fabsf(here\[c\] - last\[c\]) > EDGE) return false;/(void)0;/'
mutate sheets $train/sheets.c "sheets: free to the farthest of the points about" \
    's/nearest = fminf(nearest,/nearest = fmaxf(nearest,/'
mutate withheld $train/live.c "withheld: photographs that tell the progress are trained on" \
    's|if (rn_trainer_withholds(.*)) return;||'
mutate withheld $train/occupancy.c "withheld: what they leave empty is carved" \
    's|if (rn_trainer_withholds(.*)) continue;||'
mutate withheld $train/withheld.c "withheld: what was given back still measures" \
    's|bool learned = .*;|bool learned = false;|'
mutate withheld $train/seen.c "withheld: cells that they alone see are empty before they look" \
    's|(double)t->progress.step < SINCE|false \&\& 0 < SINCE|'
mutate withheld $train/schedule.c "withheld: a plateau is not waited for" \
    's|if (config->until_plateau) return progress->plateau;||'
mutate withheld server/engine/checkpoint/state.c "withheld: a checkpoint does not say that they were given back" \
    's|PROGRESS_LATER(given_back, KIND_INT64),||'

mutate places server/engine/scene/scene.c "places: pictures march in the trained steps" \
    's|define PICTURE_STEP 0.5|define PICTURE_STEP 1|'
mutate places $train/schedule.c "places: a field is not trained in its pictures' steps" \
    's|define PICTURE_STEPS 0.85|define PICTURE_STEPS 2|'

prepare gpu
sound frustum footprint volume halves kernels
cuda=server/engine/cuda
mutate frustum $cuda/encode.cuh "GPU: the mean of a frustum is its middle" 's/float mean = s + shift;/float mean = s;/'
mutate footprint $cuda/encode.cuh "GPU: levels of whole numbers" 's/\*ret_ly = rn_valid_level(p, ly);/*ret_ly = *ret_lx = (int)rn_valid_level(p, ly);/'
mutate volume $cuda/device.cuh "GPU: the depth in front by taking the own one off again" \
    's/T before = rn_shuffle(x, RN_LANE - 1), sum = .*/T sum = x;/;/RN_LANE % lanes >= d) sum += other;/,/^}/s/return sum;/return sum - x;/'
mutate volume $cuda/forward.cuh "GPU: opacity as 1 - exp" 's/return -expm1f(-x);/return 1 - expf(-x);/'
mutate halves $cuda/optimise.cuh "GPU: maps from maps in fp16" \
    's/mean\[y\]\[c\] = 0.5f \* (mean\[2 \* y\]\[c\] + mean\[2 \* y + 1\]\[c\]);/mean[y][c] = rn_low(rn_pack(0.5f * (mean[2 * y][c] + mean[2 * y + 1][c]), 0));/'
mutate halves $cuda/encode.cuh "GPU: texels weighed in fp16" 's/weights\[i\]\[k\] = (k \& 2 ? high : low) \* fx;/weights[i][k] = rn_low(rn_pack((k \& 2 ? high : low) * fx, 0));/'
mutate halves $cuda/scatter.cuh "GPU: a block is marked by its first channel" \
    's/if (moved \&\& p->channel == 0)/if (moved \&\& p->channel == 0 \&\& grad[0] != 0)/'
mutate halves $cuda/scatter.cuh "GPU: the first texel's block alone is marked" 's/x1 = ((x + 2) << lx) - 1/x1 = x << lx/'
mutate halves $cuda/scatter.cuh "GPU: blocks marked where a nest moves along x alone" 's/moved |= !stays;/moved |= leaves || x[k \& 1] != n->x[k \& 1];/'
mutate halves $cuda/scatter.cuh "GPU: blocks not marked where levels change" 's/moved |= !stays;/moved |= x[k \& 1] != n->x[k \& 1] || y[k >> 1] != n->y[k >> 1];/'
mutate halves $cuda/scatter.cuh "GPU: a nest begins at the first texel" 's/n.lx = n.ly = n.x\[0\] = .*/n.x[1] = n.y[1] = 1; n.marked[0] = n.marked[1] = RN_NOWHERE;/'
mutate halves $cuda/step.cuh "GPU: an fp16 zero of a pixel is no zero" 's/size < 0x400 ? denormal .* : value/value/'
mutate halves $cuda/step.cuh "GPU: an fp16 infinity of a pixel is a number" 's/bits += size >= 0x7c00 ? .*/;/'
mutate kernels $cuda/optimise.cuh "GPU: AdamW squares what fp32 cannot hold" 's/float g = fminf(fmaxf(grad, -1.8e19f), 1.8e19f);/float g = grad;/'

if $dry || grep -q avx512_bf16 /proc/cpuinfo; then
    prepare bf16
    sound kernels networks
    mutate kernels $cpu/gemm_bf16.h "bf16: truncated instead of rounded" \
        's/return (__m512i)_mm512_cvtne2ps_pbh(high, low);/return _mm512_inserti64x4(_mm512_castsi256_si512(_mm512_cvtepi32_epi16(_mm512_srli_epi32((__m512i)low, 16))), _mm512_cvtepi32_epi16(_mm512_srli_epi32((__m512i)high, 16)), 1);/'
    mutate networks $cpu/gemm_bf16.h "networks: bf16 truncated instead of rounded" \
        's/return (__m512i)_mm512_cvtne2ps_pbh(high, low);/return _mm512_inserti64x4(_mm512_castsi256_si512(_mm512_cvtepi32_epi16(_mm512_srli_epi32((__m512i)low, 16))), _mm512_cvtepi32_epi16(_mm512_srli_epi32((__m512i)high, 16)), 1);/'
    mutate networks $cpu/gemm_bf16.h "networks: bf16, the last pair of a part of a tile left out" \
        's/? p->k - k : RN_TILE_K;/? p->k - k - 2 : RN_TILE_K;/'
    mutate networks $cpu/mlp_bf16.h "networks: bf16, rows of weights' gradients left out" \
        's/? in - i : RN_TILES_M/? in - i - 8 : RN_TILES_M/'
    mutate networks $cpu/mlp_bf16.h "networks: bf16, half of an input's gradient left out" \
        's/.k = b->net->shape->out\[l\],/.k = b->net->shape->out[l] \/ 2,/'
else
    echo "skipped: this processor has no bf16 products, for five mutations more"
fi

conclude
